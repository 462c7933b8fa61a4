"""What the session can do: each piece of long work as a `Plan`."""

from napari_phase4d._napari.session.plans.cells import (
    plan_cell_by_methods,
    plan_cells,
    with_their_cells,
)
from napari_phase4d._napari.session.plans.live import plan_watching
from napari_phase4d._napari.session.plans.phase import (
    plan_focus,
    plan_lobes,
    plan_noise,
    plan_opening,
    plan_reconstruction,
    plan_spectrum,
)
from napari_phase4d._napari.session.plans.results import (
    plan_confidence,
    plan_estimate,
    plan_margin,
    plan_measuring,
    plan_saving,
    plan_scores,
    plan_truth,
    plan_unwrapping,
)

__all__ = [
    "plan_cell_by_methods",
    "plan_cells",
    "plan_confidence",
    "plan_estimate",
    "plan_focus",
    "plan_lobes",
    "plan_margin",
    "plan_measuring",
    "plan_noise",
    "plan_opening",
    "plan_reconstruction",
    "plan_saving",
    "plan_scores",
    "plan_spectrum",
    "plan_truth",
    "plan_unwrapping",
    "plan_watching",
    "with_their_cells",
]
