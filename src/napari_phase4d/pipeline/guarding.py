"""A folder with the results of one run: nothing else in it is touched, nothing old is left."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from napari_phase4d.io import OME_TIFF, OME_ZARR, PROGRAM
from napari_phase4d.io.atomic import remove_dead, written_whole
from napari_phase4d.io.results import is_result
from napari_phase4d.io.zarr_files import is_zarr
from napari_phase4d.pipeline.batch.folders import NOTE, noted
from napari_phase4d.pipeline.batch.lock import alone
from napari_phase4d.pipeline.places import make_folder
from napari_phase4d.pipeline.provenance import Fingerprint
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.words import local_path

__all__ = ["ResultFolder", "result_folder"]

#: What a run writes beside its methods' results.
STACKS, FILES = ("wrapped", "amplitude", "exact"), ("table.csv", "recipe.json")
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
    """

    def __init__(self, folder: Path, planned: Sequence[str]) -> None:
        self.folder, self.planned = folder, planned
        note = noted(folder)
        #: Names of what earlier runs have made.
        noted_files = note["files"] if note else []
        self.own: set[str] = {f["name"] for f in noted_files if is_as_noted(folder, f)}
        #: Names of what they have made and somebody has changed since.
        self.changed = {f["name"] for f in noted_files} - self.own
        if not (folder / NOTE).exists():
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
            if not (path.exists() or path.is_symlink()):
                continue
            is_input = given is not None and real(path) == given
            if is_input:
                self.given = name
                self.foreign = {name} - self.own
            if is_input and name.startswith("wrapped."):
                continue
            if is_input:
                msg = f"results would be written over the input {path}; choose another folder"
                raise OSError(msg)
            if name not in self.own and not (name == NOTE and is_damaged_or_own(path)):
                how = "was changed since" if name in self.changed else "was not made by a run"
                msg = (
                    f"{path} is there already and {how}; move it away, or choose another folder "
                    "for the results"
                )
                raise OSError(msg)

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
        for name in self.own - names:
            path = self.folder / name
            if not given or real(path) != real(given):
                remove(path)
        self.write_note(names | (self.own & {self.given}), source.as_dict())

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
    folder: str | Path, recipe: Recipe, more: Iterable[str] = (), *, with_cells: bool = False
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

    Raises
    ------
    OSError
        If the folder can't be written, another run works there, or a file would be written over
        that no run has made.
    """
    folder = local_path(folder)
    was_there = folder.exists()
    make_folder(folder)
    try:
        with alone(folder):
            remove_dead(folder)
            found = ResultFolder(folder, [*planned_names(recipe, with_cells=with_cells), *more])
            found.check(recipe.recording)
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


def made_before(folder: Path, planned: Sequence[str]) -> set[str]:
    """Return what a run of version 0.1.0 made in a folder, which left no note of it."""
    there = {name for name in planned if (folder / name).exists()}
    stacks = there - set(FILES)
    if not there >= set(FILES) or not stacks:
        return set()
    try:
        Recipe.from_file(folder / "recipe.json")
        ours = all(is_result(folder / name) for name in stacks)
    except (OSError, ValueError):
        return set()
    return there if ours else set()


def planned_names(recipe: Recipe, *, with_cells: bool = False) -> list[str]:
    """Return the names that a run may write."""
    with_cells = with_cells or recipe.cells is not None
    trust = [f"confidence_{method}" for method in recipe.methods] if recipe.confidence else []
    of_cells = ("cells",) if with_cells else ()
    tables = CELL_TABLES if with_cells else ()
    stacks = (*STACKS, *recipe.methods, *trust, *of_cells)
    names = [f"{stack}{end}" for stack in stacks for end in (OME_TIFF, OME_ZARR)]
    return [*names, *FILES, *tables]


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
    try:
        if path.name.endswith((OME_TIFF, OME_ZARR)):
            return is_result(path)
        if path.suffix == ".csv":
            with path.open("rb") as lines:
                return lines.readline(200).startswith(TABLES_BEGIN)
        if path.name == "recipe.json":
            Recipe.from_file(path)
    except (OSError, ValueError):
        return False
    return True


def is_damaged_or_own(note: Path) -> bool:
    """Say whether a note is one of this program, or what a crash has left of one."""
    try:
        found = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return note.is_file() and not note.is_symlink()
    return isinstance(found, dict) and found.get("program") == PROGRAM


def remove(path: Path) -> None:
    """Remove a result, file or folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
