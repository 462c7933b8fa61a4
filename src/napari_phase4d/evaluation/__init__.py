"""How good an unwrapping is: errors against truth, and methods side by side."""

from napari_phase4d.evaluation.comparison import Comparison, compare
from napari_phase4d.evaluation.confidence import (
    REFERENCE,
    confidence_of,
    firmness,
    slip_warning,
    unsteadiness,
)
from napari_phase4d.evaluation.errors import (
    mean_squared_error,
    wrong_cycle_map,
    wrong_cycle_share,
)
from napari_phase4d.evaluation.figures import comparison_figure, movie_frames, phase_limits
from napari_phase4d.evaluation.itoh import itoh_margin, order_shares, residues
from napari_phase4d.evaluation.order import best_known, order_verdict

__all__ = [
    "REFERENCE",
    "Comparison",
    "best_known",
    "compare",
    "comparison_figure",
    "confidence_of",
    "firmness",
    "itoh_margin",
    "mean_squared_error",
    "movie_frames",
    "order_shares",
    "order_verdict",
    "phase_limits",
    "residues",
    "slip_warning",
    "unsteadiness",
    "wrong_cycle_map",
    "wrong_cycle_share",
]
