"""From hologram frames to wrapped phase: spectrum, lobes, demodulation, background, focus."""

from napari_phase4d.holography.aberrations import MAX_ORDER, MIN_ORDER
from napari_phase4d.holography.corrections import BACKGROUND_ORDERS
from napari_phase4d.holography.demodulation import WINDOWS, Demodulator
from napari_phase4d.holography.finding import FoundLobes, find_lobes, warn_of_doubts
from napari_phase4d.holography.focusing import (
    FOCUS_METRICS,
    FOCUS_OBJECTS,
    Focus,
    autofocus,
    depth_of_focus_um,
)
from napari_phase4d.holography.frames import FrameReconstructor, Preview, recalibrated
from napari_phase4d.holography.lobes import (
    MAX_VIEWS,
    Lobe,
    StrayTerm,
    angles_unknown,
    light_of,
    lobe_warnings,
    pair_distance,
    stray_terms,
)
from napari_phase4d.holography.lost import first_seen, lost_sentence
from napari_phase4d.holography.quality import (
    fringe_contrast,
    fringe_mask,
    fringe_visibility,
    times_of_views,
)
from napari_phase4d.holography.reconstruction import (
    PhaseSettings,
    beginning_of,
    find_focus,
    frame_reconstructor,
    reconstruct,
    reconstruct_frames,
    reconstruction_advice,
)
from napari_phase4d.holography.refocusing import Propagator, propagate, refocused
from napari_phase4d.holography.spectrum import lost_frames, power_spectrum

__all__ = [
    "BACKGROUND_ORDERS",
    "FOCUS_METRICS",
    "FOCUS_OBJECTS",
    "MAX_ORDER",
    "MAX_VIEWS",
    "MIN_ORDER",
    "WINDOWS",
    "Demodulator",
    "Focus",
    "FoundLobes",
    "FrameReconstructor",
    "Lobe",
    "PhaseSettings",
    "Preview",
    "Propagator",
    "StrayTerm",
    "angles_unknown",
    "autofocus",
    "beginning_of",
    "depth_of_focus_um",
    "find_focus",
    "find_lobes",
    "first_seen",
    "frame_reconstructor",
    "fringe_contrast",
    "fringe_mask",
    "fringe_visibility",
    "light_of",
    "lobe_warnings",
    "lost_frames",
    "lost_sentence",
    "pair_distance",
    "power_spectrum",
    "propagate",
    "recalibrated",
    "reconstruct",
    "reconstruct_frames",
    "reconstruction_advice",
    "refocused",
    "stray_terms",
    "times_of_views",
    "warn_of_doubts",
]
