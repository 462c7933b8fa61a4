"""The session: its state, and each step's work as one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d._napari.session.cell_plans import plan_cells
from napari_phase4d._napari.session.live_plans import PATIENCE_S, plan_watching
from napari_phase4d._napari.session.phase_plans import (
    Plan,
    plan_focus,
    plan_lobes,
    plan_noise,
    plan_reconstruction,
    plan_spectrum,
)
from napari_phase4d._napari.session.result_plans import (
    Masks,
    plan_confidence,
    plan_estimate,
    plan_margin,
    plan_measuring,
    plan_saving,
    plan_scores,
    plan_unwrapping,
)
from napari_phase4d._napari.session.state import State
from napari_phase4d.analysis import REFERENCE, Cells, CellSettings
from napari_phase4d.holography import Focus, Lobe
from napari_phase4d.io import FromCamera
from napari_phase4d.later import pd, xr
from napari_phase4d.scripting import as_python
from napari_phase4d.task import UNWATCHED

__all__ = ["Session"]


class Session(State):
    """What a script that drives an open window calls; the dock's buttons do the same.

    Each call waits until the work is done, and the window shows the result.

    Examples
    --------
    >>> _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    >>> dock.session.open("sample:euglena")
    >>> dock.session.find_lobes()
    >>> dock.session.reconstruct()
    >>> table = dock.session.unwrap(["temporal-angular"], boundary=(0, 0))
    """

    def watch(
        self,
        source: str | Path | FromCamera,
        out: str | Path,
        *,
        frames: int | None = None,
        patience_s: float = PATIENCE_S,
    ) -> pd.DataFrame:
        """Work on a recording while it is written, take its results, return the table (step 1).

        Parameters
        ----------
        source : str, Path or FromCamera
            See `napari_phase4d.pipeline.watch`.
        out : str or Path
            Folder for the results.
        frames : int, optional
            End after so many frames. Default: as many as come.
        patience_s : float, optional
            End after so many seconds without anything new.
        """
        plan_watching(self, source, out, frames=frames, patience_s=patience_s).run()
        return self.needed_outcome().comparison.table

    def find_lobes(self, n_views: int | None = None) -> list[Lobe]:
        """Find the views in the spectrum (step 2)."""
        if n_views is not None:
            self.update(n_views=n_views)
        plan_lobes(self).run()
        return self.lobes

    def reconstruct(self, **settings: Any) -> xr.Dataset:
        """Reconstruct phase and amplitude (step 3); settings of the recipe may be given."""
        self.update(**settings)
        plan_reconstruction(self).run()
        return self.needed_reconstruction()

    def autofocus(self) -> Focus:
        """Find where the object is sharp, and refocus to there from now on (step 3)."""
        plan_focus(self).run()
        assert self.focus is not None
        return self.focus

    def measure_noise(self) -> pd.DataFrame:
        """Return how noisy phase and amplitude are in the empty field (step 3)."""
        plan_noise(self).run()
        assert self.noise is not None
        return self.noise

    def suggest_boundary(self) -> tuple[int, int]:
        """Score all frames, and start from the safest as long as no other is chosen (step 4)."""
        plan_scores(self).run()
        self.update(boundary="auto")
        (best,) = self.start_frames
        return best

    def unwrap(
        self,
        methods: Sequence[str] | None = None,
        boundary: tuple[int, int] | None = None,
        **settings: Any,
    ) -> pd.DataFrame:
        """Unwrap and return the table (step 4); settings of the recipe may be given."""
        if methods is not None:
            settings["methods"] = tuple(methods)
        if boundary is not None:
            settings["boundary"] = (tuple(boundary),)
        self.update(**settings)
        # Who names methods gets them, whether they make sense for the phase or not.
        plan_unwrapping(self, None if methods is None else self.recipe.methods).run()
        return self.needed_outcome().comparison.table

    def weigh(self) -> dict[str, xr.DataArray]:
        """Return how far to trust each result, from 0 to 1 (step 5)."""
        plan_confidence(self).run()
        return self.confidence

    def measure_steps(self) -> xr.Dataset:
        """Return how near steps come to the largest that can be unwrapped (step 5)."""
        plan_margin(self).run()
        assert self.margin is not None
        return self.margin

    def measure(
        self,
        method: str | Sequence[str] | None = None,
        regions: Masks | None = None,
        **options: Any,
    ) -> pd.DataFrame:
        """Measure regions of a result over time (step 5); default: the object, most reliable.

        Of several methods the table has a column that says which.

        The options are those of `measure`: ``object_index``, ``refraction_increment_ml_per_g``;
        and ``optics``, for phase that does not say its microscope.
        """
        plan_measuring(self, method, regions, **options).run()
        assert self.measured is not None
        return self.measured

    def find_cells(
        self,
        method: str | None = None,
        settings: CellSettings | None = None,
        labels: NDArray[np.integer] | None = None,
    ) -> Cells:
        """Find, follow and measure the cells of a result (step 5); default: the most reliable.

        ``labels`` of another program, or corrected by hand, are only followed and measured.
        """
        plan_cells(self, method, settings, labels).run()
        assert self.cells is not None
        return self.cells

    def save(self, folder: str | Path) -> list[Path]:
        """Write all stacks, the table, the recipe and measurements into a folder (step 5)."""
        written: list[Path] = plan_saving(self, folder).work(UNWATCHED)
        return written

    def script(self) -> str:
        """Return a Python script that computes the present results again (step 5)."""
        return as_python(self.needed_outcome().recipe)

    def quiet_plan(self, failed: Sequence[str] = ()) -> Plan | None:
        """Return what is best computed unasked now: spectrum, scores, noise, or confidence.

        Parameters
        ----------
        failed : sequence of str
            Titles of plans that are not to be tried again.
        """
        plans = []
        if self.recording is not None and self.spectrum is None:
            plans.append(plan_spectrum(self))
        if self.reconstruction is not None and (self.scores is None or self.scores_are_old):
            plans.append(plan_scores(self, unasked=True))
        if self.reconstruction is not None and self.noise is None:
            plans.append(plan_noise(self))
        if self.estimate is None and self.reconstruction is not None and self.to_run:
            plans.append(plan_estimate(self))
        # Without WL1, weighing would first have to compute it.
        if REFERENCE in self.results and not self.confidence and self.place is None:
            plans.append(plan_confidence(self, unasked=True))
        return next((plan for plan in plans if plan.title not in failed), None)
