"""How well the steps support a result: the way to each pixel, and what holds it there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.merging import held_by_steps
from napari_phase4d.unwrapping.directional.methods import Field, prepared
from napari_phase4d.unwrapping.directional.regions import FIELD_SHARE, FIRM
from napari_phase4d.unwrapping.directional.scene import NOISY, Scene
from napari_phase4d.unwrapping.directional.steps import Opinion
from napari_phase4d.unwrapping.ends import ends_along
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.sharing import GRAPH
from napari_phase4d.unwrapping.spatial import border_medians

__all__ = ["Support", "astray", "roughest_on_the_way", "support_by_steps"]

TURN = np.float32(2 * np.pi)
#: What has no way to the empty field is as rough as this, in radians.
NO_WAY = 12.0
#: Variance of what a noisy pixel and the average of its neighbours differ by, as a share of that
#: of the noise. Fitted to one half of the moving cells, at noises of 0.7 and 0.9 rad.
APART = 1.7

Stack = NDArray[np.float32]
Whole = NDArray[np.int32]


@dataclass(frozen=True)
class Support:
    """What the steps say of each pixel of a result.

    Parameters
    ----------
    roughest : ndarray of shape (time, angle, y, x)
        The roughest step, in radians, on the smoothest way from the empty field.
    held : ndarray, same shape
        From -1 to 1: how firmly the steps hold the parts that the pixel belongs to against a turn
        more or less, see `held_by_steps`.
    """

    roughest: Stack
    held: Stack


def support_by_steps(
    problem: Problem,
    unwrapped: Stack,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Support:
    """Return how well the steps support each pixel of a result.

    A way goes along steps over time, angle, y and x, and only along those that a result agrees
    with: whose wrap count is the one that directional L1 would give them. Of all ways from the
    empty field the one whose roughest step is smoothest counts (a bottleneck path). Where the
    phase of a whole object hangs on rough steps alone, or where a result contradicts smooth steps,
    it is rough. A smooth way may lead into a part by accident; then most other steps at its rim
    are against it, or for nothing, and it is not held.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    unwrapped : ndarray of shape (time, angle, y, x)
        A result of any method, radians; NaN counts as empty field.
    progress, cancelled : callable, optional
        See `unwrap`.
    """
    field = prepared(problem, progress, cancelled)
    watch = Watch(1, "weighing the steps", progress, cancelled)
    graph = problem.once(GRAPH, lambda: pixel_graph(field, watch))
    turns = turns_of_nodes(field.scene, graph, problem, unwrapped)
    off = turns[graph.second] - turns[graph.first] - graph.turns
    worst, held = held_by_steps(graph.first, graph.second, off, graph.rough, graph.n, NO_WAY)
    return Support(
        np.clip(of_pixels(field.scene, graph, worst), np.float32(0), np.float32(NO_WAY)),
        of_pixels(field.scene, graph, held),
    )


@dataclass(frozen=True)
class PixelGraph:
    """Every pixel of the object and every island of the empty field as a node.

    Parameters
    ----------
    nodes : ndarray of int, shape (kept time, angle, y, x)
        Node of every pixel of the moved frames. The pixels of an island in one frame share one; 0
        is the island that is held, and stands for what has none.
    n_islands, n : int
        How many nodes are islands, which come first; how many there are.
    first, second : ndarray of int
        The nodes at both ends of every step.
    turns : ndarray of int
        Turns of the second minus those of the first, as the step asks for.
    rough : ndarray of float
        Roughness of every step in radians.
    """

    nodes: Whole
    n_islands: int
    n: int
    first: Whole
    second: Whole
    turns: Whole
    rough: Stack


def pixel_graph(field: Field, watch: Watch) -> PixelGraph:
    """Return the graph of all pixels, in memory."""
    scene = field.scene
    every = Block(0, scene.shape[0])
    islands, n_islands, fields = islands_of(scene.islands(every), scene.frames.start)
    free = scene.read(every).free
    nodes = np.maximum(islands, 0)
    n = n_islands + int(np.count_nonzero(free))
    nodes[free] = np.arange(n_islands, n, dtype=np.int32)
    inside = nodes[:, :, *scene.box]
    columns: list[tuple[Whole, Whole, Whole, Stack]] = []
    for weighed in followed_steps(scene, field.floors, watch):
        first = weighed.block.start
        for opinions in (weighed.by_axis, weighed.followed):
            for axis, opinion in opinions.items():
                more = 1 if axis == 0 else 0
                frames = slice(first, first + len(opinion.turns) + more)
                columns.append(listed(inside[frames], axis, opinion))
    others = fields[fields != 0]
    none = np.zeros(len(others), dtype=np.int32)
    columns.append((none, others, none, np.full(len(others), FIRM, dtype=np.float32)))
    first_, second, turns, rough = (np.concatenate(c) for c in zip(*columns, strict=True))
    return PixelGraph(nodes, n_islands, n, first_, second, turns, rough)


def listed(nodes: Whole, axis: int, opinion: Opinion) -> tuple[Whole, Whole, Whole, Stack]:
    """List the steps along an axis between nodes (time, angle, y, x)."""
    head, tail = ends_along(axis, 4)
    kept = opinion.kept
    turns = opinion.turns[kept].astype(np.int32)
    return nodes[head][kept], nodes[tail][kept], turns, opinion.rough[kept]


def islands_of(islands: Whole, start: tuple[int, int]) -> tuple[Whole, int, Whole]:
    """Give the islands of the empty field numbers through all frames; -1 where there is none.

    The largest one of the start is 0; else, if that frame has none, the largest of all. There is
    always one number at least, even where no pixel has it.

    Parameters
    ----------
    islands : ndarray of int, shape (time, angle, y, x)
        Their numbers in each frame by itself, from 0; -1 elsewhere.
    start : tuple of int
        Frame (time, angle).

    Returns
    -------
    found : ndarray of int, shape of the islands
        The number of each pixel's island.
    count : int
        How many there are.
    fields : ndarray of int
        The largest island of every frame, where it takes enough of it to be the field.
    """
    found = np.full(islands.shape, -1, dtype=np.int32)
    count, fields = 0, []
    for frame in np.ndindex(*islands.shape[:2]):
        numbers = islands[frame]
        sizes = np.bincount(numbers.ravel() + 1)[1:]
        found[frame] = np.where(numbers >= 0, numbers + count, -1)
        if len(sizes) and sizes.max() >= FIELD_SHARE * numbers.size:
            fields.append(count + int(np.argmax(sizes)))
        count += len(sizes)
    if count == 0:
        return found, 1, np.zeros(0, dtype=np.int32)
    in_start = found[start]
    asked = in_start if (in_start >= 0).any() else found
    largest = int(np.argmax(np.bincount(asked[asked >= 0])))
    swap = np.arange(count + 1, dtype=np.int32)
    swap[-1] = -1  # where nothing is empty
    swap[[0, largest]] = swap[[largest, 0]]
    return swap[found], count, swap[np.array(fields, dtype=np.intp)]


def roughest_on_the_way(
    problem: Problem,
    unwrapped: Stack,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return how rough the best way from the empty field to each pixel gets, in radians.

    Parameters
    ----------
    problem, unwrapped, progress, cancelled
        See `support_by_steps`.
    """
    return support_by_steps(problem, unwrapped, progress, cancelled).roughest


def astray(
    problem: Problem,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return the chance that the noise of a pixel alone takes it more than half a turn away.

    Where its neighbours, averaged along the slope, say e radians else than the pixel, the two
    differ by e or by e - 2 pi. For a normal distribution of variance v the odds of the latter are
    exp(-((2 pi - e)^2 - e^2) / (2 v)); v is 1.7 times that of the noise, as the average is noisy
    too. 0 where there is too little noise to be averaged.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    progress, cancelled : callable, optional
        See `unwrap`.
    """
    scene = prepared(problem, progress, cancelled).scene
    if scene.noise < NOISY:
        return np.zeros(problem.wrapped.shape, dtype=np.float32)
    every = Block(0, scene.shape[0])
    away = np.abs(turned(scene.noisy_phase(every) - scene.read(every).phase))
    odds = np.exp((away - np.float32(np.pi)) * np.float32(2 * np.pi / (APART * scene.noise**2)))
    return at_all_times(scene, moved(odds / (1 + odds), -scene.shifts))


def at_all_times(scene: Scene, stack: Stack) -> Stack:
    """Return a stack of the kept times with the times left out, taken from the one before."""
    n = len(scene.frames.lost)
    return stack if len(stack) == n else stack[scene.frames.all_times(Block(0, n))]


def of_pixels(scene: Scene, graph: PixelGraph, of_nodes: Stack) -> Stack:
    """Return what nodes have on all pixels of all times."""
    return at_all_times(scene, moved(of_nodes[graph.nodes], -scene.shifts))


def turns_of_nodes(scene: Scene, graph: PixelGraph, problem: Problem, unwrapped: Stack) -> Whole:
    """Return the wrap count of every node in a result, relative to each frame's empty field."""
    background = problem.background()
    level = background.ground(border_medians(background.level, problem.first))
    seen = scene.read(Block(0, scene.shape[0]))
    steady = (unwrapped - level)[scene.frames.kept]
    turns = np.round((moved(steady, scene.shifts) - seen.phase) / TURN)
    known = np.isfinite(turns)
    turns = np.where(known, turns, 0).astype(np.int32)
    for frame in np.ndindex(*turns.shape[:2]):
        # What a mask left out is the field at its level; in what it kept, an even part of a cell
        # may pass for empty.
        if seen.empty[frame].any():
            off = np.int32(np.median(turns[frame][seen.empty[frame]]))
            turns[frame] -= off * known[frame]
    found = np.zeros(graph.n, dtype=np.int32)
    found[graph.nodes] = turns
    found[: graph.n_islands] = 0
    return found
