"""How well the steps support a result: the way to each pixel, and what holds it there.

The smoothest way from the empty field may leave a span of frames and come back. Of all that lies
before a frame, only how rough the best way between any two of its pixels gets matters to what
comes after, and likewise backwards. A spanning tree of these pixels tells that exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.task import UNWATCHED, Task, Watch
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.graph import (
    Pixel,
    PixelGraph,
    graphs_of,
    held_island,
    spans_of,
)
from napari_phase4d.unwrapping.directional.merging import held_by_steps, smoothest_first
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.directional.regions import Field
from napari_phase4d.unwrapping.directional.scene import NOISY, Scene
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import Given, blocks_within
from napari_phase4d.unwrapping.light import ViewsOf
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.shared_steps import GRAPH

__all__ = ["Astray", "Judged", "Support", "astray", "supports_by_steps"]

Whole = NDArray[np.int32]
Image = NDArray[np.float32]

#: Name of the island that is held; pixels of a frame are called by their numbers.
HELD = -1
#: Name of what is no end of a way.
NO_NAME = -2


@dataclass(frozen=True)
class Tree:
    """Steps that stand for the best ways between some ends.

    Parameters
    ----------
    first, second : ndarray of int
        Names of both ends of each.
    rough : ndarray of float
        How rough the best way between them gets, radians.
    """

    first: Whole
    second: Whole
    rough: Image

    def between(self, nodes: Whole) -> Tree:
        """Return the same ways between nodes; those of all pixels of a frame's box are given."""
        ends = (self.first, self.second)
        first, second = (np.where(end == HELD, np.int32(0), nodes[end]) for end in ends)
        return Tree(first, second, self.rough)

    def with_others(self, other: Tree) -> Tree:
        """Return these ways and others."""
        return Tree(
            np.concatenate([self.first, other.first]),
            np.concatenate([self.second, other.second]),
            np.concatenate([self.rough, other.rough]),
        )

    def further(self, by: int) -> Tree:
        """Return the same ways where pixels have names so much higher."""
        ends = (self.first, self.second)
        first, second = (np.where(end == HELD, end, end + np.int32(by)) for end in ends)
        return Tree(first, second, self.rough)


NO_TREE = Tree(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))


class KeptTrees:
    """Trees that are kept until they are needed, in memory or on disk.

    Parameters
    ----------
    store : Store
        Where they lie.
    name : str
        What they are called.
    """

    def __init__(self, store: Store, name: str) -> None:
        self._store, self._name = store, name
        self._kept: dict[int, Kept] = {}

    def __setitem__(self, number: int, tree: Tree) -> None:
        """Keep a tree."""
        if not len(tree.rough):
            self._kept.pop(number, None)
            return
        rows = np.stack([tree.first, tree.second, tree.rough.view(np.int32)])
        kept = self._store.temporary(f"{self._name}{number}", (1, 1, *rows.shape), "int32")
        kept.write(Block(0, 1), rows[None, None])
        self._kept[number] = kept

    def __getitem__(self, number: int) -> Tree:
        """Return a tree; an empty one if there is none of this number."""
        if number not in self._kept:
            return NO_TREE
        first, second, rough = self._kept[number].read(Block(0, 1))[0, 0]
        return Tree(first, second, rough.view(np.float32))


class Kept(Protocol):
    """A stack."""

    def read(self, block: Block) -> NDArray[np.int32]:
        """Return some of it."""

    def write(self, block: Block, values: NDArray[np.int32]) -> None:
        """Write some of it."""


class WaysOutside:
    """The ways outside of each span, of trees of its own frames.

    Parameters
    ----------
    store : Store
        Where trees lie.
    name : str
        What the result is called.
    pixels : int
        How many the box of a frame (angle, y, x) has.
    """

    def __init__(self, store: Store, name: str, pixels: int) -> None:
        self._inside = KeptTrees(store, f"{name}_inside")
        self._before = KeptTrees(store, f"{name}_before")
        self._after = KeptTrees(store, f"{name}_after")
        self._pixels = pixels

    def add(self, span: int, graph: PixelGraph, agreeing: Whole) -> None:
        """Take what a span's own frames tell: ways between its first frame and the one after.

        Of its steps those count that a result agrees with, the smoothest first.

        Pixels of the frame after it are called by their numbers and those of a frame more.
        """
        names = np.full(graph.n, NO_NAME, dtype=np.int32)
        for further, time in ((self._pixels, graph.core.stop), (0, graph.core.start)):
            if graph.around.start <= time < graph.around.stop:
                call_by_pixels(names, graph.nodes_at(time), further)
        names[0] = HELD
        self._inside[span] = Tree(*joined(agreeing, graph.first, graph.second, graph.rough, names))

    def follow(self, spans: int) -> None:
        """Follow the ways from span to span, forwards and backwards."""
        for span in range(1, spans):
            self._before[span] = self._through(self._before[span - 1], span - 1, 0, self._pixels)
        for span in range(spans - 2, -1, -1):
            self._after[span] = self._through(self._after[span + 1], span + 1, self._pixels, 0)

    def _through(self, outside: Tree, span: int, at: int, to: int) -> Tree:
        """Take what lies outside of one end of a span through it, to the frame at the other."""
        ways = outside.further(at).with_others(self._inside[span])
        # Nodes are the held island, the pixels of the first frame, and those of the one after.
        names = np.full(2 * self._pixels + 1, NO_NAME, dtype=np.int32)
        names[0] = HELD
        names[1 + to : 1 + to + self._pixels] = np.arange(self._pixels, dtype=np.int32)
        return spanning(ways.first + np.int32(1), ways.second + np.int32(1), ways.rough, names)

    def before(self, span: int) -> Tree:
        """Return the ways between pixels of the span's first frame."""
        return self._before[span]

    def after(self, span: int) -> Tree:
        """Return the ways between pixels of the frame after the span."""
        return self._after[span]


def spanning(first: Whole, second: Whole, rough: Image, names: Whole) -> Tree:
    """Return a tree of the ends that have names, with how rough the best ways between them get.

    Parameters
    ----------
    first, second, rough
        Steps between nodes, see `PixelGraph`.
    names : ndarray of int
        The name of every node; -2 where it has none.
    """
    return Tree(*joined(smoothest_first(rough), first, second, rough, names))


@compiled
def call_by_pixels(names: Whole, nodes: Whole, more: int) -> None:
    """Call every node of a frame by the first of its pixels, counted from a number on."""
    for pixel in range(len(nodes) - 1, -1, -1):
        names[nodes[pixel]] = pixel + more


@compiled
def joined(
    order: Whole, first: Whole, second: Whole, rough: Image, names: Whole
) -> tuple[Whole, Whole, Image]:
    """Join nodes along steps in order, and list the joins of parts that have named ends.

    Of all named ends that a part has, any will do.
    """
    n = len(names)
    parent = np.arange(n).astype(np.int32)
    size = np.ones(n, dtype=np.int32)
    end = names.copy()
    most = np.count_nonzero(names != NO_NAME)
    one, other = np.empty(most, dtype=np.int32), np.empty(most, dtype=np.int32)
    how = np.empty(most, dtype=np.float32)
    count = 0
    for i in order:
        a, b = first[i], second[i]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a == b:
            continue
        if size[a] < size[b]:
            a, b = b, a
        parent[b] = a
        size[a] += size[b]
        if end[a] != NO_NAME and end[b] != NO_NAME:
            one[count], other[count], how[count] = end[a], end[b], rough[i]
            count += 1
        elif end[b] != NO_NAME:
            end[a] = end[b]
    return one[:count], other[:count], how[:count]


TURN = np.float32(2 * np.pi)
#: What has no way to the empty field is as rough as this, in radians.
NO_WAY = 12.0
#: Variance of what a noisy pixel and the average of its neighbours differ by, as a share of that
#: of the noise. Fitted to one half of the moving cells, at noises of 0.7 and 0.9 rad.
APART = 1.7

Short = NDArray[np.int16]


@dataclass(frozen=True)
class Support:
    """What the steps say of each pixel of a result.

    Parameters
    ----------
    roughest : Stack
        The roughest step, in radians, on the smoothest way from the empty field.
    held : Stack
        From -1 to 1: how firmly the steps hold the parts that the pixel belongs to against a turn
        more or less, see `held_by_steps`.
    anchored : bool
        Whether ways begin at an empty field, which is in view in some frame.
    """

    roughest: Stack
    held: Stack
    anchored: bool


@dataclass(frozen=True)
class Judged:
    """A result to be judged.

    Parameters
    ----------
    values : Stack
        Unwrapped phase of any method, radians; NaN counts as empty field.
    wrapped : Given, optional
        The wrapped phase, where a mask has left out pixels: they are 0 without being the wrapped
        phase and whole turns, and count as empty field.
    """

    values: Stack
    wrapped: Given | None = None

    def read(self, block: Block) -> Image:
        """Return some times; what counts as empty field is NaN."""
        values: Image = self.values.read(block)
        if self.wrapped is None:
            return values
        left_out = (values == 0) & (self.wrapped.read(block)[0] != 0)
        return np.where(left_out, np.float32(np.nan), values)

    def of_views(self, views: tuple[int, ...]) -> Judged:
        """Return some views of it."""
        wrapped = None if self.wrapped is None else self.wrapped.of_views(views)
        return Judged(ViewsOf(self.values, views), wrapped)


def supports_by_steps(
    problem: Problem,
    results: Mapping[str, Judged],
    task: Task = UNWATCHED,
) -> dict[str, Support]:
    """Return how well the steps support each pixel of some results.

    A way goes along steps over time, angle, y and x, and only along those that a result agrees
    with: whose wrap count is the one that directional L1 would give them. Of all ways from the
    empty field the one whose roughest step is smoothest counts (a bottleneck path). Where the
    phase of a whole object hangs on rough steps alone, or where a result contradicts smooth steps,
    it is rough. A smooth way may lead into a part by accident; then most other steps at its rim
    are against it, or for nothing, and it is not held. Where no frame shows an empty field, ways
    begin in the largest part of the boundary frame instead.

    A long recording is looked at a span of frames at a time. Ways lead through all of it even so,
    see `WaysOutside`; the steps at the rim of a part are those of its span.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    results : mapping of str to Judged
        The results, by words.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    field = prepared(problem, task)
    cores = spans_of(field.scene.part)
    anchored = held_island(field.scene) is not None

    def stack(part: str, name: str) -> Stack:
        return problem.store.temporary(f"{part}_{name}", problem.given.shape, "float32")

    supports = {
        name: Support(stack("roughest", name), stack("held", name), anchored) for name in results
    }
    ways: dict[str, WaysOutside] = {}
    if len(cores) > 1:
        ways = followed_ways(problem, field, results, cores, task)
    watch = Watch(1, "weighing the steps", task)
    for span, graph in numbered(graphs(problem, field, cores, watch), cores):
        for name, result in results.items():  # one by one: each takes as much as the graph
            watch.check()
            outside_ways = outside(graph, ways.get(name), span)
            Look(problem, field.scene, graph, result).write(supports[name], outside_ways)
        del graph
    return supports


def graphs(
    problem: Problem, field: Field, cores: list[Block], watch: Watch
) -> Iterable[PixelGraph]:
    """Return the graph of each span, in some order; that of a single one is kept for others."""

    def all_of_them() -> Iterator[PixelGraph]:
        # By themselves: at rims of what moves, steps are smooth again after they were rough.
        steps = followed_steps(field.scene, field.floors, watch, remembering=False)
        return graphs_of(field.scene, steps, cores, origin_of(field))

    if len(cores) > 1:
        return all_of_them()
    return problem.once(GRAPH, lambda: list(all_of_them()))


def origin_of(field: Field) -> Pixel | None:
    """Return the pixel (time, angle, y, x) of the box that ways begin at without an empty field.

    It lies deepest inside of the largest part of the boundary frame that certain steps join. None
    where there is an empty field in any frame.
    """
    scene = field.scene
    if held_island(scene) is not None:
        return None
    time, angle = scene.frames.start
    start = Block(time, time + 1)
    region = field.regions.read(start)[0][0, angle][scene.box]
    free = scene.free(start)[0, angle]
    if not free.any():
        return None
    largest = int(np.argmax(np.bincount(region[free])))
    inside = np.pad(free & (region == largest), 1)
    depth = scipy.ndimage.distance_transform_edt(inside)[1:-1, 1:-1]
    y, x = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return time, angle, int(y), int(x)


def numbered(found: Iterable[PixelGraph], cores: list[Block]) -> Iterator[tuple[int, PixelGraph]]:
    """Give each graph the number of its span."""
    for graph in found:
        yield cores.index(graph.core), graph
        del graph  # or two would be held while the next is made


def followed_ways(
    problem: Problem,
    field: Field,
    results: Mapping[str, Judged],
    cores: list[Block],
    task: Task,
) -> dict[str, WaysOutside]:
    """Return the ways outside of every span, for each result."""
    pixels = math.prod(field.scene.part[1:])
    found = {name: WaysOutside(problem.store, name, pixels) for name in results}
    watch = Watch(1, "following ways", task)
    for span, graph in numbered(graphs(problem, field, cores, watch), cores):
        for name, result in results.items():
            watch.check()
            off = Look(problem, field.scene, graph, result).off()
            found[name].add(span, graph, agreeing(graph, off))
        del graph
    for ways in found.values():
        watch.check()
        ways.follow(len(cores))
    return found


def outside(graph: PixelGraph, ways: WaysOutside | None, span: int) -> Tree:
    """Return the ways outside of a span between nodes of its graph."""
    if ways is None:
        return NO_TREE
    found = NO_TREE
    for tree, time in (
        (ways.before(span), graph.core.start),
        (ways.after(span), graph.core.stop),
    ):
        if len(tree.rough):
            found = found.with_others(tree.between(graph.nodes_at(time)))
    return found


def agreeing(graph: PixelGraph, off: Short) -> Whole:
    """Return the steps that a result agrees with, the smoothest first."""
    found: Whole = graph.order[off[graph.order] == 0]
    return found


def with_ways(order: Whole, rough: Image, ways: Image) -> Whole:
    """Put the numbers of ways, which come after those of all steps, among ordered steps."""
    own = smoothest_first(ways)
    places = np.searchsorted(rough[order], ways[own], side="right")
    found: Whole = np.insert(order, places, own + np.int32(len(rough)))
    return found


@dataclass(frozen=True)
class Look:
    """Looks at a result over the frames of a graph.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    scene : Scene
        It, the object held in place.
    graph : PixelGraph
        The steps.
    result : Judged
        The result.
    """

    problem: Problem
    scene: Scene
    graph: PixelGraph
    result: Judged

    def off(self) -> Short:
        """Return by how many turns the result differs from what each step asks for."""
        turns = self.turns()
        found = turns[self.graph.second]
        found -= turns[self.graph.first]
        found -= self.graph.turns
        return found

    def turns(self) -> Short:
        """Return the wrap count of every node, relative to each frame's empty field.

        Without any, it is relative to the pixel that ways begin at.
        """
        graph, scene = self.graph, self.scene
        found = np.zeros(graph.n, dtype=np.int16)
        behind = np.zeros((2, graph.n_islands if len(graph.behind) else 0))
        for block in blocks_within(graph.around, scene.shape):
            of_box = self._turns_of(block)[:, :, *scene.box]
            nodes = graph.nodes[block.of(graph.around)]
            found[nodes] = of_box
            if behind.size:
                inside = nodes < graph.n_islands
                for row, of_each in zip(behind, (None, of_box[inside]), strict=True):
                    row += np.bincount(nodes[inside], of_each, graph.n_islands)
        if graph.origin is not None and graph.origin[0] in graph.around.times:
            found -= found[0]
        found[: graph.n_islands] = 0
        if behind.size:  # their mean turns: a pixel of them may be a turn off by noise
            number, total = behind[:, graph.behind]
            found[graph.behind] = np.round(total / np.maximum(number, 1))
        return found

    def _turns_of(self, block: Block) -> Short:
        """Return the wrap counts of some frames, relative to each frame's empty field."""
        scene = self.scene
        kept = scene.frames.kept[block.start : block.stop]
        times = Block(int(kept[0]), int(kept[-1]) + 1)
        background = self.problem.background()
        level = border_medians(background.level, self.problem.first)
        steady = (self.result.read(times) - background.ground(level, times))[kept - times.start]
        seen = scene.read(block)
        turns = np.round((scene.placed(steady, block, np.nan) - seen.phase) / TURN)
        known = np.isfinite(turns)
        turns = np.where(known, turns, 0).astype(np.int16)
        for frame in np.ndindex(*turns.shape[:2]):
            # What a mask left out is the field at its level; in what it kept, an even part of a
            # cell may pass for empty.
            if seen.empty[frame].any():
                off = np.int16(np.median(turns[frame][seen.empty[frame]]))
                turns[frame] -= off * known[frame]
        return turns

    def write(self, support: Support, outside: Tree) -> None:
        """Write how well the steps support the times that the graph stands for."""
        graph, off = self.graph, self.off()
        order, ways = agreeing(graph, off), Tree(graph.first, graph.second, graph.rough)
        if len(outside.rough):
            order = with_ways(order, graph.rough, outside.rough)
            ways = ways.with_others(outside)
        ends, shared = (ways.first, ways.second), (graph.weight, graph.number)
        worst, held = held_by_steps(*ends, off, ways.rough, graph.n, NO_WAY, order, shared)
        np.clip(worst, np.float32(0), np.float32(NO_WAY), out=worst)
        for part in blocks_within(graph.core, self.scene.shape):
            nodes = graph.nodes_of(part, self.scene)
            times, which = times_of(self.scene, part)
            for stack, of_nodes in ((support.roughest, worst), (support.held, held)):
                stack.write(times, self.scene.taken_back(of_nodes[nodes], part)[which])


def times_of(scene: Scene, core: Block) -> tuple[Block, NDArray[np.intp]]:
    """Return the times that some kept frames stand for, and which of them each time takes."""
    kept, n = scene.frames.kept, len(scene.frames.lost)
    first = 0 if core.start == 0 else int(kept[core.start])
    times = Block(first, n if core.stop == len(kept) else int(kept[core.stop]))
    return times, scene.frames.all_times(times) - core.start


@dataclass(frozen=True)
class Astray:
    """The chance that the noise of a pixel alone takes it more than half a turn away.

    Where its neighbours, averaged along the slope, say e radians else than the pixel, the two
    differ by e or by e - 2 pi. For a normal distribution of variance v the odds of the latter are
    exp(-((2 pi - e)^2 - e^2) / (2 v)); v is 1.7 times that of the noise, as the average is noisy
    too. 0 where there is too little noise to be averaged.

    Parameters
    ----------
    scene : Scene
        What was unwrapped.
    """

    scene: Scene

    def read(self, block: Block) -> Image:
        """Return it for some times."""
        scene = self.scene
        if scene.noise < NOISY:
            return np.zeros((len(block), *scene.frames.shape[1:]), dtype=np.float32)

        def of_kept(kept: Block) -> tuple[Image]:
            away = np.abs(turned(scene.noisy_phase(kept) - scene.read(kept).phase))
            per_radian = np.float32(2 * np.pi / (APART * scene.noise**2))
            odds = np.exp((away - np.float32(np.pi)) * per_radian)
            return (odds / (1 + odds),)

        (found,) = scene.put_back(block, of_kept)
        return found


def astray(
    problem: Problem,
    task: Task = UNWATCHED,
) -> Astray:
    """Return the chance that noise alone takes a pixel astray, to be read in blocks of times.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    return Astray(prepared(problem, task).scene)
