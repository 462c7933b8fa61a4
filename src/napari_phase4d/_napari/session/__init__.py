"""The controller between the dock and the pipeline, without Qt."""

from napari_phase4d._napari.session.opening import Opened
from napari_phase4d._napari.session.plans import (
    plan_cell_by_methods,
    plan_cells,
    plan_confidence,
    plan_focus,
    plan_lobes,
    plan_margin,
    plan_measuring,
    plan_opening,
    plan_reconstruction,
    plan_saving,
    plan_scores,
    plan_truth,
    plan_unwrapping,
    plan_watching,
    with_their_cells,
)
from napari_phase4d._napari.session.plans.live import LiveView
from napari_phase4d._napari.session.plans.phase import Plan
from napari_phase4d._napari.session.plans.results import Masks, MasksCall
from napari_phase4d._napari.session.session import Session
from napari_phase4d._napari.session.state import Changed
from napari_phase4d._napari.session.states import StepState, step_states

__all__ = [
    "Changed",
    "LiveView",
    "Masks",
    "MasksCall",
    "Opened",
    "Plan",
    "Session",
    "StepState",
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
    "with_their_cells",
]
