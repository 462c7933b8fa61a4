"""How good a hologram is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.demodulation import Demodulator

__all__ = ["fringe_contrast", "fringe_visibility"]

#: Fringes are looked at in squares of so many pixels, so that uneven light does not count.
BLOCK = 16


def fringe_contrast(frame: NDArray[np.floating]) -> float:
    """Return the contrast of the fringes, (max - min) / (max + min), from 0 to 1.

    Brightest and darkest grey value are the 98th and 2nd percentile of a small square, so that
    neither hot pixels nor uneven light count; the contrast is the median over all squares. Camera
    noise counts too.

    Parameters
    ----------
    frame : ndarray, shape (y, x)
        Grey values, 0 where it is dark.

    Returns
    -------
    float
        0 for a frame that is dark or constant.
    """
    side = min(BLOCK, *frame.shape)
    height, width = (n // side * side for n in frame.shape)
    blocks = frame[:height, :width].reshape(height // side, side, width // side, side)
    low, high = np.percentile(blocks, (2, 98), axis=(1, 3))
    lit = high + low > 0
    if not lit.any():
        return 0.0
    return float(np.median((high - low)[lit] / (high + low)[lit]))


def fringe_visibility(
    frame: NDArray[np.generic],
    demodulate: Demodulator,
    fields: NDArray[np.complex64] | None = None,
) -> list[float]:
    """Return the visibility of each view's own fringes in a frame.

    Fringes I (1 + V cos(2 pi k r)) leave a field of amplitude I V / 2 in their lobe; so V is twice
    the median amplitude over the mean grey value. Noise outside the lobe does not count, nor do
    the fringes of the other views, but a dark level of the camera counts as light.

    Parameters
    ----------
    frame : ndarray of shape (y, x)
        Grey values, 0 where it is dark.
    demodulate : Demodulator
        Gives the fields of all views.
    fields : ndarray of shape (view, y, x), optional
        What it gives for this frame, where that is known already.

    Returns
    -------
    list of float
        One a view, in the order of the demodulator's lobes; 0 for a dark frame.
    """
    mean = float(frame.mean(dtype=np.float64))
    if fields is None:
        fields = demodulate(frame)
    return [2 * float(np.median(np.abs(view))) / mean if mean > 0 else 0.0 for view in fields]
