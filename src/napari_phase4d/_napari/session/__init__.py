"""The controller between the dock and the pipeline, without Qt."""

from napari_phase4d._napari.session.cell_plans import (
    plan_cell_by_methods,
    plan_cells,
    with_their_cells,
)
from napari_phase4d._napari.session.history import StepNumber, as_sentence, news
from napari_phase4d._napari.session.live_plans import LiveView, plan_watching
from napari_phase4d._napari.session.opening import Opened
from napari_phase4d._napari.session.phase_plans import (
    Plan,
    plan_focus,
    plan_lobes,
    plan_opening,
    plan_reconstruction,
    with_known_views,
)
from napari_phase4d._napari.session.result_plans import (
    Masks,
    MasksCall,
    folder_without_results,
    plan_confidence,
    plan_margin,
    plan_measuring,
    plan_saving,
    plan_scores,
    plan_truth,
    plan_unwrapping,
)
from napari_phase4d._napari.session.session import Session
from napari_phase4d._napari.session.state import Changed, StepState, step_states

__all__ = [
    "Changed",
    "LiveView",
    "Masks",
    "MasksCall",
    "Opened",
    "Plan",
    "Session",
    "StepNumber",
    "StepState",
    "as_sentence",
    "folder_without_results",
    "news",
    "plan_cell_by_methods",
    "plan_cells",
    "plan_confidence",
    "plan_focus",
    "plan_lobes",
    "plan_margin",
    "plan_measuring",
    "plan_opening",
    "plan_reconstruction",
    "plan_saving",
    "plan_scores",
    "plan_truth",
    "plan_unwrapping",
    "plan_watching",
    "step_states",
    "with_known_views",
    "with_their_cells",
]
