"""The wrapped phase of one frame, fast enough to follow a circle under the mouse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.demodulation import Demodulator, half_spectrum
from napari_phase4d.holography.frames import propagator_for
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.optics import Optics

__all__ = ["Preview"]


class Preview:
    """Wrapped phase of one frame for one choice of lobes after the other.

    The frame is transformed once; for every choice only the lobes are cut out and transformed
    back, with the numbers of `reconstruct` before it takes off references, background and drift.
    Several threads may use one preview.

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
        demodulate = Demodulator(self.shape, lobes, window)
        fields = demodulate.from_half_spectrum(self._spectrum)
        if refocus_um and optics is not None:
            fields = propagator_for(demodulate, optics, refocus_um)(fields)
        return [steady_phase(field) for field in fields]


def steady_phase(field: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Return the wrapped phase of a field against that of its mean."""
    turned = field * np.exp(-1j * np.angle(field.mean(dtype=np.complex128))).astype(np.complex64)
    phase: NDArray[np.float32] = np.arctan2(turned.imag, turned.real)
    return phase
