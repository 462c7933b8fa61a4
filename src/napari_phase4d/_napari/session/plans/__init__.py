"""What the session can do: each piece of long work as a `Plan`."""

from napari_phase4d._napari.session.plans.judging import (
    plan_confidence,
    plan_margin,
    plan_truth,
)
from napari_phase4d._napari.session.plans.lobes import plan_lobes, plan_opening, plan_spectrum
from napari_phase4d._napari.session.plans.measuring import plan_measuring
from napari_phase4d._napari.session.plans.phase import (
    plan_focus,
    plan_noise,
    plan_reconstruction,
)
from napari_phase4d._napari.session.plans.results import (
    plan_estimate,
    plan_scores,
    plan_unwrapping,
)

__all__ = [
    "plan_confidence",
    "plan_estimate",
    "plan_focus",
    "plan_lobes",
    "plan_margin",
    "plan_measuring",
    "plan_noise",
    "plan_opening",
    "plan_reconstruction",
    "plan_scores",
    "plan_spectrum",
    "plan_truth",
    "plan_unwrapping",
]
