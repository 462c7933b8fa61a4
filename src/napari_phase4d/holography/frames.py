"""What is done with one camera frame: from its grey values to phase and amplitude.

With the preview of a frame, fast enough to follow a circle under the mouse, and with the axes,
units and notes of what is made of all frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.aberrations import ABERRATION_NAMES
from napari_phase4d.holography.demodulation import (
    WINDOWS,
    Demodulator,
    cut_of,
    field_shape,
    half_spectrum,
    middle_of_first,
)
from napari_phase4d.holography.emptyfield import FrameTilt, write_levelled
from napari_phase4d.holography.focusing import Focus
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.holography.lost import LostFrames
from napari_phase4d.holography.refocusing import Propagator
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.phasors import parts_of, to_polar
from napari_phase4d.recording import BrokenFrameError, Recording
from napari_phase4d.stacks import (
    AXES,
    KIND,
    WAVELENGTH,
    WRAPPED,
    coordinate,
    wavelength_coordinate,
)
from napari_phase4d.words import shown

__all__ = [
    "FrameReconstructor",
    "Preview",
    "aberration_note",
    "focus_note",
    "lobe_note",
    "propagator_for",
    "recalibrated",
]


class ReadsRawFrames(Protocol):
    """A recording, or what stands for one."""

    def raw_frame(self, index: int) -> NDArray[np.generic]:
        """Return one frame, shape (y, x)."""


class Carries(Protocol):
    """What carries the fields of all views of a frame to another plane."""

    def __call__(self, field: NDArray[np.complexfloating], /) -> NDArray[np.complex64]:
        """Return fields (view, y, x) as they are there."""


@dataclass(frozen=True)
class EachByItsLight:
    """Carries each view by its own wavelength.

    Parameters
    ----------
    carry : tuple of Propagator
        One for each view.
    """

    carry: tuple[Propagator, ...]

    def __call__(self, field: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
        """Return fields (view, y, x) in the other plane."""
        return np.stack([carry(view) for carry, view in zip(self.carry, field, strict=True)])


@dataclass(frozen=True)
class FrameReconstructor:
    """All that turns one camera frame into phase and amplitude, measured once a recording.

    It can be pickled, and several threads may use it.

    Parameters
    ----------
    demodulate : Demodulator
        Gives the fields of all views.
    factor : ndarray of shape (view, y, x) or (1, 1, 1)
        What they are multiplied by, see `corrections`.
    drift : bool
        Whether the phase of the empty field is set to zero.
    angles : list of float
        Viewing angles in degrees.
    attrs : dict
        What to note of it.
    refocus : Propagator, optional
        Carries the fields to another plane.
    lost : LostFrames, optional
        Tells frames that the camera lost.
    tilt : FrameTilt, optional
        Takes the tilt of each frame off its fields.
    light : tuple of float, optional
        Wavelength of each view in micrometres, where they differ.
    """

    demodulate: Demodulator
    factor: NDArray[np.complex64]
    drift: bool
    angles: list[float]
    attrs: dict[str, Any]
    refocus: Carries | None = None
    lost: LostFrames | None = None
    tilt: FrameTilt | None = None
    light: tuple[float, ...] | None = None

    def __call__(
        self,
        frame: NDArray[np.generic],
        phase: NDArray[np.float32],
        amplitude: NDArray[np.float32],
    ) -> tuple[float, ...]:
        """Write the phase and amplitude of a frame, each (view, y, x).

        Returns
        -------
        tuple of float
            Of each view, the share of pixels that look like background; 1 if not looked at, NaN
            if the view is lost, whose phase and amplitude are NaN then.
        """
        fields = self.demodulate(frame)
        lost = [""] * len(fields) if self.lost is None else self.lost.reasons(frame, fields)
        if all(lost):
            return nothing_seen(phase, amplitude)
        fields = self.corrected(fields)
        for view in np.flatnonzero(lost):
            nothing_seen(phase[view : view + 1], amplitude[view : view + 1])
        views = zip(fields, amplitude, phase, lost, strict=True)
        return tuple(
            math.nan if gone else write_levelled(parts_of(f), a, p, self.drift)
            for f, a, p, gone in views
        )

    def fields(self, frame: NDArray[np.generic]) -> NDArray[np.complex64]:
        """Return the corrected and refocused fields of all views of a frame, (view, y, x)."""
        return self.corrected(self.demodulate(frame))

    def fields_or_reason(
        self, source: ReadsRawFrames, index: int
    ) -> tuple[NDArray[np.complex64] | None, str]:
        """Return the same for a frame of a recording by its number; why it is lost, if it is."""
        try:
            frame = source.raw_frame(index)
        except BrokenFrameError:
            return None, "NaN"
        fields = self.demodulate(frame)
        reason = "" if self.lost is None else self.lost.reason(frame, fields)
        return (None, reason) if reason else (self.corrected(fields), "")

    def corrected(self, fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Return demodulated fields, corrected in place, and refocused."""
        fields *= self.factor
        if self.tilt is not None:
            self.tilt.take_off(fields)
        return fields if self.refocus is None else self.refocus(fields)

    def read(
        self,
        source: ReadsRawFrames,
        index: int,
        phase: NDArray[np.float32],
        amplitude: NDArray[np.float32],
    ) -> tuple[float, ...]:
        """Do the same for a frame of a recording by its number; it may hold NaN."""
        try:
            frame = source.raw_frame(index)
        except BrokenFrameError:
            return nothing_seen(phase, amplitude)
        return self(frame, phase, amplitude)

    def stack_shape(self, n_frames: int) -> tuple[int, int, int, int]:
        """Return the shape (time, angle, y, x) of the phase of so many frames."""
        height, width = self.demodulate.output_shape
        return (n_frames, len(self.angles), height, width)

    def as_dataset(
        self, rec: Recording, phase: Any, amplitude: Any, shares: Sequence[Sequence[float]]
    ) -> xr.Dataset:
        """Return all frames' phase and amplitude, in memory or lazy, with axes and notes.

        The shares are what the work gave for each frame.
        """
        each = np.asarray(shares, dtype=np.float64)
        lost = np.isnan(each)
        whole = np.asarray(lost.all(axis=1))
        attrs = {
            **self.attrs,
            "background_share": 0.0 if lost.all() else float(np.nanmin(each)),
            "lost_times": np.flatnonzero(whole).tolist(),
            "lost_views": np.argwhere(lost & ~whole[:, None]).tolist(),
        }
        ratio = self.demodulate.pixel_ratio
        return as_dataset(rec, (self.angles, self.light), ratio, phase, amplitude, attrs)


def nothing_seen(phase: NDArray[np.float32], amplitude: NDArray[np.float32]) -> tuple[float, ...]:
    """Leave phase and amplitude of lost views (view, y, x) unknown."""
    phase[...] = amplitude[...] = np.nan
    return (math.nan,) * len(phase)


def propagator_for(
    frame_shape: tuple[int, int],
    shape: tuple[int, int],
    optics: Optics,
    distance_um: float,
    light: Sequence[float] | None = None,
) -> Carries:
    """Return what carries fields of some height and width, from such frames, over a distance.

    ``light`` is the wavelength of each view, where that is not the one of the optics.
    """
    height, width = (optics.pixel_um * n / m for n, m in zip(frame_shape, shape, strict=True))

    def of(wavelength_um: float) -> Propagator:
        return Propagator(shape, distance_um, wavelength_um, (height, width), optics.medium_index)

    return of(optics.wavelength_um) if light is None else EachByItsLight(tuple(map(of, light)))


@dataclass(frozen=True)
class Asked:
    """What the phase of one lobe depends on.

    Parameters
    ----------
    lobe : Lobe
        The view; its angle does not count.
    window : str
        How it is cut out.
    shape : tuple of int
        Height and width of its field.
    carried : tuple of (float, Optics), optional
        How far in micrometres it is carried along the light, and in which microscope.
    """

    lobe: Lobe
    window: str
    shape: tuple[int, int]
    carried: tuple[float, Optics] | None


class Preview:
    """Wrapped phase of one frame for one choice of lobes after the other.

    The frame is transformed once; for every choice only the lobes that changed are cut out and
    transformed back, with the numbers of `reconstruct` before it takes off references, background
    and drift. Several threads may use one preview.

    Parameters
    ----------
    frame : ndarray of shape (y, x)
        Grey values of any real type; it is best to leave integers as they are.

    Attributes
    ----------
    shape : tuple of int
        Height and width of the frame.

    Raises
    ------
    ValueError
        If the frame is no image.
    """

    def __init__(self, frame: NDArray[np.generic]) -> None:
        if frame.ndim != 2 or not frame.size:
            msg = f"a preview takes one frame (y, x), but got an array of shape {frame.shape}"
            raise ValueError(msg)
        self.shape: tuple[int, int] = (int(frame.shape[0]), int(frame.shape[1]))
        self._spectrum = half_spectrum(frame)
        self._spectrum[0, 0] = 0  # the mean grey value is no part of any fringes
        self._known: dict[Asked, NDArray[np.float32]] = {}

    def phases(
        self,
        lobes: Sequence[Lobe],
        window: str = "smooth-disk",
        *,
        refocus_um: float = 0.0,
        optics: Optics | None = None,
    ) -> list[NDArray[np.float32]]:
        """Return the wrapped phase of every lobe.

        The phase of the mean field is taken off, so that the picture does not flicker from drag
        to drag or from frame to frame. Rings show the rest: the object, and the tilt that is left
        where a circle does not sit on its carrier.

        Parameters
        ----------
        lobes : sequence of Lobe
            The views, in any order; there may be none.
        window : str, optional
            "disk", "smooth-disk" (default), "gaussian" or "tukey".
        refocus_um : float, optional
            How far to carry the fields along the light, in micrometres. Default 0.
        optics : Optics, optional
            The microscope, without which nothing is refocused.

        Returns
        -------
        list of ndarray of shape (y, x)
            Radians in [-pi, pi], one array a lobe, in the order of the lobes; all of the size that
            `reconstruct` gives these lobes.

        Raises
        ------
        ValueError
            If the window has no such name.
        """
        if not lobes:
            return []
        if not isinstance(window, str) or window not in WINDOWS:
            msg = f"window must be one of {', '.join(WINDOWS)}, but is {shown(window)}"
            raise ValueError(msg)
        shape = field_shape(self.shape, lobes, window)
        carried = (refocus_um, optics) if refocus_um and optics is not None else None
        asked = [Asked(replace(lobe, angle_deg=0.0), window, shape, carried) for lobe in lobes]
        known = self._known  # other threads may put another in its place
        phases = {each: known[each] if each in known else self._phase(each) for each in asked}
        self._known = phases
        return [phases[each] for each in asked]

    def _phase(self, asked: Asked) -> NDArray[np.float32]:
        """Return the wrapped phase of one lobe against that of its mean field."""
        held = np.arange(self._spectrum.shape[1])
        field = np.empty(asked.shape, dtype=np.complex64)
        cut_of(asked.lobe, asked.window, self.shape, asked.shape, held).field(
            self._spectrum, field
        )
        if asked.carried is not None:
            distance, optics = asked.carried
            own = asked.lobe.wavelength_um or optics.wavelength_um
            carry = propagator_for(self.shape, asked.shape, optics, distance, (own,))
            field = carry(field[None])[0]
        turn = np.exp(-1j * np.angle(field.mean(dtype=np.complex128)))
        field *= np.complex64(turn)
        phase = np.empty(asked.shape, dtype=np.float32)
        to_polar(field, np.empty_like(phase), phase)
        return phase


Stack = TypeVar("Stack", "xr.Dataset", "xr.DataArray")


def lobe_note(lobe: Lobe) -> dict[str, object]:
    """Return a lobe as JSON can hold it."""
    light = {} if lobe.wavelength_um is None else {"wavelength_um": lobe.wavelength_um}
    return {
        "carrier": list(lobe.carrier),
        "radius": lobe.radius,
        "angle_deg": lobe.angle_deg,
        "flip": lobe.flip,
        **light,
    }


def focus_note(focus: Focus) -> dict[str, object]:
    """Return how the focus was found, as JSON can hold it."""
    return {
        "focus_metric": focus.metric,
        "focus_objects": focus.objects,
        "focus_at_the_end": focus.at_the_end,
    }


def aberration_note(coefficients: NDArray[np.float64]) -> dict[str, float]:
    """Return a background's Zernike terms in radians rms, with their names or numbers.

    The constant is left out: it is set by the empty field of each frame.
    """
    return {
        ABERRATION_NAMES.get(j, f"Noll {j}"): round(float(value), 6)
        for j, value in enumerate(coefficients[1:], start=2)
    }


def times_and_places(
    rec: Recording, pixel_ratio: Sequence[float], shape: Sequence[int]
) -> dict[str, tuple[str, NDArray[np.floating], dict[str, str]]]:
    """Return the coordinates of time, y and x of a reconstruction.

    A place is that of a pixel's middle, counted from the middle of the first camera pixel, as in
    the recording: frames of both cover the same area.
    """
    rows, columns = (
        rec.optics.pixel_um * (middle_of_first(ratio) + ratio * np.arange(n))
        for n, ratio in zip(shape, pixel_ratio, strict=True)
    )
    return {
        "time": coordinate("time", rec.times_s),
        "y": coordinate("y", rows),
        "x": coordinate("x", columns),
    }


def recalibrated(stack: Stack, rec: Recording) -> Stack:
    """Return a reconstruction, or what was made of it, with a recording's new optics and times.

    Parameters
    ----------
    stack : Dataset or DataArray
        With ``attrs["pixel_ratio"]``, as `reconstruct` notes it.
    rec : Recording
        The same frames with another microscope or frame rate.

    Returns
    -------
    Dataset or DataArray
        The same pixels with new coordinates in seconds and micrometres, and new notes of the
        microscope; wavelengths that lobes named stay.
    """
    shape = (stack.sizes["y"], stack.sizes["x"])
    # Where lobes named their wavelengths, these stay as they are.
    noted = [note.get("wavelength_um") for note in stack.attrs.get("lobes", ())]
    changed = stack.assign_coords(times_and_places(rec, stack.attrs["pixel_ratio"], shape))
    light = {"medium_index": rec.optics.medium_index}
    if WAVELENGTH not in stack.coords and not any(noted):
        light["wavelength_um"] = rec.optics.wavelength_um
    changed.attrs = {**stack.attrs, **light}
    if isinstance(changed, xr.Dataset):
        for name, variable in changed.data_vars.items():
            changed[name] = variable.copy(deep=False).assign_attrs(light)
    return changed


def as_dataset(
    rec: Recording,
    views: tuple[list[float], tuple[float, ...] | None],
    pixel_ratio: tuple[float, float],
    phase: NDArray[np.float32],
    amplitude: NDArray[np.float32],
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Give the arrays their names, axes and units; views are their angles, and wavelengths."""
    angles, light = views
    coords = {
        "angle": coordinate("angle", np.asarray(angles)),
        **times_and_places(rec, pixel_ratio, phase.shape[2:]),
    }
    if light is not None:
        coords[WAVELENGTH] = wavelength_coordinate(np.asarray(light))
    return xr.Dataset(
        {
            "phase": xr.DataArray(
                phase, dims=AXES, attrs={"units": "rad", KIND: WRAPPED, **attrs}
            ),
            "amplitude": xr.DataArray(amplitude, dims=AXES, attrs={"units": "a.u.", **attrs}),
        },
        coords=coords,
        attrs=attrs,
    )
