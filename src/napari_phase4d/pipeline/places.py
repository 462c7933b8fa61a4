"""What a run will need, and where its stacks lie: in memory, or on disk if they do not fit."""

from __future__ import annotations

import atexit
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from napari_phase4d.analysis import REFERENCE, Comparison, compare_on
from napari_phase4d.holography import Demodulator, Lobe
from napari_phase4d.io import OME_ZARR
from napari_phase4d.io.atomic import remove_folder
from napari_phase4d.io.results import result_attrs
from napari_phase4d.later import xr
from napari_phase4d.machine import cores, free_memory
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.stored import Shelf, new_folder, stored_at
from napari_phase4d.pipeline.streaming import ProblemOnDisk
from napari_phase4d.recording import Recording
from napari_phase4d.stack import block_frames
from napari_phase4d.task import UNWATCHED, Cluster, Task, Threads, Workers
from napari_phase4d.unwrapping import (
    METHODS,
    SCORED_PIXELS,
    SCORING_METHOD,
    STACKS_OF_A_FRAME,
    Method,
    graph_bytes,
    working_frames,
)
from napari_phase4d.words import checked_call, local_path, size_in_words

__all__ = [
    "Needs",
    "Place",
    "find_place",
    "make_folder",
    "needed_bytes",
    "needs_of",
    "over_input",
    "phase_needs",
    "place_for",
    "stacks_beside",
    "taken",
    "temporary_folder",
    "working_bytes",
]

#: Share of the free memory that a run may fill.
SHARE_OF_MEMORY = 0.7
#: Bytes for each pixel of a camera frame while it is transformed.
BYTES_OF_A_CAMERA_PIXEL = 32
#: What is known of how well steps support a result, in stacks of float32.
STACKS_OF_A_SUPPORT = 2
#: What the frames of a longer recording need that are looked at alone, in stacks of float32.
SCORING_STACKS = 8


@dataclass(frozen=True)
class Needs:
    """What a run needs, beyond the program itself.

    Parameters
    ----------
    methods : tuple of str
        Ids of the methods.
    in_memory : int
        Bytes of memory, if all stacks are held there.
    on_disk : int
        Bytes of memory, if stacks are written to disk a block at a time.
    disk : int
        Bytes of disk for all results (and, on disk, for what is needed on the way).
    greediest : str
        Method that needs the whole stack at once and most memory for it; empty if none does.
    start_is_most : bool
        Whether finding the safest frame to start from is what needs most memory.
    """

    methods: tuple[str, ...]
    in_memory: int
    on_disk: int
    disk: int
    greediest: str = ""
    start_is_most: bool = False

    def fits_in_memory(self) -> bool:
        """Say whether all stacks can be held in memory now."""
        return bool(self.in_memory <= SHARE_OF_MEMORY * free_memory())

    def check(self, folder: Path, *, on_disk: bool) -> None:
        """Raise OSError if the memory, or the disk that holds a folder, is too small.

        Raises
        ------
        OSError
            In one sentence, with what is needed, what there is, and what to do.
        """
        free = free_memory()
        needed = self.on_disk if on_disk else self.in_memory
        if needed > free:
            why, instead = self._most()
            msg = (
                f"{why} about {size_in_words(needed)} of memory, but {size_in_words(free)} are "
                f"free; {instead}, or cut the recording into shorter ones"
            )
            raise OSError(msg)
        left = shutil.disk_usage(existing(folder)).free
        if on_disk and self.disk > left:
            msg = (
                f"the results need about {size_in_words(self.disk)} of disk, but "
                f"{existing(folder)} has {size_in_words(left)} left; choose another folder or "
                "fewer methods"
            )
            raise OSError(msg)

    def _most(self) -> tuple[str, str]:
        """Say what needs most memory, and what could be done without it."""
        if self.start_is_most:
            return (
                "finding the safest frame to start from needs",
                "name a frame (boundary 0,0 is the first)",
            )
        instead = "leave such methods out (2-D, angular, temporal, T/A and A/T need little)"
        if self.greediest:
            return (
                f"{METHODS[self.greediest].label} works on all frames at once and needs",
                instead,
            )
        return "this needs", instead


def needs_of(recipe: Recipe, recording: Recording, lobes: Sequence[Lobe]) -> Needs:
    """Return what a run from holograms needs.

    Parameters
    ----------
    recipe : Recipe
        Its methods, ``boundary`` and ``confidence`` count.
    recording : Recording
        The hologram video; only its shape is looked at.
    lobes : sequence of Lobe
        The views; how large they are tells how many pixels the phase has.

    Returns
    -------
    Needs
        Bytes of memory and of disk, for phase, amplitude, results, and the camera's frames that
        are worked on.
    """
    height, width = Demodulator(recording.frame_shape, lobes).output_shape
    shape = (recording.n_frames, len(lobes), height, width)
    finds_start = recipe.boundary == "auto"
    found = phase_needs(
        recipe.methods, shape, finds_start=finds_start, confidence=recipe.confidence
    )
    camera = cores() * BYTES_OF_A_CAMERA_PIXEL * math.prod(recording.frame_shape)
    amplitude = 4 * math.prod(shape)
    return Needs(
        found.methods,
        found.in_memory + amplitude + camera,
        found.on_disk + camera,
        found.disk + amplitude,
        found.greediest,
        found.start_is_most,
    )


def phase_needs(
    methods: Sequence[str],
    shape: Sequence[int],
    *,
    finds_start: bool = False,
    confidence: bool = False,
) -> Needs:
    """Return what unwrapping of a stack (time, angle, y, x) needs.

    Parameters
    ----------
    methods : sequence of str
        Ids of the methods.
    shape : sequence of int
        That of the stack.
    finds_start : bool, optional
        Whether the safest frame to start from is still to be found.
    confidence : bool, optional
        Whether maps of confidence are made of all results.

    Returns
    -------
    Needs
        Bytes of memory and of disk.
    """
    stack, frame = 4 * math.prod(shape), 4 * math.prod(shape[2:])
    whole = [m for m in methods if not METHODS[m].streams]
    greediest = max(whole, key=lambda m: METHODS[m].working_stacks, default="")
    at_once = stack + working_bytes(stack, [greediest], frame=frame) if greediest else 0
    block = max((block_bytes(METHODS[m], shape) for m in methods), default=0)
    in_memory, on_disk = stack + working_bytes(stack, methods, frame=frame), block + at_once
    scratch = max((METHODS[m].scratch_bytes for m in methods), default=0) * math.prod(shape)
    start = start_bytes(shape) if finds_start else 0
    maps = 0
    if confidence:
        # Residues, of frames and of changes, take a byte each; of several wavelengths there is a
        # map by steps alone as well.
        each = 2 + STACKS_OF_A_SUPPORT
        maps = stack * (each * (len(methods) + 1)) + stack // 2
        graph = graph_bytes(shape)
        in_memory += maps + graph
        on_disk = max(on_disk, block_bytes(METHODS[REFERENCE], shape) + graph)
    return Needs(
        tuple(methods),
        max(in_memory, stack + start),
        max(on_disk, start),
        stack * (1 + len(methods)) + scratch + maps,
        greediest,
        start > max(in_memory - stack, on_disk),
    )


def block_bytes(method: Method, shape: Sequence[int]) -> int:
    """Return about how much memory a method needs that goes through a stack in blocks."""
    frames = block_frames(shape)
    if method.kept_bytes:
        frames = max(frames, working_frames(shape))
    block = cores() * method.block_bytes * frames * math.prod(shape[1:])
    return int(block + method.kept_bytes * math.prod(shape))


def start_bytes(shape: Sequence[int]) -> int:
    """Return about how much memory finding the safest frame needs, see `scores_of_some`."""
    pixels, frame = math.prod(shape), 4 * math.prod(shape[2:])
    if pixels <= SCORED_PIXELS:
        return 4 * pixels + working_bytes(4 * pixels, [SCORING_METHOD], frame=frame)
    looked_at = max(SCORED_PIXELS, 2 * math.prod(shape[1:]))
    of_threads = cores() * METHODS["directional-growing"].working_stacks * frame
    return int(4 * looked_at * SCORING_STACKS + of_threads)


def needed_bytes(recording: Recording, lobes: Sequence[Lobe], methods: Sequence[str]) -> int:
    """Return about how much memory a run will need, in bytes, with all stacks held there.

    Parameters
    ----------
    recording : Recording
        The hologram video; only its shape is looked at.
    lobes : sequence of Lobe
        The views; how large they are tells how many pixels the phase has.
    methods : sequence of str
        Ids of the methods to run, one after the other.

    Returns
    -------
    int
        Bytes, without finding a frame to start from and without maps of confidence.
    """
    recipe = Recipe(methods=tuple(methods), boundary=((0, 0),))
    return needs_of(recipe, recording, lobes).in_memory


def working_bytes(stack: int, methods: Sequence[str], *, frame: int) -> int:
    """Return about how much memory unwrapping needs, in bytes, beyond the wrapped phase.

    Parameters
    ----------
    stack : int
        Bytes of the wrapped phase as float32.
    methods : sequence of str
        Ids of the methods to run, one after the other.
    frame : int
        Bytes of one frame of it.

    Returns
    -------
    int
        Bytes: all results, the shared first step, and what the greediest of the methods needs.
    """
    largest = max((METHODS[m].working_stacks for m in methods), default=0)
    of_threads = cores() * STACKS_OF_A_FRAME * frame
    # The two-dimensional step and every result stay.
    return int(stack * (2 + len(methods) + largest) + of_threads)


def existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that is there."""
    folder = folder.absolute()
    return next(p for p in (folder, *folder.parents) if p.exists())


# ---- where stacks lie -----------------------------------------------------------------------


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
        if recipe.methods:
            problem.check_phase()
        return compare_on(
            problem, recipe.methods, truth, recipe.options, **task.calls, finished=finished
        )


def check_replaceable(folder: Path, recipe: Recipe) -> None:
    """Refuse a folder in which stacks of a run would be written over the input or other data.

    Raises
    ------
    OSError
        If something lies there by a name that the run needs, and no run has made it.
    """
    kinds = {"wrapped": ("units", "rad"), "amplitude": ("units", "a.u.")}
    kinds |= {m: ("method", m) for m in recipe.methods}
    kinds |= {f"confidence_{m}": ("of", m) for m in recipe.methods}
    for name, (what, value) in kinds.items():
        path = folder / f"{name}{OME_ZARR}"
        if not os.path.lexists(path):
            continue
        if recipe.recording and os.path.realpath(path) == os.path.realpath(recipe.recording):
            if name == "wrapped":  # which is left as it is
                continue
            raise over_input(path)
        noted = result_attrs(path)
        usual = value if name == "wrapped" else None  # a file of phase may note no unit
        if noted is None or noted.get(what, usual) != value:
            raise taken(path, "was not made by a run")


def over_input(path: Path) -> OSError:
    """Return the error that results would replace what they are made of."""
    return OSError(f"results would be written over the input {path}; choose another folder")


def taken(path: Path, how: str) -> OSError:
    """Return the error that something lies where a result would go."""
    return OSError(
        f"{path} is there already and {how}; move it away, or choose another folder for the "
        "results"
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

    Returns
    -------
    Place or None
        A place on disk if the recipe or a cluster asks for it, or memory is too small and the
        recipe leaves it open. Close it when the run has ended.

    Raises
    ------
    OSError
        If neither memory nor disk are enough, or no scheduler answers.
    """
    on_disk = scheduler is not None or recipe.storage == "disk"
    if recipe.storage == "auto":
        on_disk = on_disk or not needs.fits_in_memory()
    where = roomy() if folder is None else local_path(folder)
    needs.check(where, on_disk=on_disk)
    if not on_disk:
        return None
    if folder is not None:
        check_replaceable(Path(folder), recipe)
    workers: Workers = Threads() if scheduler is None else Cluster(scheduler)
    return Place(Shelf(temporary_folder() if folder is None else Path(folder)), workers)


@contextmanager
def stacks_beside(folder: str | Path, form: str | None) -> Iterator[Path]:
    """Give where stacks on disk go before results are written to a folder in a form.

    It is the folder itself, unless they are wished for in another form than that of the disk.

    Parameters
    ----------
    folder : str or Path
        Where the results will be written.
    form : str or None
        "tiff", "zarr" or None, see `write_outcome`.

    Yields
    ------
    Path
        The folder, or for "tiff" a hidden new one, which is removed afterwards.
    """
    if form != "tiff":
        yield Path(folder)
        return
    hidden = new_folder(Path(folder), ".phase4d")
    try:
        yield hidden
    finally:
        remove_folder(hidden)


@checked_call
def make_folder(out: Path) -> None:
    """Make the folder for results.

    Parameters
    ----------
    out : Path
        It may be there already; the folders that it lies in are made too.

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
