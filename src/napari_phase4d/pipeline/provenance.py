"""Where a result comes from: which file it was, and what it takes to make it again."""

from __future__ import annotations

import glob
import hashlib
import os
import platform
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from napari_phase4d.io import PROGRAM, address_of, parts_beside
from napari_phase4d.later import xr
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.pipeline.starting import FOUND_BY
from napari_phase4d.sample import is_sample
from napari_phase4d.task import THREADS, UNWATCHED, CancelledCall, Task, Watch, finished
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import checked_call

__all__ = [
    "Fingerprint",
    "Hashing",
    "Remembered",
    "asked_recipe",
    "fingerprint",
    "fingerprinting",
    "program_version",
    "provenance_of",
    "source_of",
    "with_provenance",
]

#: Bytes that are read at a time.
BLOCK = 2**20
#: What systems put into folders unasked.
LITTER = (".DS_Store", "Thumbs.db", "desktop.ini")

#: Name, path, size, and time of the last change of each file of an input.
Parts = list[tuple[str, Path, int, int]]


@dataclass(frozen=True)
class Fingerprint:
    """What tells a file from all others, wherever it lies.

    Parameters
    ----------
    name : str
        Name of the file or folder without its place, or of a sample.
    bytes : int, optional
        Size; of a folder, of all files in it. None for a sample.
    sha256 : str, optional
        Of a file, SHA-256 of what it holds, as other programs give it. Of a folder, or of a file
        that is read with others, SHA-256 of the name, size and content of each, in the order of
        their names. None for a sample, and for a store on a server, where the pixels stay.
    """

    name: str
    bytes: int | None = None
    sha256: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what is known, as JSON can hold it."""
        return {name: value for name, value in asdict(self).items() if value is not None}


class Hashing:
    """The fingerprint of an input, computed in a thread while the input is worked on.

    Parameters
    ----------
    source : str or Path
        A file, a folder, a pattern with ``*``, or the name of a sample.

    Raises
    ------
    OSError
        If there is no such file or folder.
    """

    def __init__(self, source: str | Path) -> None:
        self.source = str(source)
        self._before = [] if is_no_file(self.source) else parts_of(self.source)
        self._stopped = threading.Event()
        self._pool = ThreadPoolExecutor(1, THREADS)
        is_file = Path(self.source).is_file() and len(self._before) == 1
        self._future = self._pool.submit(hashed, self._before, self._stopped, is_file=is_file)

    @property
    def bytes(self) -> int:
        """Size of all files together, known at once."""
        return sum(size for _, _, size, _ in self._before)

    def result(self, task: Task = UNWATCHED) -> Fingerprint:
        """Wait for the fingerprint; asked again, see whether the input is still the same.

        Raises
        ------
        OSError
            If the input can't be read, or has changed since this was begun.
        Cancelled
            If ``cancelled()`` returned True.
        """
        if is_sample(self.source):
            return Fingerprint(self.source)
        name = Path(self.source).name
        if address_of(self.source) is not None:
            return Fingerprint(name)
        digest = finished(self._future, Watch(1, "checking the file", task.quiet))
        if parts_of(self.source) != self._before:
            msg = f"{name} was changed while it was read; run it again when it is complete"
            raise OSError(msg)
        return Fingerprint(name, self.bytes, digest)

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def fingerprinting(source: str | Path) -> Iterator[Hashing]:
    """Compute a fingerprint in a thread while something else is done, and end it with that.

    Parameters
    ----------
    source : str or Path
        A file, a folder, a pattern with ``*``, or the name of a sample.

    Yields
    ------
    Hashing
        Its ``result()`` waits for the fingerprint.

    Raises
    ------
    OSError
        If there is no such file or folder.
    """
    hashing = Hashing(source)
    try:
        yield hashing
    finally:
        hashing.stop()


@checked_call
def fingerprint(source: str | Path, cancelled: CancelledCall | None = None) -> Fingerprint:
    """Return the fingerprint of a file, a folder, a pattern with ``*``, or a sample.

    Parameters
    ----------
    source : str or Path
        What is to be read, by the name that it is opened by.
    cancelled : callable, optional
        ``cancelled()`` stops the work.

    Returns
    -------
    Fingerprint
        Name, size in bytes and SHA-256; the name only of a sample or of a store on a server.

    Raises
    ------
    OSError
        If there is no such file or folder, it can't be read, or it changes meanwhile.
    Cancelled
        If ``cancelled()`` returned True.
    """
    with fingerprinting(source) as hashing:
        return hashing.result(Task(None, cancelled))


class Remembered:
    """Fingerprints of files that are asked for again and again; hashed anew if they changed."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[Parts, Fingerprint]] = {}

    def __call__(self, source: str, task: Task = UNWATCHED) -> Fingerprint:
        """Return the fingerprint of a file, see `fingerprint`.

        Raises
        ------
        OSError
            If there is no such file or folder, it can't be read, or it changes meanwhile.
        Cancelled
            If ``cancelled()`` returned True.
        """
        parts = [] if is_no_file(source) else parts_of(source)
        if address_of(source) or source not in self._found or self._found[source][0] != parts:
            self._found[source] = (parts, fingerprint(source, cancelled=task.cancelled))
        return self._found[source][1]


def is_no_file(source: str) -> bool:
    """Say whether an input is a sample, or lies behind an address."""
    return is_sample(source) or address_of(source) is not None


def parts_of(source: str) -> Parts:
    """Return the files of an input with their sizes and times, in the order of their names.

    With all that is read beside those that were named, and what lies behind links.
    """
    if not source:
        msg = "there is no file without a name"  # and "" is not the folder that a program runs in
        raise OSError(msg)
    path = Path(source)
    if path.is_dir():
        found = {p.relative_to(path).as_posix(): p for p in files_below(path)}
        found |= {os.path.relpath(p, path): p for p in parts_beside(path) if p.is_file()}
    else:
        named = [path] if path.exists() else [Path(p) for p in glob.glob(source)]  # noqa: PTH207
        found = {p.name: p for p in named if p.is_file()}
        for one in named:
            found |= {os.path.relpath(p, one.parent): p for p in parts_beside(one) if p.is_file()}
    if not found and not path.is_dir():
        msg = f"there is no file or folder {source}"
        raise OSError(msg)
    kept = sorted((name, p) for name, p in found.items() if p.name not in LITTER)
    facts = [(name, p, p.stat()) for name, p in kept]
    return [(name, p, stat.st_size, stat.st_mtime_ns) for name, p, stat in facts]


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below, also behind links, but no folder within itself."""
    for place, folders, names in os.walk(folder, followlinks=True):
        here = Path(place).resolve()
        folders[:] = [f for f in folders if not here.is_relative_to((here / f).resolve())]
        yield from (p for name in names if (p := Path(place) / name).is_file())


def hashed(parts: Parts, stopped: threading.Event, *, is_file: bool) -> str:
    """Return the SHA-256 of a file, or of the names, sizes and contents of several."""
    digest = hashlib.sha256()
    for name, path, size, _ in parts:
        if not is_file:
            digest.update(f"{name}\0{size}\0".encode("utf-8", "surrogateescape"))
        with path.open("rb") as file:
            while not stopped.is_set() and (block := file.read(BLOCK)):
                digest.update(block)  # which lets other threads run meanwhile
    return digest.hexdigest()


#: Packages whose numbers go into the results.
PACKAGES = ("numpy", "scipy", "scikit-image", "numba")


def provenance_of(
    outcome: Outcome,
    source: Fingerprint | None = None,
    task: Task = UNWATCHED,
    reference: Fingerprint | None = None,
) -> dict[str, Any]:
    """Return what made the results of a run, as JSON can hold it.

    There are no dates, no names of users or machines, and no places of files in it, so that the
    same run gives the same bytes.

    Parameters
    ----------
    outcome : Outcome
        What the run gave.
    source : Fingerprint, optional
        That of the input. Default: it is computed now, if the input is still there.
    task : Task, optional
        Who is told of it, and may stop it.
    reference : Fingerprint, optional
        That of the file it was divided by. Default: it is computed now, if there is such a file.

    Returns
    -------
    dict
        ``program`` and ``version``; ``versions`` of what computes; ``recipe``, with the lobes and
        the microscope that were used; ``boundary`` as (time, angle) numbers; ``input``: name,
        bytes and SHA-256; and, where there are any, ``boundary_found_by``, what told the boundary
        frame if it was found automatically, ``packages`` that brought methods, and
        ``reference``, the same as ``input`` of the file it was divided by.
    """
    recipe = outcome.recipe
    found = {
        "program": PROGRAM,
        "version": program_version(),
        "versions": versions(),
        "recipe": settings_of(recipe),
        "boundary": [list(frame) for frame in recipe.start_frames],
        "input": (source or source_of(outcome, cancelled=task.cancelled)).as_dict(),
    }
    if outcome.scores is not None:
        found[FOUND_BY] = outcome.scores.attrs["basis"]
    if brought := packages_of(recipe):
        found["packages"] = brought
    if recipe.reference_file is not None:
        found["reference"] = (reference or known(recipe.reference_file, task)).as_dict()
    return found


def with_provenance(stack: xr.DataArray, provenance: dict[str, Any]) -> xr.DataArray:
    """Return a stack that notes where it comes from, and no place on this machine."""
    source = stack.attrs.get("source")
    nowhere = {"source": nameless(source)} if isinstance(source, str) else {}
    return stack.assign_attrs({**nowhere, "provenance": provenance})


def asked_recipe(recipe: Recipe, reference: Fingerprint | None = None) -> dict[str, Any]:
    """Return a recipe but for its recording, with the fingerprint of its reference file."""
    noted: dict[str, Any] = {} if reference is None else {"reference": reference.as_dict()}
    if brought := packages_of(recipe):
        noted["packages"] = brought
    return settings_of(recipe) | {"recording": ""} | noted


def packages_of(recipe: Recipe) -> list[str]:
    """Return names and versions of the packages that brought methods of a recipe."""
    return sorted({METHODS[method].package for method in recipe.methods} - {""})


def settings_of(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as JSON can hold it, with the names of files but not their places."""
    settings: dict[str, Any] = recipe.model_dump(mode="json")
    settings["recording"] = nameless(recipe.recording)
    if recipe.reference_file is not None:
        settings["reference"] = nameless(recipe.reference_file)
    return settings


def nameless(source: str) -> str:
    """Return the name of a file or sample without the place where it lies."""
    return source if not source or is_sample(source) else Path(source).name


def source_of(outcome: Outcome, cancelled: CancelledCall | None = None) -> Fingerprint:
    """Return the fingerprint of what a run began with, as far as it is known.

    Of what never was a file, or is not there any more, that is its name.

    Parameters
    ----------
    outcome : Outcome
        What the run gave.
    cancelled : callable, optional
        ``cancelled()`` stops the work.

    Returns
    -------
    Fingerprint
        Name, size in bytes and SHA-256, as far as they are known.
    """
    if outcome.recording is not None:
        source, name = outcome.recording.source, outcome.recording.name
    else:
        attrs = outcome.reconstruction["phase"].attrs
        source, name = str(attrs.get("source", "")), str(attrs.get("object", "phase"))
    return known(source, Task(None, cancelled)) if source else Fingerprint(name)


def known(source: str, task: Task) -> Fingerprint:
    """Return the fingerprint of a file, or its name if it is not there any more."""
    try:
        return fingerprint(source, cancelled=task.cancelled)
    except OSError:
        return Fingerprint(nameless(source))


def program_version() -> str:
    """Return the version of this program.

    Returns
    -------
    str
        As the installed package says it, such as "0.2.0".
    """
    return metadata.version(PROGRAM)


def versions() -> dict[str, str]:
    """Return the versions of what computes."""
    return {"python": platform.python_version()} | {p: metadata.version(p) for p in PACKAGES}
