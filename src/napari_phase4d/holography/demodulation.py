"""From one hologram frame to the complex field of every view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.holography.windows import WINDOWS, window_reach

__all__ = ["Demodulator"]


@dataclass(frozen=True)
class Cut:
    """Where one lobe lies in the half spectrum, in the order of the small inverse transform."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    mirrored: NDArray[np.bool_]
    window: NDArray[np.float32]
    ramp: NDArray[np.complex64]
    flip: bool


class Demodulator:
    """Cuts all lobes out of one real Fourier transform of a frame.

    One `rfft2` in float32 serves all views. Each lobe is cut out with its window, moved to zero
    frequency, and transformed back on a grid just large enough for it; the part of the carrier
    below one spectral pixel is taken off by a phase ramp. All views share one output grid.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    lobes : sequence of Lobe
        The views.
    window : str, optional
        "disk", "smooth-disk" (default), "gaussian" or "tukey".

    Attributes
    ----------
    output_shape : tuple of int
        Height and width of the fields.
    pixel_ratio : tuple of float
        Height and width of an output pixel in camera pixels.

    Raises
    ------
    ValueError
        If there is no lobe, or the window has no such name.
    """

    def __init__(
        self, shape: tuple[int, ...], lobes: Sequence[Lobe], window: str = "smooth-disk"
    ) -> None:
        if not lobes:
            msg = "there is no lobe to demodulate; find or place at least one"
            raise ValueError(msg)
        if window not in WINDOWS:
            msg = f"window must be one of {', '.join(WINDOWS)}, but is {window!r}"
            raise ValueError(msg)
        self.shape = (int(shape[0]), int(shape[1]))
        reach = max(lobe.radius for lobe in lobes) * window_reach(window)
        self.output_shape = (grid_length(reach, self.shape[0]), grid_length(reach, self.shape[1]))
        self.pixel_ratio = (
            self.shape[0] / self.output_shape[0],
            self.shape[1] / self.output_shape[1],
        )
        self._cuts = [self._cut(lobe, window) for lobe in lobes]
        self._scale = np.float32(math.prod(self.output_shape) / math.prod(self.shape))

    def __call__(self, frame: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Return the fields of all views, shape (view, y, x), complex64."""
        half = scipy.fft.rfft2(frame - frame.mean(dtype=np.float64).astype(np.float32))
        fields = np.empty((len(self._cuts), *self.output_shape), dtype=np.complex64)
        for field, cut in zip(fields, self._cuts, strict=True):
            block = cut_out(half, cut) * cut.window
            np.multiply(scipy.fft.ifft2(block, overwrite_x=True), cut.ramp, out=field)
            field *= self._scale
            if cut.flip:
                np.conjugate(field, out=field)
        return fields

    def _cut(self, lobe: Lobe, window: str) -> Cut:
        """Prepare indices, window and ramp of one lobe."""
        offsets, indices, ramps = [], [], []
        for k, n, m in zip(lobe.carrier, self.shape, self.output_shape, strict=True):
            centre = round(k * n)
            steps = np.round(scipy.fft.fftfreq(m, 1 / m)).astype(int)
            indices.append((centre + steps) % n)
            offsets.append((centre + steps) / n - k)
            position = np.arange(m) * (n / m)
            ramps.append(np.exp(-2j * np.pi * (k - centre / n) * position))
        rho = np.hypot(offsets[0][:, None], offsets[1][None, :]) / lobe.radius
        width = self.shape[1]
        mirrored = indices[1] > width // 2
        return Cut(
            rows=indices[0],
            columns=np.where(mirrored, width - indices[1], indices[1]),
            mirrored=mirrored,
            window=WINDOWS[window](rho).astype(np.float32),
            ramp=np.outer(*ramps).astype(np.complex64),
            flip=lobe.flip,
        )


def cut_out(half: NDArray[np.complex64], cut: Cut) -> NDArray[np.complex64]:
    """Return a lobe's block; columns with kx < 0 come from the conjugate F(-k) = F(k)*."""
    if not cut.mirrored.any():
        return half[cut.rows[:, None], cut.columns[None, :]]
    block = np.empty((len(cut.rows), len(cut.columns)), dtype=half.dtype)
    direct = ~cut.mirrored
    block[:, direct] = half[cut.rows[:, None], cut.columns[None, direct]]
    opposite = (-cut.rows) % half.shape[0]
    block[:, cut.mirrored] = half[opposite[:, None], cut.columns[None, cut.mirrored]].conj()
    return block


def grid_length(reach: float, n: int) -> int:
    """Return the shortest quickly transformed length that holds +-reach of n frequencies."""
    needed = 2 * math.ceil(reach * n) + 2
    return min(int(scipy.fft.next_fast_len(needed)), n)
