"""Which folder the results of each file go to, and how they get there whole."""

from __future__ import annotations

import re
import shutil
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from napari_phase4d.io.atomic import put_in_place
from napari_phase4d.pipeline.batch.complete import NOTE, noted

__all__ = ["made_whole", "recovered", "result_folders"]

#: Names that a batch needs for itself.
TAKEN = ("batch.log", "summary.csv", "batch.lock")
#: What no folder may be called on some system, or would lead out of its parent.
UNFIT = re.compile(r'[\x00-\x1f<>:"/\\|?*]+')
#: What is left of a name like cell.ome.tif or cell.ome.zarr without its ending, and goes too.
ENDINGS = (".zarr", ".ome")


def result_folders(files: Sequence[str | Path], out: str | Path) -> list[Path]:
    """Return a folder for every file, right in ``out``, and not the same for two files.

    It is called like the file without its ending. Files that share such a name keep their ending,
    and as many of the folders that they lie in as it takes to tell them apart, so that the order
    of the files does not matter.
    """
    paths = [Path(file) for file in files]
    groups: dict[str, list[int]] = defaultdict(list)
    for i, path in enumerate(paths):
        groups[plain_name(path).casefold()].append(i)
    names: dict[int, str] = {}
    for group in groups.values():
        told = told_apart([paths[i] for i in group])
        names |= dict(zip(group, told, strict=True))
    return [Path(out) / name for name in numbered([names[i] for i in range(len(paths))])]


def told_apart(paths: list[Path]) -> list[str]:
    """Return names of files of one stem, with no more of their places than it takes."""
    if len(paths) == 1:
        return [plain_name(paths[0])]
    whole = [path.absolute() for path in paths]
    names: list[str] = []
    for depth in range(max(len(path.parts) for path in whole)):
        names = [fit("_".join((*p.parts[-1 - depth : -1], dotless(p.name)))) for p in whole]
        if len({name.casefold() for name in names}) == len(names):
            break
    return names


def plain_name(path: Path) -> str:
    """Return the name of a file without its ending."""
    stem = path.name if path.is_dir() else path.stem
    for ending in ENDINGS:
        stem = stem.removesuffix(ending)
    return fit(stem)


def dotless(name: str) -> str:
    """Return a name with its ending as a part of it."""
    return name.lstrip(".").replace(".", "_")


def fit(name: str) -> str:
    """Return a name that is fit for a folder, and never one outside of its parent."""
    return UNFIT.sub("_", name).strip(" .") or "recording"


def numbered(names: list[str]) -> list[str]:
    """Return names with a number at the end of those that are taken already."""
    found: list[str] = []
    taken = set(TAKEN)
    for name in names:
        candidates = (f"{name}{end}" for end in ("", *(f"_{i}" for i in range(2, len(names) + 9))))
        found.append(next(c for c in candidates if c.casefold() not in taken))
        taken.add(found[-1].casefold())
    return found


@contextmanager
def made_whole(folder: Path) -> Iterator[Path]:
    """Give an empty hidden folder to fill; it gets its name once all is in it.

    An older folder of this batch is replaced; what the user has put there is kept.

    Raises
    ------
    OSError
        If there is a folder of that name that no batch has made, or it can't be written.
    """
    partial = hidden(folder, "partial")
    check_replaceable(folder)
    remove(partial)
    partial.mkdir()
    try:
        yield partial
        keep_foreign(folder, partial)
        put_in_place(partial, folder, hidden(folder, "old"))
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def recovered(folder: Path) -> None:
    """Bring a folder back that was being replaced when an earlier batch was killed."""
    old = hidden(folder, "old")
    if old.exists() and not folder.exists():
        old.rename(folder)
    remove(old)
    remove(hidden(folder, "partial"))


def hidden(folder: Path, what: str) -> Path:
    """Return the name of a folder that is not to be looked at."""
    return folder.with_name(f".{folder.name}-{what}")


def remove(folder: Path) -> None:
    """Remove a folder, if it is there."""
    if folder.is_dir() and not folder.is_symlink():
        shutil.rmtree(folder)


def check_replaceable(folder: Path) -> None:
    """Raise OSError if a folder holds what no batch has made."""
    if not folder.exists() and not folder.is_symlink():
        return
    empty = folder.is_dir() and not any(folder.iterdir())
    if folder.is_symlink() or (noted(folder) is None and not empty):
        msg = (
            f"{folder} is there already and was not made by a batch; move it away, or choose "
            "another folder for the results"
        )
        raise OSError(msg)


def keep_foreign(folder: Path, partial: Path) -> None:
    """Copy what a user has put into an older folder into the new one.

    Where a new result has the name, it is called so with ``-kept``.
    """
    note = noted(folder)
    if note is None:
        return
    own = {NOTE, *(file["name"] for file in note["files"])}
    for path in folder.iterdir():
        if path.name not in own:
            copy = shutil.copytree if path.is_dir() else shutil.copy2
            copy(path, partial / kept_name(path, partial))


def kept_name(path: Path, partial: Path) -> str:
    """Return the name of a user's file, or the next one that is free beside new results."""
    if not (partial / path.name).exists():
        return path.name
    stem, dot, ending = path.name[1:].partition(".")
    names = (f"{path.name[0]}{stem}-kept{n}{dot}{ending}" for n in ("", *range(2, 10_000)))
    return next(n for n in names if not any((p / n).exists() for p in (path.parent, partial)))
