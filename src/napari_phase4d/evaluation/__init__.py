"""How good an unwrapping is, methods side by side, and what they say of the object."""

from napari_phase4d.evaluation.comparing import compare, compare_on
from napari_phase4d.evaluation.comparison import Comparison
from napari_phase4d.evaluation.confidence import (
    REFERENCE,
    confidence,
    slip_warning,
    slipped_frames,
)
from napari_phase4d.evaluation.errors import (
    mean_squared_error,
    wrong_cycle_map,
    wrong_cycle_share,
)
from napari_phase4d.evaluation.figures import comparison_figure, movie_frames, phase_limits
from napari_phase4d.evaluation.itoh import itoh_margin, order_shares, residues
from napari_phase4d.evaluation.loading import in_memory
from napari_phase4d.evaluation.look_figure import Circle, look_figure
from napari_phase4d.evaluation.measures import measure
from napari_phase4d.evaluation.noise import noise_figures, noise_sentence, with_wavelength
from napari_phase4d.evaluation.order import (
    best_known,
    most_trusted,
    order_verdict,
    steps_sentence,
)
from napari_phase4d.evaluation.regions import polygon_mask, region_masks
from napari_phase4d.evaluation.telling import EXACT, named_results, telling_frames
from napari_phase4d.evaluation.traces import Traces, difference, traces
from napari_phase4d.evaluation.verdict import Verdict

__all__ = [
    "EXACT",
    "REFERENCE",
    "Circle",
    "Comparison",
    "Traces",
    "Verdict",
    "best_known",
    "compare",
    "compare_on",
    "comparison_figure",
    "confidence",
    "difference",
    "in_memory",
    "itoh_margin",
    "look_figure",
    "mean_squared_error",
    "measure",
    "most_trusted",
    "movie_frames",
    "named_results",
    "noise_figures",
    "noise_sentence",
    "order_shares",
    "order_verdict",
    "phase_limits",
    "polygon_mask",
    "region_masks",
    "residues",
    "slip_warning",
    "slipped_frames",
    "steps_sentence",
    "telling_frames",
    "traces",
    "with_wavelength",
    "wrong_cycle_map",
    "wrong_cycle_share",
]
