"""From a recording and its lobes to wrapped phase and amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.holography.background import (
    ENOUGH_BACKGROUND,
    background_offset,
    fit_background,
    flat_share,
)
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads
from napari_phase4d.recording import Recording

__all__ = ["BACKGROUND_ORDERS", "FrameWork", "prepared", "recalibrated", "reconstruct"]

#: What to take off the background, and the order of the polynomial that does it.
BACKGROUND_ORDERS = {"none": 0, "tilt": 1, "curvature": 2}
#: Frames from which the static background and the median reference are measured.
STATIC_FRAMES = 32
#: Below this share of its median the reference's amplitude is not divided by.
DARKEST_REFERENCE = 0.05

Reference = Any
Stack = TypeVar("Stack", xr.Dataset, xr.DataArray)


def reconstruct(
    rec: Recording,
    lobes: Sequence[Lobe],
    reference: Reference = None,
    *,
    window: str = "smooth-disk",
    background: str = "tilt",
    drift: bool = True,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Reconstruct the wrapped phase and the amplitude of every view and frame.

    Parameters
    ----------
    rec : Recording
        The hologram video; read one frame at a time.
    lobes : sequence of Lobe
        The views; the result holds them in the order of their angles. Where two have the same
        angle, the views are numbered instead.
    reference : optional
        What to divide the field by, so that static errors of the optics drop out: ``None`` for
        nothing, a frame number, ``"median"`` for the median over time, or a hologram without
        the object as an array (y, x) or Recording.
    window : str, optional
        How a lobe is cut out: "disk", "smooth-disk" (default), "gaussian" or "tukey".
    background : str, optional
        What to fit to the empty field and take off, once for the whole recording: "tilt"
        (default), "curvature" (tilt and curvature) or "none".
    drift : bool, optional
        Whether to set the phase of the empty field to zero in every frame. Default True.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each frame; ``cancelled()`` stops the work.

    Returns
    -------
    xarray.Dataset
        ``phase`` wrapped to (-pi, pi] and ``amplitude``, float32, dims (time, angle, y, x).
        The pixel is larger than the camera's, since the lobe holds fewer frequencies than the
        frame; ``attrs["pixel_ratio"]`` says by how much.

    Raises
    ------
    ValueError
        If an option has no such value or the reference does not fit the frames.
    Cancelled
        If ``cancelled()`` returned True.
    """
    work = prepared(
        rec,
        lobes,
        reference,
        window=window,
        background=background,
        drift=drift,
        cancelled=cancelled,
    )
    phase = np.empty(work.stack_shape(rec.n_frames), dtype=np.float32)
    amplitude = np.empty_like(phase)

    def into_place(index: int) -> float:
        return work(rec.raw_frame(index), phase[index], amplitude[index])

    watch = Watch(rec.n_frames, "reconstruct", progress, cancelled)
    lowest_share = min(in_threads(into_place, range(rec.n_frames), watch))
    return work.as_dataset(rec, phase, amplitude, lowest_share)


@dataclass(frozen=True)
class FrameWork:
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
    """

    demodulate: Demodulator
    factor: NDArray[np.complex64]
    drift: bool
    angles: list[float]
    attrs: dict[str, Any]

    def __call__(
        self,
        frame: NDArray[np.generic],
        phase: NDArray[np.float32],
        amplitude: NDArray[np.float32],
    ) -> float:
        """Write the phase and amplitude of a frame, each (view, y, x).

        Returns
        -------
        float
            Smallest share, of all views, of pixels that look like background; 1 if not looked at.
        """
        fields = self.demodulate(frame)
        fields *= self.factor
        np.abs(fields, out=amplitude)
        np.arctan2(fields.imag, fields.real, out=phase)
        if not self.drift:
            return 1.0
        return min(remove_offset(*view) for view in zip(fields, phase, strict=True))

    def stack_shape(self, n_frames: int) -> tuple[int, int, int, int]:
        """Return the shape (time, angle, y, x) of the phase of so many frames."""
        height, width = self.demodulate.output_shape
        return (n_frames, len(self.angles), height, width)

    def as_dataset(
        self, rec: Recording, phase: Any, amplitude: Any, lowest_share: float
    ) -> xr.Dataset:
        """Return all frames' phase and amplitude, in memory or lazy, with axes and notes."""
        attrs = {**self.attrs, "background_share": lowest_share}
        ratio = self.demodulate.pixel_ratio
        return as_dataset(rec, self.angles, ratio, phase, amplitude, attrs)


def prepared(
    rec: Recording,
    lobes: Sequence[Lobe],
    reference: Reference = None,
    *,
    window: str = "smooth-disk",
    background: str = "tilt",
    drift: bool = True,
    cancelled: CancelledCall | None = None,
) -> FrameWork:
    """Measure what all frames have in common; see `reconstruct` for the arguments."""
    if background not in BACKGROUND_ORDERS:
        msg = f"background must be one of {', '.join(BACKGROUND_ORDERS)}, but is {background!r}"
        raise ValueError(msg)
    if not isinstance(rec, Recording) or not all(isinstance(lobe, Lobe) for lobe in lobes):
        msg = "reconstruct() takes a Recording from open_recording() and a list of Lobe"
        raise TypeError(msg)
    lobes, angles = in_order_of_angle(lobes)
    demodulate = Demodulator(rec.frame_shape, lobes, window)
    factor = corrections(rec, demodulate, reference, BACKGROUND_ORDERS[background], cancelled)
    attrs = {
        "wavelength_um": rec.optics.wavelength_um,
        "recording": rec.name,
        "lobes": [lobe_note(lobe) for lobe in lobes],
        "window": window,
        "background": background,
        "drift_removed": drift,
        "reference": reference_note(reference),
        "pixel_ratio": list(demodulate.pixel_ratio),
    }
    return FrameWork(demodulate, factor, drift, angles, attrs)


def in_order_of_angle(lobes: Sequence[Lobe]) -> tuple[list[Lobe], list[float]]:
    """Return the lobes sorted by angle, and their angles (numbers if not all differ)."""
    ordered = sorted(lobes, key=lambda lobe: lobe.angle_deg)
    angles = [lobe.angle_deg for lobe in ordered]
    if len(set(angles)) < len(angles):
        return list(lobes), [float(i) for i in range(len(angles))]
    return ordered, angles


def remove_offset(field: NDArray[np.complex64], phase: NDArray[np.float32]) -> float:
    """Set the background of a wrapped phase to zero, if its field shows enough of one.

    Returns
    -------
    float
        Share of the pixels that look like background.
    """
    offset = background_offset(field, phase)
    share = flat_share(phase, offset)
    if share >= ENOUGH_BACKGROUND:
        phase -= offset
        phase[phase <= -np.pi] += 2 * np.pi
        phase[phase > np.pi] -= 2 * np.pi
    return share


def corrections(
    rec: Recording,
    demodulate: Demodulator,
    reference: Reference,
    order: int,
    cancelled: CancelledCall | None,
) -> NDArray[np.complex64]:
    """Return what to multiply the fields of all frames by, shape (view, y, x) or (1, 1, 1).

    It divides by the reference and takes off the phase that the empty field has in all frames.
    """
    factor = np.ones((1, 1, 1), dtype=np.complex64)
    by_median = isinstance(reference, str) and reference == "median"
    if reference is not None and not by_median:
        factor = inverse(demodulate(reference_frame(rec, reference)))
    if order or by_median:
        static = static_fields(rec, demodulate, cancelled)
    if by_median:
        factor = inverse(median_fields(static))
    if order:
        static *= factor
        surfaces = np.stack([fit_background(view, order) for view in static.swapaxes(0, 1)])
        factor = factor * np.exp(-1j * surfaces).astype(np.complex64)
    return factor


def inverse(fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return 1 / the fields of a reference, held small where the reference is dark."""
    amplitude = np.abs(fields)
    darkest = DARKEST_REFERENCE * np.median(amplitude, axis=(1, 2), keepdims=True)
    if not (darkest > 0).all():
        msg = "the reference shows no fringes in at least one lobe; choose another reference"
        raise ValueError(msg)
    result: NDArray[np.complex64] = fields.conj() / np.maximum(amplitude, darkest) ** 2
    return result


def static_fields(
    rec: Recording, demodulate: Demodulator, cancelled: CancelledCall | None
) -> NDArray[np.complex64]:
    """Return the fields of some frames, spread over the recording, (frame, view, y, x)."""
    indices = rec.sample_indices(STATIC_FRAMES)
    watch = Watch(len(indices), "look at the background", None, cancelled)
    return np.stack(list(in_threads(lambda i: demodulate(rec.raw_frame(i)), indices, watch)))


def median_fields(stack: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the median over time of fields, whose constant phases are aligned in place."""
    overlap = np.einsum("avyx,vyx->av", stack, stack[0].conj())
    stack *= np.exp(-1j * np.angle(overlap)).astype(np.complex64)[..., None, None]
    middle: NDArray[np.complex64] = (
        np.median(stack.real, axis=0) + 1j * np.median(stack.imag, axis=0)
    ).astype(np.complex64)
    return middle


def reference_frame(rec: Recording, reference: Reference) -> NDArray[np.generic]:
    """Return the frame of the reference: the mean, if it is a recording of several."""
    if isinstance(reference, (int, np.integer)):
        if not -rec.n_frames <= reference < rec.n_frames:
            msg = (
                f"reference frame {reference} does not exist; {rec.name} has {rec.n_frames} frames"
            )
            raise ValueError(msg)
        return rec.raw_frame(int(reference) % rec.n_frames)
    if isinstance(reference, Recording):
        recording = reference
    elif isinstance(reference, (str, Path)):
        msg = f"open the reference {reference} with open_recording() first"
        raise TypeError(msg)
    else:
        recording = Recording.from_frames(reference, optics=rec.optics, name="the reference")
    if recording.frame_shape != rec.frame_shape:
        msg = (
            f"the reference is {recording.frame_shape} pixels, "
            f"but the frames are {rec.frame_shape}"
        )
        raise ValueError(msg)
    total = np.zeros(rec.frame_shape)
    for frame in recording.frames():
        total += frame
    return (total / recording.n_frames).astype(np.float32)


def lobe_note(lobe: Lobe) -> dict[str, object]:
    """Return a lobe as JSON can hold it."""
    return {
        "carrier": list(lobe.carrier),
        "radius": lobe.radius,
        "angle_deg": lobe.angle_deg,
        "flip": lobe.flip,
    }


def reference_note(reference: Reference) -> str:
    """Say in a few words what was divided by."""
    if reference is None:
        return "none"
    if isinstance(reference, Recording):
        return reference.name
    if isinstance(reference, (int, np.integer)):
        return f"frame {reference}"
    return reference if isinstance(reference, str) else "array"


def times_and_places(
    rec: Recording, pixel_ratio: Sequence[float], shape: Sequence[int]
) -> dict[str, tuple[str, NDArray[np.floating], dict[str, str]]]:
    """Return the coordinates of time, y and x of a reconstruction."""
    step_y, step_x = (rec.optics.pixel_um * ratio for ratio in pixel_ratio)
    return {
        "time": ("time", rec.times_s, {"units": "s"}),
        "y": ("y", np.arange(shape[0]) * step_y, {"units": "um"}),
        "x": ("x", np.arange(shape[1]) * step_x, {"units": "um"}),
    }


def recalibrated(stack: Stack, rec: Recording) -> Stack:
    """Return a reconstruction, or what was made of it, with a recording's new optics and times.

    Parameters
    ----------
    stack : Dataset or DataArray
        With ``attrs["pixel_ratio"]``, as `reconstruct` notes it.
    rec : Recording
        The same frames with another microscope or frame rate.
    """
    shape = (stack.sizes["y"], stack.sizes["x"])
    changed = stack.assign_coords(times_and_places(rec, stack.attrs["pixel_ratio"], shape))
    wavelength = {"wavelength_um": rec.optics.wavelength_um}
    changed.attrs = {**stack.attrs, **wavelength}
    if isinstance(changed, xr.Dataset):
        for name, variable in changed.data_vars.items():
            changed[name] = variable.copy(deep=False).assign_attrs(wavelength)
    return changed


def as_dataset(
    rec: Recording,
    angles: list[float],
    pixel_ratio: tuple[float, float],
    phase: NDArray[np.float32],
    amplitude: NDArray[np.float32],
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Give the arrays their names, axes and units."""
    coords = {
        "angle": ("angle", np.asarray(angles), {"units": "deg"}),
        **times_and_places(rec, pixel_ratio, phase.shape[2:]),
    }
    dims = ("time", "angle", "y", "x")
    return xr.Dataset(
        {
            "phase": xr.DataArray(phase, dims=dims, attrs={"units": "rad", **attrs}),
            "amplitude": xr.DataArray(amplitude, dims=dims, attrs={"units": "a.u.", **attrs}),
        },
        coords=coords,
        attrs=attrs,
    )
