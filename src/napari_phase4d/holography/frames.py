"""What is done with one camera frame: from its grey values to phase and amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.holography.datasets import as_dataset
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.frametilt import FrameTilt
from napari_phase4d.holography.lost import LostFrames
from napari_phase4d.holography.polar import remove_offset
from napari_phase4d.holography.refocusing import Propagator
from napari_phase4d.optics import Optics
from napari_phase4d.phasors import to_polar
from napari_phase4d.recording import BrokenFrameError, Recording

__all__ = ["FrameReconstructor", "propagator_for"]


class ReadsRawFrames(Protocol):
    """A recording, or what stands for one."""

    def raw_frame(self, index: int) -> NDArray[np.generic]:
        """Return one frame, shape (y, x)."""


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
    """

    demodulate: Demodulator
    factor: NDArray[np.complex64]
    drift: bool
    angles: list[float]
    attrs: dict[str, Any]
    refocus: Propagator | None = None
    lost: LostFrames | None = None
    tilt: FrameTilt | None = None

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
            Smallest share, of all views, of pixels that look like background; 1 if not looked at,
            NaN if the camera lost the frame, whose phase and amplitude are NaN then.
        """
        fields = self.demodulate(frame)
        if self.lost is not None and self.lost.reason(frame, fields):
            return nothing_seen(phase, amplitude)
        fields = self.corrected(fields)
        for view in zip(fields, amplitude, phase, strict=True):
            to_polar(*view)
        if not self.drift:
            return 1.0
        return min(remove_offset(*view) for view in zip(fields, phase, strict=True))

    def fields(self, frame: NDArray[np.generic]) -> NDArray[np.complex64]:
        """Return the corrected and refocused fields of all views of a frame, (view, y, x)."""
        return self.corrected(self.demodulate(frame))

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
    ) -> float:
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
        self, rec: Recording, phase: Any, amplitude: Any, shares: Sequence[float]
    ) -> xr.Dataset:
        """Return all frames' phase and amplitude, in memory or lazy, with axes and notes.

        The shares are what the work gave for each frame.
        """
        lost = [time for time, share in enumerate(shares) if np.isnan(share)]
        lowest = min((share for share in shares if not np.isnan(share)), default=0.0)
        attrs = {**self.attrs, "background_share": lowest, "lost_times": lost}
        ratio = self.demodulate.pixel_ratio
        return as_dataset(rec, self.angles, ratio, phase, amplitude, attrs)


def nothing_seen(phase: NDArray[np.float32], amplitude: NDArray[np.float32]) -> float:
    """Leave a lost frame's phase and amplitude unknown."""
    phase[...] = amplitude[...] = np.nan
    return float("nan")


def propagator_for(
    frame_shape: tuple[int, int], shape: tuple[int, int], optics: Optics, distance_um: float
) -> Propagator:
    """Return what carries fields of some height and width, from such frames, over a distance."""
    height, width = (optics.pixel_um * n / m for n, m in zip(frame_shape, shape, strict=True))
    return Propagator(
        shape, distance_um, optics.wavelength_um, (height, width), optics.medium_index
    )
