"""How good a hologram is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["fringe_contrast"]

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
