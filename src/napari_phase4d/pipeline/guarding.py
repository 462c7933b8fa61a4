"""A folder with the results of one run: nothing else in it is touched, nothing old is left."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from napari_phase4d.io import OME_TIFF, OME_ZARR, PROGRAM, holds_phase
from napari_phase4d.io.atomic import remove_dead, written_whole
from napari_phase4d.io.results import is_result
from napari_phase4d.io.zarr_files import is_zarr
from napari_phase4d.pipeline.batch_folders import NOTE, alone, damaged_note, noted
from napari_phase4d.pipeline.folder import checked_form, lying_in, write_files
from napari_phase4d.pipeline.places import make_folder, over_input, taken
from napari_phase4d.pipeline.provenance import Fingerprint, source_of
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.task import CancelledCall, ProgressCall, Task
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import checked_call, local_path

__all__ = ["ResultFolder", "guarded_folder", "result_folder", "write_outcome"]

#: What a run writes beside its methods' results.
STACKS, FILES = ("wrapped", "amplitude", "exact"), ("table.csv", "recipe.json")
ENDINGS = (OME_TIFF, OME_ZARR)
CELL_TABLES = ("cells.csv", "cell_summary.csv")
#: How the tables of a run begin.
TABLES_BEGIN = (b"id,method", b"cell,parent")


class ResultFolder:
    """A folder that one run writes to, and what earlier runs have made in it.

    Parameters
    ----------
    folder : Path
        The folder.
    planned : sequence of str
        Names that the run may write.
    lying : set of str, optional
        Names of what the run itself has made there already.
    """

    def __init__(self, folder: Path, planned: Sequence[str], lying: Iterable[str] = ()) -> None:
        self.folder, self.planned, self.lying = folder, planned, set(lying)
        note = noted(folder)
        #: Whether the note that lies there is one of this program, or what is left of one.
        self.may_note = note is not None or damaged_note(folder)
        #: Names of what earlier runs have made.
        noted_files = note["files"] if note else []
        self.own: set[str] = {f["name"] for f in noted_files if is_as_noted(folder, f)}
        #: Names of what they have made and somebody has changed since.
        self.changed = {f["name"] for f in noted_files} - self.own
        if note is None and (self.may_note or not (folder / NOTE).exists()):
            self.own = made_before(folder, planned)
        #: The input, where it lies in the folder, and whether an earlier run made it.
        self.given, self.foreign = "", set[str]()

    def check(self, source: str) -> None:
        """Refuse names that are taken by what no run has made, or by the input.

        Wrapped phase may be the input: it is left as it is.
        """
        given = real(source) if source else None
        if given is not None and Path(given).is_dir():
            check_outside(self.folder, Path(given))
        for name in (*self.planned, NOTE):
            path = self.folder / name
            if name in self.lying or not (path.exists() or path.is_symlink()):
                continue
            is_input = given is not None and real(path) == given
            if is_input:
                self.given = name
                self.foreign = {name} - self.own
            if is_input and name.startswith("wrapped.") and holds_phase(path):
                continue
            if is_input:
                raise over_input(path)
            if name not in self.own and not (name == NOTE and self.may_note):
                changed = name in self.changed
                raise taken(path, "was changed since" if changed else "was not made by a run")

    def announce(self) -> None:
        """Note what may be written, so that the next run knows it if this one is killed."""
        self.write_note((self.own | set(self.planned)) - self.foreign, {})

    def settle(self, written: Iterable[Path], given: str, source: Fingerprint) -> None:
        """Note what was written; what an earlier run made, and this one did not, goes.

        Parameters
        ----------
        written : iterable of Path
            All files of the run.
        given : str
            The input, which stays, wherever it lies.
        source : Fingerprint
            That of the input.
        """
        names = {path.name for path in written} - self.foreign
        for name in self.own - names - self.lying:
            path = self.folder / name
            if not given or real(path) != real(given):
                remove(path)
        kept = {name for name in self.lying if (self.folder / name).exists()}
        self.write_note(names | kept | (self.own & {self.given}), source.as_dict())

    def give_up(self) -> None:
        """Note what is there after all, where a run has failed."""
        ours = (self.own | set(self.planned)) - self.foreign
        there = [name for name in ours if (self.folder / name).exists()]
        with suppress(OSError):
            if there:
                self.write_note(there, {})
            else:
                (self.folder / NOTE).unlink(missing_ok=True)

    def write_note(self, names: Iterable[str], source: dict[str, Any]) -> None:
        """Write the note that makes these files those of a run."""
        files = [{"name": name, **stamp_of(self.folder / name)} for name in sorted(set(names))]
        note = {"program": PROGRAM, "input": source, "asked": {}, "facts": {}, "files": files}
        with written_whole(self.folder / NOTE) as temporary:
            temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")


@contextmanager
def result_folder(
    folder: str | Path,
    recipe: Recipe,
    more: Iterable[str] = (),
    *,
    with_cells: bool = False,
    lying: Iterable[str] = (),
) -> Iterator[ResultFolder]:
    """Keep a folder for one run, made if it is not there; one made in vain goes again.

    What the user has put there is never written over, nor is the input. When the run ends well,
    what an earlier one made there and this one did not is removed. ``run.json`` notes the files.

    Parameters
    ----------
    folder : str or Path
        Where the results go.
    recipe : Recipe
        What is run.
    more : sequence of str, optional
        Names of further files that will be written.
    with_cells : bool, optional
        Whether cells are written that the recipe does not ask for.
    lying : iterable of str, optional
        Names of stacks that the run itself has left there, which stay.

    Raises
    ------
    OSError
        If the folder can't be written, another run works there, or a file would be written over
        that no run has made.
    """
    planned = [*planned_names(recipe, with_cells=with_cells), *more]
    with guarded_folder(folder, planned, recipe.recording, lying) as found:
        yield found


@contextmanager
def guarded_folder(
    folder: str | Path, planned: Sequence[str], source: str = "", lying: Iterable[str] = ()
) -> Iterator[ResultFolder]:
    """Keep a folder for files of these names, see `result_folder`.

    Parameters
    ----------
    folder : str or Path
        Where they go.
    planned : sequence of str
        Names of all that may be written.
    source : str, optional
        The input, which is never written over.
    lying : iterable of str, optional
        See `result_folder`.
    """
    folder = local_path(folder)
    was_there = folder.exists()
    make_folder(folder)
    try:
        with alone(folder):
            remove_dead(folder)
            found = ResultFolder(folder, planned, lying)
            found.check(source)
            try:
                found.announce()
                yield found
            except BaseException:
                found.give_up()
                raise
    except BaseException:
        if not was_there:
            with suppress(OSError):  # something lies in it
                folder.rmdir()
        raise


@checked_call
def write_outcome(
    outcome: Outcome,
    folder: str | Path,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    form: str | None = None,
    source: Fingerprint | None = None,
    reference: Fingerprint | None = None,
) -> list[Path]:
    """Write phase, amplitude, every result, the table and the recipe into a folder.

    Where they are there, the exact phase is written too, and the cells: ``cells``, their labels,
    ``cells.csv`` with a row a cell, time and view, ``cell_summary.csv`` with a row a cell; last,
    where the recipe asks for it, how far to trust each result. All stacks have their pixel, times
    and angles, and note in ``attrs["provenance"]`` what made them, see `write_phase`. Wrapped
    phase that the run began with, and that lies there already, is left as it is.

    The folder is guarded as ``napari-phase4d run`` does it: what no run has made there, or was
    changed since, is never written over, nor is the input; what an earlier run made there, and
    this one did not, is removed. ``run.json`` notes the files for that.

    Parameters
    ----------
    outcome : Outcome
        What a run gave.
    folder : str or Path
        Where to write; made if it is not there.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.
    form : str, optional
        "tiff" for OME-TIFF or "zarr" for OME-Zarr. Default: OME-TIFF, or OME-Zarr if the stacks
        are lazy, as those of a run larger than memory are.
    source : Fingerprint, optional
        That of the input, if it is known already. Default: it is computed now.
    reference : Fingerprint, optional
        That of the file that the recipe divides by, likewise.

    Returns
    -------
    list of Path
        The files and stacks that were written.

    Raises
    ------
    OSError
        If a file can't be written, is the input, or was not made by a run; files of that name are
        then left as they were.
    ValueError
        If there is no such form.
    Cancelled
        If ``cancelled()`` returned True; the files written by then are whole.
    """
    checked_form(form)
    task = Task(progress, cancelled)
    folder, recording = local_path(folder), outcome.recording
    given = outcome.recipe.recording or ("" if recording is None else recording.source)
    results = [f"{name}{end}" for name in outcome.comparison.results for end in ENDINGS]
    with result_folder(
        folder,
        outcome.recipe.changed(recording=given),
        results,
        with_cells=outcome.cells is not None,
        lying=lying_in(folder, outcome),
    ) as kept:
        made_of = source or source_of(outcome, cancelled=cancelled)
        written = write_files(
            outcome, folder, task, form=form, source=made_of, reference=reference
        )
        kept.settle(written, given, made_of)
    return written


def made_before(folder: Path, planned: Sequence[str]) -> set[str]:
    """Return what a run made in a folder that has no note of it, or a damaged one.

    Runs of version 0.1.0 left none. Results that are not planned now are of it too.
    """
    trust = [f"confidence_{method}" for method in METHODS]
    possible = {*planned, *names_of((*STACKS, *METHODS, *trust, "cells")), *FILES, *CELL_TABLES}
    there = {name for name in possible if (folder / name).exists()}
    if not there > set(FILES) or not all(looks_own(folder / name) for name in there):
        return set()
    return there


def planned_names(recipe: Recipe, *, with_cells: bool = False) -> list[str]:
    """Return the names that a run may write."""
    with_cells = with_cells or recipe.cells is not None
    trust = [f"confidence_{method}" for method in recipe.methods] if recipe.confidence else []
    of_cells = ("cells",) if with_cells else ()
    tables = CELL_TABLES if with_cells else ()
    stacks = (*STACKS, *recipe.methods, *trust, *of_cells)
    return [*names_of(stacks), *FILES, *tables]


def names_of(stacks: Iterable[str]) -> list[str]:
    """Return the names that stacks may have as files."""
    return [f"{stack}{end}" for stack in stacks for end in ENDINGS]


def check_outside(folder: Path, recording: Path) -> None:
    """Refuse to write results among the frames of a recording that is a folder itself."""
    where = Path(real(folder))
    inside = where == recording or (is_zarr(recording) and where.is_relative_to(recording))
    if inside:
        msg = f"{folder} is the recording itself; choose another folder for the results"
        raise OSError(msg)


def real(path: str | Path) -> str:
    """Return where a path leads; unlike `Path.resolve` it takes links that go round."""
    return os.path.realpath(path)


def stamp_of(path: Path) -> dict[str, Any]:
    """Return size and time of a file, or of all files in a folder; nothing where there is none."""
    if path.is_symlink() or not path.exists():
        return {}
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
    facts = [p.stat() for p in files]
    return {
        "bytes": sum(fact.st_size for fact in facts),
        "changed_ns": max((fact.st_mtime_ns for fact in facts), default=0),
    }


def is_as_noted(folder: Path, noted_file: dict[str, Any]) -> bool:
    """Say whether a file is what a run made of it, or is not there (any more).

    A run that was killed has noted names alone: then what the file holds must be of this program.
    """
    path = folder / str(noted_file["name"])
    if not path.exists() and not path.is_symlink():
        return True
    stamp = stamp_of(path)
    if not stamp:
        return False
    if "sha256" in noted_file:  # of a batch, whose files may have been copied
        return bool(noted_file.get("bytes") == stamp["bytes"])
    if "changed_ns" in noted_file:
        return all(noted_file.get(key) == value for key, value in stamp.items())
    return looks_own(path)


def looks_own(path: Path) -> bool:
    """Say whether a file holds what a run writes under its name."""
    if not (path.is_file() or path.is_dir()):  # a pipe would be waited for
        return False
    try:
        if path.name.endswith(ENDINGS):
            return is_result(path)
        if path.suffix == ".csv":
            with path.open("rb") as lines:
                return lines.readline(200).startswith(TABLES_BEGIN)
        if path.name == "recipe.json":
            Recipe.from_file(path)
    except (OSError, ValueError):
        return False
    return True


def remove(path: Path) -> None:
    """Remove a result, file or folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
