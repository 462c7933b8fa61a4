"""What a run will need, and whether this machine has it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from napari_phase4d.analysis import REFERENCE
from napari_phase4d.holography import Demodulator, Lobe
from napari_phase4d.machine import cores, free_memory
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.stack import block_frames
from napari_phase4d.unwrapping import (
    METHODS,
    SCORED_PIXELS,
    SCORING_METHOD,
    STACKS_OF_A_FRAME,
    Method,
    graph_bytes,
    working_frames,
)
from napari_phase4d.words import size_in_words

__all__ = ["Needs", "needed_bytes", "needs_of", "phase_needs", "working_bytes"]

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
    """Return what a run from holograms needs."""
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
        maps = stack * (len(methods) + STACKS_OF_A_SUPPORT * (len(methods) + 1) + 1)
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
    """Return about how much memory a run will need, in bytes, with all stacks held there."""
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
    """
    largest = max((METHODS[m].working_stacks for m in methods), default=0)
    of_threads = cores() * STACKS_OF_A_FRAME * frame
    # The two-dimensional step and every result stay.
    return int(stack * (2 + len(methods) + largest) + of_threads)


def existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that is there."""
    folder = folder.absolute()
    return next(p for p in (folder, *folder.parents) if p.exists())
