"""Where the stacks of a run lie: in memory, or on disk if they do not fit."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

from napari_phase4d.evaluation import Comparison, compare_on
from napari_phase4d.pipeline.needs import Needs
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.streaming import (
    Cluster,
    ProblemOnDisk,
    Shelf,
    Threads,
    Workers,
    stored_at,
)
from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["Place", "place_for"]


@dataclass(frozen=True)
class Place:
    """Where stacks go that are not held in memory, and who works on them.

    Parameters
    ----------
    shelf : Shelf
        The folder.
    workers : Workers
        Threads of this machine, or a cluster.
    """

    shelf: Shelf
    workers: Workers

    def unwrap(
        self,
        recipe: Recipe,
        phase: xr.DataArray,
        amplitude: xr.DataArray | None = None,
        truth: xr.DataArray | None = None,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
        finished: Callable[[str, Comparison], None] | None = None,
    ) -> Comparison:
        """Unwrap with a recipe's methods, see `compare`; phase in memory is written first."""
        stored = stored_at(phase)
        if stored is None:
            phase = self.shelf.take("wrapped", phase, progress, cancelled)
            stored = stored_at(phase)
            assert stored is not None  # it has just been written
        problem = ProblemOnDisk(
            phase,
            stored,
            self.shelf,
            recipe.boundary,
            finds_mask=recipe.mask == "auto",
            amplitude=amplitude,
            workers=self.workers,
        )
        return compare_on(
            problem, recipe.methods, truth, recipe.options, progress, cancelled, finished
        )


@contextmanager
def place_for(
    recipe: Recipe, needs: Needs, folder: str | Path | None, scheduler: str | None
) -> Iterator[Place | None]:
    """Give the place of a run's stacks, None for memory, and tidy up afterwards.

    Raises
    ------
    OSError
        If neither memory nor disk are enough, or no scheduler answers.
    """
    on_disk = scheduler is not None or recipe.storage == "disk"
    if recipe.storage == "auto":
        on_disk = on_disk or not needs.fits_in_memory()
    where = Path(tempfile.gettempdir()) if folder is None else Path(folder)
    needs.check(where, on_disk=on_disk)
    if not on_disk:
        yield None
        return
    with ExitStack() as at_end:
        workers: Workers = Threads()
        if scheduler is not None:
            cluster = Cluster(scheduler)
            at_end.callback(cluster.close)
            workers = cluster
        shelf = Shelf(temporary_folder() if folder is None else Path(folder))
        at_end.callback(shelf.clear)
        yield Place(shelf, workers)


def temporary_folder() -> Path:
    """Return a new folder that is removed when Python ends."""
    folder = Path(tempfile.mkdtemp(prefix="phase4d-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
