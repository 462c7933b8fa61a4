"""How good an unwrapping is: errors against truth, and methods side by side."""

from napari_phase4d.evaluation.comparison import Comparison, compare
from napari_phase4d.evaluation.errors import (
    mean_squared_error,
    wrong_cycle_map,
    wrong_cycle_share,
)
from napari_phase4d.evaluation.figures import comparison_figure
from napari_phase4d.evaluation.itoh import itoh_margin, residues

__all__ = [
    "Comparison",
    "compare",
    "comparison_figure",
    "itoh_margin",
    "mean_squared_error",
    "residues",
    "wrong_cycle_map",
    "wrong_cycle_share",
]
