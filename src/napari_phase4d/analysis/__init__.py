"""How good an unwrapping is, methods side by side, and what they say of the object."""

from napari_phase4d.analysis.cell_results import (
    Cells,
    CellSettings,
    cells_in,
    region_with_cell,
    summary_of_cells,
    with_empty_field,
)
from napari_phase4d.analysis.cells import copied_labels, find_cells, follow_cells
from napari_phase4d.analysis.comparison import Comparison, compare, compare_on
from napari_phase4d.analysis.confidence import REFERENCE, confidence
from napari_phase4d.analysis.differences import (
    Traces,
    as_truth,
    difference,
    mean_squared_error,
    traces,
    traces_of,
    wrong_cycle_map,
    wrong_cycle_share,
)
from napari_phase4d.analysis.itoh import itoh_margin, order_shares, residues
from napari_phase4d.analysis.measures import measure, polygon_mask, region_masks
from napari_phase4d.analysis.noise import noise_figures, noise_sentence, with_wavelength
from napari_phase4d.analysis.slips import Tally, slip_warning, slipped_frames
from napari_phase4d.analysis.verdict import (
    Verdict,
    best_known,
    most_trusted,
    order_verdict,
    steps_sentence,
)
from napari_phase4d.stack import frame_of, in_memory

__all__ = [
    "REFERENCE",
    "CellSettings",
    "Cells",
    "Comparison",
    "Tally",
    "Traces",
    "Verdict",
    "as_truth",
    "best_known",
    "cells_in",
    "compare",
    "compare_on",
    "confidence",
    "copied_labels",
    "difference",
    "find_cells",
    "follow_cells",
    "frame_of",
    "in_memory",
    "itoh_margin",
    "mean_squared_error",
    "measure",
    "most_trusted",
    "noise_figures",
    "noise_sentence",
    "order_shares",
    "order_verdict",
    "polygon_mask",
    "region_masks",
    "region_with_cell",
    "residues",
    "slip_warning",
    "slipped_frames",
    "steps_sentence",
    "summary_of_cells",
    "traces",
    "traces_of",
    "with_empty_field",
    "with_wavelength",
    "wrong_cycle_map",
    "wrong_cycle_share",
]
