"""From hologram frames to wrapped phase: spectrum, lobes, demodulation, background."""

from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.finding import find_lobes
from napari_phase4d.holography.lobes import Lobe, pair_distance
from napari_phase4d.holography.overlaps import StrayTerm, lobe_warnings, stray_terms
from napari_phase4d.holography.preview import Preview
from napari_phase4d.holography.quality import fringe_contrast
from napari_phase4d.holography.reconstruction import (
    BACKGROUND_ORDERS,
    FrameWork,
    prepared,
    recalibrated,
    reconstruct,
)
from napari_phase4d.holography.spectrum import power_spectrum
from napari_phase4d.holography.windows import WINDOWS

__all__ = [
    "BACKGROUND_ORDERS",
    "WINDOWS",
    "Demodulator",
    "FrameWork",
    "Lobe",
    "Preview",
    "StrayTerm",
    "find_lobes",
    "fringe_contrast",
    "lobe_warnings",
    "pair_distance",
    "power_spectrum",
    "prepared",
    "recalibrated",
    "reconstruct",
    "stray_terms",
]
