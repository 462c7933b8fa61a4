"""The wrapped phase of one frame, fast enough to follow a circle under the mouse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.demodulation import cut_of, field_shape, half_spectrum
from napari_phase4d.holography.frames import propagator_for
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.holography.windows import WINDOWS
from napari_phase4d.optics import Optics
from napari_phase4d.phasors import to_polar

__all__ = ["Preview"]


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
        if window not in WINDOWS:
            msg = f"window must be one of {', '.join(WINDOWS)}, but is {window!r}"
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
            carry = propagator_for(self.shape, asked.shape, optics, distance)
            field = carry(field[None])[0]
        turn = np.exp(-1j * np.angle(field.mean(dtype=np.complex128)))
        field *= np.complex64(turn)
        phase = np.empty(asked.shape, dtype=np.float32)
        to_polar(field, np.empty_like(phase), phase)
        return phase
