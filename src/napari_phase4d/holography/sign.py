"""Which of the two conjugate terms shows a dense object bright."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skimage.restoration import unwrap_phase

from napari_phase4d.holography.background import fit_background
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.lobes import Lobe

__all__ = ["object_is_dark"]

#: Skewness of the unwrapped phase beyond which an object is taken as clearly seen.
CLEAR_SKEWNESS = 1.0
#: The same for the size of the object's phase, in radians.
CLEAR_PHASE_RAD = 0.5


#: Pixels with less than this share of the median amplitude are left out.
DARK_SHARE = 0.3


def object_is_dark(frame: NDArray[np.float32], lobe: Lobe) -> bool:
    """Say whether a clear object has less phase than its background in this lobe.

    The phase of one frame is unwrapped and flattened. A cell on an empty field gives a skewed
    histogram with its tail on the cell's side; only a tail that is long and clear counts, so
    that an empty or patterned field is left as it is.
    """
    field = Demodulator(frame.shape, [lobe])(frame)[0]
    flat = field * np.exp(-1j * fit_background(field[None], order=2))
    edge = max(2, min(flat.shape) // 16)
    inside = np.zeros(flat.shape, dtype=bool)
    inside[edge:-edge, edge:-edge] = True
    # Where there are no fringes the phase is noise, and may lie far off on either side.
    inside &= np.abs(field) > DARK_SHARE * np.median(np.abs(field))
    phase = unwrap_phase(np.ma.masked_array(np.angle(flat), ~inside))
    phase = np.asarray(phase[inside])
    deviation = phase - np.median(phase)
    scale = float(deviation.std())
    if scale < CLEAR_PHASE_RAD / 3:
        return False
    skewness = float(np.mean(deviation**3)) / scale**3
    tail = float(np.quantile(deviation, 0.01))
    return skewness < -CLEAR_SKEWNESS and tail < -CLEAR_PHASE_RAD
