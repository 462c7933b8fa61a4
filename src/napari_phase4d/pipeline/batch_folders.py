"""Which folder the results of each file go to, and how they get there whole and stay so.

One batch at a time works in a folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import socket
import time
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from napari_phase4d.io import PROGRAM
from napari_phase4d.io.atomic import put_in_place, remove_folder, text_of, written_whole
from napari_phase4d.later import xr
from napari_phase4d.pipeline.provenance import (
    Fingerprint,
    Hashing,
    asked_recipe,
    fingerprint,
    program_version,
)
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.words import address_of, as_path, checked_call

__all__ = [
    "NOTE",
    "alone",
    "asked_for",
    "complete",
    "damaged_note",
    "digest_of",
    "made_whole",
    "noted",
    "recovered",
    "result_folders",
    "write_note",
]

LOCK = "batch.lock"
#: Seconds after which a lock that was taken over is looked at again: another may have done so too.
SETTLED_S = 0.1
#: Where Linux says which start of the machine this is, and when a process began, in ticks of it.
BOOT, STAT = Path("/proc/sys/kernel/random/boot_id"), "/proc/{}/stat"
#: The place of that in what follows the name of the process.
BEGAN = 19


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other batches out of a folder.

    What a batch that was killed has left behind does not count.

    Raises
    ------
    OSError
        If another batch works there, or the folder can't be written.
    """
    lock, mine = out / LOCK, own_mark()
    temporary = out / f".{LOCK}-{os.getpid()}"
    try:
        temporary.write_text(json.dumps(mine), encoding="utf-8")
        take(lock, temporary, mine)
    except OSError as error:
        if error.errno is None:
            raise
        msg = f"the folder {out} can't be written ({error.strerror}); choose another one"
        failure = OSError(msg)
        failure.errno = error.errno
        raise failure from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    remove_left(out)
    try:
        yield
    finally:
        with suppress(OSError):
            if mark_in(lock) == mine:
                lock.unlink()


def remove_left(out: Path) -> None:
    """Remove what a process that was killed while it took the lock has left."""
    for left in out.glob(f".{LOCK}-*"):
        number = left.name.rpartition("-")[2]
        if number.isdigit() and not psutil.pid_exists(int(number)):
            with suppress(OSError):  # another user's, or held open
                left.unlink(missing_ok=True)


def take(lock: Path, temporary: Path, mine: dict[str, Any]) -> None:
    """Put a lock in its place if there is none, or none of a batch that still runs."""
    try:
        put(lock, temporary)
    except FileExistsError:
        other = mark_in(lock)
        if other is not None and is_alive(other):
            raise OSError(in_use(lock, other)) from None
        temporary.replace(lock)
        time.sleep(SETTLED_S)
        if mark_in(lock) != mine:
            raise OSError(in_use(lock, mark_in(lock) or {})) from None


def put(lock: Path, temporary: Path) -> None:
    """Put a lock in its place; raise FileExistsError if there is one."""
    try:
        # A link is made whole or not at all, and never over another file.
        os.link(temporary, lock)
    except FileExistsError:
        raise
    except OSError:  # no links on this kind of disk
        with lock.open("x", encoding="utf-8") as file:
            file.write(temporary.read_text(encoding="utf-8"))


def in_use(lock: Path, other: dict[str, Any]) -> str:
    """Return the sentence for a folder that another batch works in."""
    return (
        f"another batch (process {other.get('pid', '?')} on {other.get('host', '?')}) works in "
        f"{lock.parent}; wait for its end, choose another folder, or, if it does not run any "
        f"more, remove {lock.name}"
    )


def own_mark() -> dict[str, Any]:
    """Return what tells this process from all others."""
    number = os.getpid()
    return {"pid": number, "began": began(number), "host": socket.gethostname()}


def began(number: int) -> str:
    """Return when a process began, the same whatever happens to the clock meanwhile.

    Raises
    ------
    psutil.Error
        If there is no such process.
    """
    try:
        stat = Path(STAT.format(number)).read_text(encoding="utf-8", errors="replace")
        # The name of the process, in brackets, may hold anything.
        ticks = stat.rpartition(")")[2].split()[BEGAN]
        return f"{BOOT.read_text(encoding='utf-8').strip()} {ticks}"
    except (OSError, IndexError):
        # Other systems note the time once, and leave it when the clock is put right.
        return repr(psutil.Process(number).create_time())


def mark_in(lock: Path) -> dict[str, Any] | None:
    """Return what a lock says, None if it says nothing."""
    try:
        found = json.loads(text_of(lock))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def is_alive(mark: dict[str, Any]) -> bool:
    """Say whether the process that a lock names still runs; of other machines it can't be told."""
    if mark.get("host") != socket.gethostname():
        return True
    try:
        # The number of a process that has ended may be that of another one by now.
        return began(int(mark["pid"])) == str(mark["began"])
    except psutil.AccessDenied:
        return True
    except (psutil.Error, KeyError, TypeError, ValueError):
        return False


# ---- a folder for each file -----------------------------------------------------------------


#: Names that a batch needs for itself.
TAKEN = ("batch.log", "summary.csv", "cells.csv", "batch.lock")
#: What no folder may be called on some system, or would lead out of its parent.
UNFIT = re.compile(r'[\x00-\x1f<>:"/\\|?*]+')
#: Bytes of a folder's name; disks take 255, and hidden names are longer.
LONGEST = 200
#: What is left of a name like cell.ome.tif or cell.ome.zarr without its ending, and goes too.
ENDINGS = (".zarr", ".ome")


@checked_call
def result_folders(files: Iterable[str | Path], out: str | Path) -> list[Path]:
    """Return a folder for every file, right in ``out``, and not the same for two files.

    It is called like the file without its ending. Files that share such a name keep their ending,
    and as many of the folders that they lie in as it takes to tell them apart, so that the order
    of the files does not matter.

    Parameters
    ----------
    files : iterable of str or Path
        The recordings of a batch.
    out : str or Path
        The folder for all results.

    Returns
    -------
    list of Path
        One for each file, in the order of the files. None of them is made.
    """
    paths, out = [as_path(file) for file in files], as_path(out)
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
    found: list[list[str]] = []
    for depth in range(max(len(path.parts) for path in whole)):
        found.append([fit("_".join((*p.parts[-1 - depth : -1], dotless(p.name)))) for p in whole])
        if different(found[-1]) == len(paths):
            return found[-1]
    # Names that differ by capitals only: of the shortest that tell most, each gets a number.
    best = max(found, key=different)
    return [fit(f"{name}_{checksum(str(p))}") for name, p in zip(best, whole, strict=True)]


def different(names: list[str]) -> int:
    """Return how many names differ on a disk that takes capitals for small letters."""
    return len({name.casefold() for name in names})


def checksum(text: str) -> str:
    """Return a short number that tells a text from others."""
    return f"{zlib.crc32(os.fsencode(text)):08x}"


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
    readable = name.encode("utf-8", errors="replace").decode("utf-8")
    if readable != name:  # its bytes are no UTF-8: two such names may read the same
        readable = f"{readable}_{checksum(name)}"
    fitting = UNFIT.sub("_", readable).strip(" .") or "recording"
    if len(fitting.encode()) <= LONGEST:
        return fitting
    return f"{fitting.encode()[:LONGEST].decode(errors='ignore')}_{checksum(name)}"


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
        set_aside(folder)
        keep_foreign(folder, partial)
        put_in_place(partial, folder, hidden(folder, "old"))
    finally:
        remove_folder(partial)


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
    own = noted(folder) is not None or damaged_note(folder) or empty
    if folder.is_symlink() or not own:
        msg = (
            f"{folder} is there already and was not made by a batch; move it away, or choose "
            "another folder for the results"
        )
        raise OSError(msg)


def damaged_note(folder: Path) -> bool:
    """Say whether a folder holds what a crash of the machine has left of a note.

    What says anything of another program is not damaged, but the user's.
    """
    path = folder / NOTE
    if not path.is_file() or path.is_symlink():
        return False
    try:
        found = json.loads(text_of(path))
    except (OSError, ValueError, RecursionError):
        return True
    if isinstance(found, dict) and found.get("program") == PROGRAM:
        return noted(folder) is None
    return not found


def set_aside(folder: Path) -> None:
    """Give a folder whose note is damaged another name, as it can't be told what is the user's."""
    if noted(folder) is not None or not damaged_note(folder):
        return
    names = (folder.with_name(f"{folder.name}-damaged{n}") for n in ("", *range(2, 10_000)))
    folder.rename(next(name for name in names if not name.exists()))


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
            kept = partial / kept_name(path, partial)
            if path.is_dir() and not path.is_symlink():
                shutil.copytree(path, kept, symlinks=True)
            else:  # a link stays one, wherever it leads
                shutil.copy2(path, kept, follow_symlinks=False)


def kept_name(path: Path, partial: Path) -> str:
    """Return the name of a user's file, or the next one that is free beside new results."""
    if not (partial / path.name).exists():
        return path.name
    stem, dot, ending = path.name[1:].partition(".")
    names = (f"{path.name[0]}{stem}-kept{n}{dot}{ending}" for n in ("", *range(2, 10_000)))
    return next(n for n in names if not any((p / n).exists() for p in (path.parent, partial)))


#: Name of the file that says what a folder holds.
NOTE = "run.json"
#: Facts of a run that the summary shows.
Facts = dict[str, Any]


def asked_for(
    recipe: Recipe,
    form: str | None,
    truth: str | None = None,
    reference: Fingerprint | None = None,
) -> dict[str, Any]:
    """Return all that results depend on but the input: recipe, form, exact phase and version.

    ``truth`` is the digest of the exact phase, ``reference`` the fingerprint of the file that the
    recipe divides by.
    """
    return {
        "version": program_version(),
        "recipe": asked_recipe(recipe, reference),
        "form": form,
        "truth": truth,
    }


def digest_of(truth: xr.DataArray) -> str:
    """Return the SHA-256 of an array's numbers."""
    return hashlib.sha256(np.ascontiguousarray(truth.values).tobytes()).hexdigest()


def write_note(
    folder: Path,
    asked: Mapping[str, Any],
    source: Mapping[str, Any],
    facts: Facts,
    task: Task = UNWATCHED,
) -> None:
    """Note in a folder what was asked for, of which input, and each file that it holds."""
    files = [
        fingerprint(path, cancelled=task.cancelled).as_dict() for path in sorted(folder.iterdir())
    ]
    note = {"program": PROGRAM, "input": source, "asked": asked, "facts": facts, "files": files}
    with written_whole(folder / NOTE) as temporary:
        temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")


def noted(folder: Path) -> dict[str, Any] | None:
    """Return what `write_note` noted in a folder, None if it did not or it is damaged."""
    try:
        note = json.loads(text_of(folder / NOTE))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(note, dict) or note.get("program") != PROGRAM:
        return None
    kinds = {"input": dict, "asked": dict, "facts": dict, "files": list}
    if not all(isinstance(note.get(name), kind) for name, kind in kinds.items()):
        return None
    return note if all(is_file_note(file) for file in note["files"]) else None


def is_file_note(file: Any) -> bool:
    """Say whether this notes a file of the folder itself."""
    return (
        isinstance(file, dict)
        and isinstance(file.get("name"), str)
        and file["name"] not in ("", ".", "..")
        and Path(file["name"]).name == file["name"]
    )


def complete(
    folder: Path,
    asked: Mapping[str, Any],
    source: Hashing,
    task: Task = UNWATCHED,
) -> dict[str, Any] | None:
    """Return what is noted in a folder if it holds just what is asked for, undamaged, else None.

    What is quick to find out comes first: the recipe, the sizes, and only then what the input and
    the results hold.
    """
    if address_of(source.source) is not None:
        return None  # whether its pixels are the same can't be told
    note = noted(folder)
    if note is None or note["asked"] != json.loads(json.dumps(asked)):
        return None
    if note["input"].get("bytes", 0) != source.bytes:
        return None
    if not all(undamaged(folder, file, task, look_inside=False) for file in note["files"]):
        return None
    if note["input"] != source.result(task).as_dict():
        return None
    whole = all(undamaged(folder, file, task, look_inside=True) for file in note["files"])
    return note if whole else None


def undamaged(
    folder: Path,
    file: Mapping[str, Any],
    task: Task,
    *,
    look_inside: bool,
) -> bool:
    """Say whether a result is there with the size, or also the content, that is noted."""
    path = folder / file["name"]
    try:
        if look_inside:
            return fingerprint(path, cancelled=task.cancelled).as_dict() == file
        # Of a folder, only that it is there: to list it is most of the work of reading it.
        return path.is_dir() or bool(path.stat().st_size == file.get("bytes"))
    except OSError:
        return False
