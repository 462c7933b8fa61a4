"""A power spectrum as a grey picture that shows its peaks at every size."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from qtpy.QtCore import QRectF
from qtpy.QtGui import QImage, QPainter, QPixmap

__all__ = ["SpectrumPicture", "grey_image", "log_power", "pooled"]

#: Darkest and brightest shown, as quantiles of the log power.
SHOWN = (0.3, 0.9999)


class SpectrumPicture:
    """Log power in the Fourier plane, drawn in cycles per pixel: kx to the right, ky downwards.

    Parameters
    ----------
    spectrum : xarray.DataArray
        Power, dims (ky, kx), zero frequency in the middle.
    """

    def __init__(self, spectrum: xr.DataArray) -> None:
        self._power = np.asarray(spectrum.values, dtype=np.float32)
        self._pixmaps: dict[int, QPixmap] = {}

    def paint(self, painter: QPainter, pixels_per_cycle: float) -> None:
        """Draw it with a painter in cycles per pixel.

        Parameters
        ----------
        painter : QPainter
            What draws.
        pixels_per_cycle : float
            Pixels of the screen for one cycle per pixel, the width of the whole plane.
        """
        step = self._step(pixels_per_cycle)
        if step not in self._pixmaps:
            grey = log_power(pooled(self._power, step))
            self._pixmaps[step] = QPixmap.fromImage(grey_image(grey))
        pixmap = self._pixmaps[step]
        height, width = self._power.shape
        # Pixel n // 2 is frequency zero and is drawn with its middle there.
        place = QRectF(
            -(width // 2 + 0.5) / width,
            -(height // 2 + 0.5) / height,
            pixmap.width() * step / width,
            pixmap.height() * step / height,
        )
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        painter.drawPixmap(place, pixmap, QRectF(pixmap.rect()))

    def _step(self, pixels_per_cycle: float) -> int:
        """Return how many pixels a side to join, so that none is smaller than the screen's."""
        step = 1
        while 2 * step * pixels_per_cycle <= max(self._power.shape):
            step *= 2
        return step


def pooled(power: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return the mean of blocks of ``step`` by ``step`` pixels; the last ones may be smaller.

    Joined pixels keep narrow peaks, which a smaller picture of the logarithm would lose.
    """
    if step == 1:
        return power
    for axis, n in enumerate(power.shape):
        starts = np.arange(0, n, step)
        counts = np.diff(np.append(starts, n)).astype(np.float32)
        sums: NDArray[np.float32] = np.add.reduceat(power, starts, axis=axis)
        sums /= counts[:, None] if axis == 0 else counts
        power = sums
    return power


def log_power(power: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the logarithm of a power spectrum as grey values 0 to 255."""
    logs = np.log10(np.maximum(power, np.finfo(np.float32).tiny))
    low, high = np.quantile(logs, SHOWN)
    scaled = (logs - low) / max(high - low, 1e-9)
    grey: NDArray[np.uint8] = (255 * np.clip(scaled, 0, 1)).astype(np.uint8)
    return grey


def grey_image(grey: NDArray[np.uint8]) -> QImage:
    """Return grey values as a picture that owns its pixels."""
    height, width = grey.shape
    data = np.ascontiguousarray(grey)
    return QImage(data.tobytes(), width, height, width, QImage.Format.Format_Grayscale8).copy()
