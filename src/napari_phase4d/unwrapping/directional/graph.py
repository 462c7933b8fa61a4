"""Every pixel of the object as a node: the graph of its steps, a span of frames at a time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, blocks_of
from napari_phase4d.unwrapping.directional.ground import FIELD_SHARE
from napari_phase4d.unwrapping.directional.merging import smoothest_first, weight_of_hold
from napari_phase4d.unwrapping.directional.regions import FIRM
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Opinion, Weighed
from napari_phase4d.unwrapping.given import blocks_within
from napari_phase4d.unwrapping.neighbours import ends_along

__all__ = [
    "Pixel",
    "PixelGraph",
    "graph_bytes",
    "graphs_of",
    "held_island",
    "spans_of",
]

#: Pixels of the object's box, of all views, in a span, unless it has fewer than so many frames.
SPAN_PIXELS, SPAN_FRAMES = 4_000_000, 8
#: What a graph and the search for ways in it take, where all pixels belong to the object.
BYTES_OF_A_PIXEL = 200
#: Dead lines of a camera beside each other, and pixels over which field faces field across them.
MOST_DEAD, LEAST_FACING = 4, 8

Image = NDArray[np.float32]
Whole = NDArray[np.int32]
Mask = NDArray[np.bool_]
Islands = dict[tuple[int, int], Whole]
Pixel = tuple[int, int, int, int]


class DeadLines(NamedTuple):
    """Which rows and which columns of a view the camera never sees."""

    rows: Mask
    columns: Mask


def spans_of(part: Sequence[int]) -> list[Block]:
    """Cut the kept frames into spans: one, unless the recording is long.

    Where it is cut depends on nothing but its size.

    Parameters
    ----------
    part : sequence of int
        Shape of the object's box over the kept frames (time, angle, y, x).
    """
    frames = max(SPAN_FRAMES, SPAN_PIXELS // max(math.prod(part[1:]), 1))
    return blocks_of(part, min(frames, part[0]))


def graph_bytes(shape: Sequence[int]) -> int:
    """Return about how much memory a graph takes at most, of a stack (time, angle, y, x)."""
    spans = spans_of(shape)
    return BYTES_OF_A_PIXEL * max(map(len, spans)) * math.prod(shape[1:])


@dataclass(frozen=True)
class Steps:
    """Some steps.

    Parameters
    ----------
    first, second : ndarray of int
        Both ends: pixels of the box (angle, y, x) of their times, counted through, or nodes.
    turns : ndarray of int16
        Turns of the second end minus those of the first, as the step asks for.
    rough : ndarray of float32
        Roughness in radians.
    """

    first: Whole
    second: Whole
    turns: NDArray[np.int16]
    rough: Image

    def some(self, which: NDArray[np.bool_]) -> Steps:
        """Return some of them."""
        return Steps(self.first[which], self.second[which], self.turns[which], self.rough[which])

    def between(self, first: Whole, second: Whole) -> Steps:
        """Return them between nodes; those of all pixels at both ends are given."""
        return Steps(first[self.first], second[self.second], self.turns, self.rough)


NO_ENDS = np.zeros(0, dtype=np.int32)


def all_steps(parts: Iterable[Steps]) -> Steps:
    """Return lists of steps as one."""
    listed = list(parts)
    return Steps(
        np.concatenate([NO_ENDS, *(own.first for own in listed)]),
        np.concatenate([NO_ENDS, *(own.second for own in listed)]),
        np.concatenate([NO_ENDS.astype(np.int16), *(own.turns for own in listed)]),
        np.concatenate([NO_ENDS.astype(np.float32), *(own.rough for own in listed)]),
    )


def steps_by_time(weighed: Weighed, part: Sequence[int]) -> Iterator[tuple[Steps, Steps]]:
    """Yield the steps of every time of a block and those to the next, always in the same order."""
    numbers = np.arange(math.prod(part[1:]), dtype=np.int32).reshape(tuple(part[1:]))
    within = [
        (axis, opinion)
        for opinions in (weighed.by_axis, weighed.followed)
        for axis, opinion in sorted(opinions.items())
        if axis > 0
    ]
    ahead = weighed.by_axis.get(0)
    for i in range(len(weighed.block)):
        found = []
        for axis, opinion in within:
            head, tail = (numbers[ends] for ends in ends_along(axis - 1, 3))
            found.append(kept_steps(opinion, i, head, tail))
        link = []
        if ahead is not None and i < len(ahead.turns):
            link.append(kept_steps(ahead, i, numbers, numbers))
        yield all_steps(found), all_steps(link)


def kept_steps(opinion: Opinion, i: int, first: Whole, second: Whole) -> Steps:
    """Return the steps along an axis at a time of a block; all their ends are given."""
    kept = opinion.kept[i]
    return Steps(first[kept], second[kept], opinion.turns[i][kept], opinion.rough[i][kept])


@dataclass(frozen=True)
class PixelGraph:
    """Every pixel of the object and every island of the empty field as a node, over some frames.

    Parameters
    ----------
    core : Block
        The kept frames that it stands for.
    around : Block
        Those that it holds: the frame before and the one after too.
    nodes : ndarray of int, shape (time, angle, y, x)
        Node of every pixel in the object's box of the moved frames around. The pixels of an island
        in one frame share one; 0 is the island that is held, and stands for what has none.
    islands : dict of tuple to ndarray of int
        The nodes of a frame's islands, by the frame (time, angle), in the order of
        `Scene.islands`. Outside of the box there is nothing else.
    origin : tuple of int, or None
        Where no empty field is in view anywhere, the pixel (time, angle, y, x) of the box that is
        held instead, as node 0.
    n_islands, n : int
        How many nodes are islands, which come first; how many there are.
    first, second : ndarray of int
        The nodes at both ends of every step.
    turns : ndarray of int16
        Turns of the second minus those of the first, as the step asks for.
    rough : ndarray of float
        Roughness of every step in radians.
    order : ndarray of int
        The steps, the smoothest first.
    weight, number : ndarray
        The last steps stand for several each, which lead between the same islands of the empty
        field and ask for the same: what these hold together, and how many they are.
    behind : ndarray of int
        The islands in which the field goes on behind dead lines; a result may have them elsewhere.
    """

    core: Block
    around: Block
    nodes: Whole
    islands: Islands
    origin: Pixel | None
    n_islands: int
    n: int
    first: Whole
    second: Whole
    turns: NDArray[np.int16]
    rough: Image
    order: Whole
    weight: NDArray[np.float64]
    number: Whole
    behind: Whole

    def nodes_at(self, time: int) -> Whole:
        """Return the nodes of a frame's box, of all views, one pixel after the other."""
        found: Whole = self.nodes[time - self.around.start].ravel()
        return found

    def nodes_of(self, block: Block, scene: Scene) -> Whole:
        """Return the nodes of all pixels of some of its frames (time, angle, y, x)."""
        found = islands_by_node(scene.islands(block), block.start, self.islands)
        found[:, :, *scene.box] = self.nodes[block.of(self.around)]
        return found


def graphs_of(
    scene: Scene, steps: Iterable[Weighed], cores: list[Block], origin: Pixel | None = None
) -> Iterator[PixelGraph]:
    """Yield the graph of each span of frames, as soon as all its steps are known.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    steps : iterable of Weighed
        All its steps, see `followed_steps`, in any order.
    cores : list of Block
        The spans.
    origin : tuple of int, optional
        The pixel that is held where there is no empty field, see `PixelGraph`.
    """
    n = scene.shape[0]
    held, lines = held_island(scene), dead_lines(scene)
    waiting = {core: core.wider(1, 1, n) for core in cores}
    known: dict[int, tuple[Steps, Steps]] = {}
    for weighed in steps:
        known.update(zip(weighed.block.times, steps_by_time(weighed, scene.part), strict=True))
        weighed.by_axis.clear()  # they are large, and this waits for what the graph is used for
        weighed.followed.clear()
        ready = [c for c, around in waiting.items() if all(t in known for t in around.times)]
        for core in ready:
            around = waiting.pop(core)
            needed = {t for others in waiting.values() for t in others.times}
            own = {t: known[t] if t in needed else known.pop(t) for t in around.times}
            yield graph_of(scene, core, around, own, (held, lines), origin)


def graph_of(
    scene: Scene,
    core: Block,
    around: Block,
    steps: dict[int, tuple[Steps, Steps]],
    held: tuple[tuple[int, int, int] | None, list[DeadLines] | None],
    origin: Pixel | None,
) -> PixelGraph:
    """Return the graph of some frames, an island or a pixel held; their steps are used up.

    What is held is given with the dead lines of views, see `held_island` and `dead_lines`.
    """
    nodes = np.empty((len(around), *scene.part[1:]), dtype=np.int32)
    islands: Islands = {}
    n_islands, of_fields, behind = 1, [], []
    blocks = blocks_within(around, scene.shape)
    for block in blocks:
        seen = scene.islands(block)
        n_islands, more = number_islands(
            seen, block.start, held[0], islands, n_islands, math.prod(scene.frames.shape[2:])
        )
        of_fields += more
        if held[1] is not None:
            behind += fields_behind(scene, block, held[1], islands)
        inside = seen[:, :, *scene.box]
        nodes[block.of(around)] = islands_by_node(inside, block.start, islands)
    n, fields = n_islands, np.array(of_fields + behind, dtype=np.int32)
    for block in blocks:
        free = scene.free(block)
        last = n + int(np.count_nonzero(free))
        nodes[block.of(around)][free] = np.arange(n, last, dtype=np.int32)
        n = last
    if origin is not None and origin[0] in around.times:
        nodes[origin[0] - around.start, *origin[1:]] = 0
    plain, shared = [], []
    for t in around.times:
        here, (within, ahead) = nodes[t - around.start].ravel(), steps.pop(t)
        listed = [within.between(here, here)]
        if t + 1 < around.stop:
            listed.append(ahead.between(here, nodes[t + 1 - around.start].ravel()))
        for own in listed:
            of_islands = (own.first < n_islands) & (own.second < n_islands)
            plain.append(own.some(~of_islands))
            shared.append(put_together(own.some(of_islands)))
    # The empty field of every frame is held at that of the start.
    none, one = np.zeros(len(fields), dtype=np.int16), np.ones(len(fields), dtype=np.int32)
    firm = Steps(none.astype(np.int32), fields, none, np.full(len(fields), FIRM, np.float32))
    shared.append((firm, one.astype(np.float64), one))
    many, weight, number = zip(*shared, strict=True)
    found = all_steps([*plain, *many])
    plain.clear()  # before they are sorted: they take as much again
    return PixelGraph(
        core,
        around,
        nodes,
        islands,
        origin,
        n_islands,
        n,
        found.first,
        found.second,
        found.turns,
        found.rough,
        smoothest_first(found.rough),
        np.concatenate(weight),
        np.concatenate(number),
        np.array(behind, dtype=np.int32),
    )


def put_together(steps: Steps) -> tuple[Steps, NDArray[np.float64], Whole]:
    """Put steps between the same islands that ask for the same together.

    Returns
    -------
    steps : Steps
        One of each kind, as rough as the smoothest of them.
    weight, number : ndarray
        What they hold together, see `held_by_steps`, and how many they are.
    """
    n = int(steps.second.max(initial=0)) + 1
    lowest = int(steps.turns.min(initial=0))
    several = int(steps.turns.max(initial=0)) - lowest + 1
    # One number for each kind, as rows take far longer to tell apart.
    pair = steps.first.astype(np.int64) * n + steps.second
    kinds, which = np.unique(pair * several + (steps.turns - lowest), return_inverse=True)
    least = np.full(len(kinds), np.inf, dtype=np.float32)
    np.minimum.at(least, which, steps.rough)
    weight = np.bincount(which, weight_of_hold(steps.rough), len(kinds)).astype(np.float64)
    number = np.bincount(which, minlength=len(kinds)).astype(np.int32)
    pair, asked = np.divmod(kinds, several)
    first, second = (ends.astype(np.int32) for ends in np.divmod(pair, n))
    return Steps(first, second, (asked + lowest).astype(np.int16), least), weight, number


def held_island(scene: Scene) -> tuple[int, int, int] | None:
    """Return time, angle and number of the island of the empty field that is held.

    It is the largest of the start; if that frame has none, the largest of all; None without any.
    """
    time, angle = scene.frames.start
    found = largest_island(scene.islands(Block(time, time + 1))[0, angle])
    if found is not None:
        return time, angle, found[0]
    best, size = None, 0
    for block in blocks_of(scene.shape):
        islands = scene.islands(block)
        for i, a in np.ndindex(*islands.shape[:2]):
            found = largest_island(islands[i, a])
            if found is not None and found[1] > size:
                best, size = (block.start + i, a, found[0]), found[1]
    return best


def largest_island(numbers: Whole) -> tuple[int, int] | None:
    """Return number and pixels of the largest island of a frame, None if it has none."""
    sizes = np.bincount(numbers.ravel() + 1)[1:]
    return (int(np.argmax(sizes)), int(sizes.max())) if len(sizes) else None


def number_islands(
    islands: Whole,
    start: int,
    held: tuple[int, int, int] | None,
    known: Islands,
    count: int,
    of_frame: int,
) -> tuple[int, list[int]]:
    """Give the islands of the empty field in some frames numbers, beginning with a count.

    Parameters
    ----------
    islands : ndarray of int, shape (time, angle, y, x)
        Their numbers in each frame by itself, from 0; -1 elsewhere.
    start : int
        Time of the first frame.
    held : tuple of int or None
        Time, angle and number of the one that is held, which gets 0.
    known : dict of tuple to ndarray of int
        The numbers of each frame's islands; these are put in.
    count : int
        The first number.
    of_frame : int
        Pixels of a frame, without what is added round it.

    Returns
    -------
    count : int
        The next number.
    fields : list of int
        The largest island of every other frame, where it takes enough of it to be the field.
    """
    fields = []
    for i, a in np.ndindex(*islands.shape[:2]):
        numbers, frame = islands[i, a], (start + i, a)
        largest = largest_island(numbers)
        if largest is None:
            continue
        mine = np.arange(count, count + int(numbers.max()) + 1, dtype=np.int32)
        count += len(mine)
        if held is not None and frame == held[:2]:
            mine[held[2]] = 0
        if largest[1] >= FIELD_SHARE * of_frame and mine[largest[0]]:
            fields.append(int(mine[largest[0]]))
        known[frame] = mine
    return count, fields


def dead_lines(scene: Scene) -> list[DeadLines] | None:
    """Return the rows and columns of each view that are known in no frame; None if there are none.

    They are those of the camera, from edge to edge, and no more than a few beside each other. A
    mask of any other form may follow the rim of an object, which nothing else tells from field.
    """
    ever = np.zeros(scene.frames.shape[1:], dtype=bool)
    for block in blocks_of(scene.frames.shape):
        times = scene.frames.kept[block.start : block.stop]
        around = Block(int(times[0]), int(times[-1]) + 1)
        ever |= scene.frames.recorded.given.read(around)[1].any(axis=0)
        if ever.all():
            return None
    found = [DeadLines(thin(~known.any(axis=1)), thin(~known.any(axis=0))) for known in ever]
    return found if any(lines.rows.any() or lines.columns.any() for lines in found) else None


def thin(dead: Mask) -> Mask:
    """Return which lines are dead, but those with too many others beside them, or at the edge."""
    labels, n = scipy.ndimage.label(dead)
    sizes = np.bincount(labels, minlength=n + 1)
    inside = np.ones(n + 1, dtype=bool)
    inside[[0, labels[0], labels[-1]]] = False
    found: Mask = (inside & (sizes <= MOST_DEAD))[labels]
    return found


def fields_behind(scene: Scene, block: Block, lines: list[DeadLines], known: Islands) -> list[int]:
    """Return the nodes of islands in which the field of a frame goes on behind dead lines.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    block : Block
        Some of its kept frames.
    lines : list of DeadLines
        Those of each view.
    known : dict of tuple to ndarray of int
        The nodes of each frame's islands.
    """
    found = []
    seen = scene.islands_as_seen(block)
    for i, a in np.ndindex(*seen.shape[:2]):
        largest = largest_island(seen[i, a])
        if largest is not None and largest[1] >= FIELD_SHARE * seen[i, a].size:
            nodes = known[block.start + i, a]
            found += [int(nodes[n]) for n in behind_dead_lines(seen[i, a], lines[a], largest[0])]
    return [node for node in found if node]


def behind_dead_lines(numbers: Whole, lines: DeadLines, first: int) -> list[int]:
    """Return the islands of a frame that one of them goes on in, behind dead rows and columns.

    They face each other there over some pixels. That phase rises by just a turn all along a dead
    line is not to be expected; that an even part of an object lies there is.
    """
    joined = numbers[~lines.rows][:, ~lines.columns]
    facing: Counter[tuple[int, int]] = Counter()
    for islands, dead in ((joined, lines.rows), (joined.T, lines.columns)):
        after = np.cumsum(~dead)[dead]  # how many that are known lie before each dead one
        for k in np.unique(after[(after > 0) & (after < len(islands))]):
            pairs = np.sort([islands[k - 1], islands[k]], axis=0).T
            facing.update(map(tuple, pairs.tolist()))
    found: list[int] = []
    near = [first]
    while near:
        this = near.pop()
        for pair, count in facing.items():
            other = pair[0] + pair[1] - this
            fits = this in pair and other >= 0 and count >= LEAST_FACING
            if fits and other not in (first, *found):
                found.append(other)
                near.append(other)
    return found


def islands_by_node(islands: Whole, start: int, nodes: Islands) -> Whole:
    """Return the node of each pixel's island; 0 where it is of none.

    Parameters
    ----------
    islands, start
        See `number_islands`.
    nodes : dict of tuple to ndarray of int
        The nodes of each frame's islands.
    """
    found = np.zeros(islands.shape, dtype=np.int32)
    for i, a in np.ndindex(*islands.shape[:2]):
        if (start + i, a) in nodes:
            inside = islands[i, a] >= 0
            found[i, a][inside] = nodes[start + i, a][islands[i, a][inside]]
    return found
