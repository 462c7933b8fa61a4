"""Where the stacks of a run lie: in memory, or on disk if they do not fit."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import xarray as xr

from napari_phase4d.analysis import Comparison, compare_on
from napari_phase4d.io.atomic import remove_folder
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
from napari_phase4d.pipeline.streaming.leftovers import new_folder
from napari_phase4d.task import UNWATCHED, Task

__all__ = ["Place", "find_place", "make_folder", "place_for", "stacks_beside", "temporary_folder"]


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

    def close(self) -> None:
        """Remove what was needed on the way only, and leave a cluster."""
        self.shelf.clear()
        if isinstance(self.workers, Cluster):
            self.workers.close()

    @contextmanager
    def nested(self, name: str) -> Iterator[Place]:
        """Give a place of its own inside this one, so that what lies here stays as it is."""
        inner = Place(Shelf(self.shelf.folder / name), self.workers)
        try:
            yield inner
        finally:
            inner.shelf.clear()

    def unwrap(
        self,
        recipe: Recipe,
        phase: xr.DataArray,
        amplitude: xr.DataArray | None = None,
        truth: xr.DataArray | None = None,
        task: Task = UNWATCHED,
        finished: Callable[[str, Comparison], None] | None = None,
    ) -> Comparison:
        """Unwrap with a recipe's methods, see `compare`; phase in memory is written first."""
        stored = stored_at(phase)
        if stored is None:
            phase = self.shelf.take("wrapped", phase, task)
            stored = stored_at(phase)
            assert stored is not None  # it has just been written
        problem = ProblemOnDisk(
            phase,
            stored,
            self.shelf,
            recipe.start_frames,
            finds_mask=recipe.mask == "auto",
            amplitude=amplitude,
            workers=self.workers,
        )
        return compare_on(
            problem, recipe.methods, truth, recipe.options, **task.calls, finished=finished
        )


@contextmanager
def place_for(
    recipe: Recipe, needs: Needs, folder: str | Path | None, scheduler: str | None
) -> Iterator[Place | None]:
    """Give the place of a run's stacks, see `find_place`, and tidy up afterwards."""
    place = find_place(recipe, needs, folder, scheduler)
    try:
        yield place
    finally:
        if place is not None:
            place.close()


def find_place(
    recipe: Recipe,
    needs: Needs,
    folder: str | Path | None = None,
    scheduler: str | None = None,
) -> Place | None:
    """Return the place of a run's stacks, None for memory.

    Parameters
    ----------
    recipe : Recipe
        Its ``storage`` says where they are wished for.
    needs : Needs
        What the run needs.
    folder : str or Path, optional
        Where stacks on disk go; default a temporary folder.
    scheduler : str, optional
        Address of a cluster.

    Raises
    ------
    OSError
        If neither memory nor disk are enough, or no scheduler answers.
    """
    on_disk = scheduler is not None or recipe.storage == "disk"
    if recipe.storage == "auto":
        on_disk = on_disk or not needs.fits_in_memory()
    where = roomy() if folder is None else Path(folder)
    needs.check(where, on_disk=on_disk)
    if not on_disk:
        return None
    workers: Workers = Threads() if scheduler is None else Cluster(scheduler)
    return Place(Shelf(temporary_folder() if folder is None else Path(folder)), workers)


@contextmanager
def stacks_beside(folder: str | Path, form: str | None) -> Iterator[Path]:
    """Give where stacks on disk go before results are written to a folder in a form.

    It is the folder itself, unless they are wished for in another form than that of the disk.
    """
    if form != "tiff":
        yield Path(folder)
        return
    hidden = new_folder(Path(folder), ".phase4d")
    try:
        yield hidden
    finally:
        remove_folder(hidden)


def make_folder(out: Path) -> None:
    """Make the folder for results.

    Raises
    ------
    OSError
        If it can't be made, in one sentence.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"the folder {out} can't be made ({error.strerror}); choose another one"
        raise OSError(msg) from error


def temporary_folder() -> Path:
    """Return a new folder that is removed when Python ends."""
    folder = new_folder(roomy(), "phase4d")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def roomy() -> Path:
    """Return where large temporary files go: on many systems /tmp lies in memory."""
    usual, on_disk = Path(tempfile.gettempdir()), Path("/var/tmp")
    in_memory = any(
        part.fstype == "tmpfs" and usual.is_relative_to(part.mountpoint) and part.mountpoint != "/"
        for part in psutil.disk_partitions(all=True)
    )
    return on_disk if in_memory and os.access(on_disk, os.W_OK) else usual
