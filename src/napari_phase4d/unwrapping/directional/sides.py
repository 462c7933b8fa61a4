"""Directional L1 on one side of the empty field: the price of lying on the other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.bunches import Bunches
from napari_phase4d.unwrapping.directional.groups import PARTS, Index, weight_of
from napari_phase4d.unwrapping.directional.least_turns import LeastTurns, Limit
from napari_phase4d.unwrapping.directional.regions import Field
from napari_phase4d.unwrapping.directional.steps import fading, noisier
from napari_phase4d.unwrapping.given import working_blocks

__all__ = ["on_one_side"]

TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]
Whole = NDArray[np.int32]
Turns = NDArray[np.signedinteger[Any]]
Counts = NDArray[np.int64]
Short = NDArray[np.int16]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.float64]

#: A pixel lies beyond the empty field if its phase does so by this many radians and twice its
#: noise, which is the larger the fainter its light. Each turn beyond costs as much as a step of
#: so much roughness, in radians, that is off.
BEYOND, AS_ROUGH_AS = 0.5, 2.0
#: What many steps hold may lie on the other side as well, as where the empty field sags under the
#: object. A pixel pays only beyond that, but for this share of it, in bins of so many radians.
RARE, BIN = 0.003, 0.1
#: It sags so many times as far at most as what smooth steps join to the empty field shows: parts
#: of a thick object that slipped lie on the other side too, and would let all others lie there.
FURTHER = 1.5
#: Only regions of so few pixels pay, as many as a cube of three: the price is for rims, not for
#: what many steps hold.
RIM = 27
#: Largest share of the object's pixels that the price may move.
MOST = 0.5
#: An object lies on one side of the empty field if this share of what is a turn off does.
NEARLY_ALL = 0.9
#: A rim that slipped leaves steps that contradict each other. Where all of them together cost so
#: many times less than lying on the wrong side would, no rim has slipped, and the object does lie
#: on both sides: a cell in a channel with thicker walls, say, all of it too steep to be held.
IN_EARNEST = 12
#: Where at least this share of what a rim has on the other side has less than half of the usual
#: light, the pupil has cut it off: nothing holds the object at its level, and all of it pays.
IN_THE_DARK, HALF_LIGHT = 0.5, 0.5
#: An object comes back if at least this share of it moves, ...
MOVED = 0.5
#: ... this share moves though it lay on the right side already by so many radians, in good light,
PARTLY, CLEARLY = 0.1, np.float32(0.5 * np.pi)
#: ... and at most this share is left as far on the other side.
LEFT = 0.05
#: Neighbours of a pixel (time, angle, y, x) in its own frame.
WITHIN_FRAME = np.zeros((3, 3, 3, 3), dtype=bool)
WITHIN_FRAME[1, 1] = [[0, 1, 0], [1, 1, 1], [0, 1, 0]]


def on_one_side(field: Field, plain: Turns, parts: Whole, cost: int, watch: Watch) -> Turns:
    """Return the turns of every region, after lying on the wrong side has had its price.

    Parameters
    ----------
    field, plain, parts
        What was started from; turns and part of every region, as the steps alone have them.
    cost : int
        Cost of these turns, see `LeastTurns.cost`.
    watch : Watch
        Stops the work.
    """
    looked = side_of_object(field, plain, parts, watch)
    if looked is None:
        return plain
    side, noise = looked.side, field.scene.noise
    limit = looked.limit(noise, plain, field.regions.bunches)
    dark = looked.is_dark(noise, plain)
    del looked  # all pixels of rims
    after = with_rims(field, plain, parts, cost, limit, watch)
    if dark:
        whole = with_objects(field, plain, parts, side, watch)
        back = objects_back(field, plain, whole, parts, side, watch)
        after = np.where(back, whole, after)
    return after


def with_rims(
    field: Field, plain: Turns, parts: Whole, cost: int, limit: Limit, watch: Watch
) -> Turns:
    """Return the turns, after pixels of rims have paid; those that there were if none slipped."""
    regions = field.regions
    if limit.paid(plain, regions.n).sum() > IN_EARNEST * cost:
        return plain
    after = pushed_up(field, plain, limit, watch)
    size = np.where(parts == parts[regions.held], regions.size, 0)
    # If most of it moves, the side was mistaken.
    return plain if size[after != plain].sum() > MOST * size.sum() else after


def pushed_up(field: Field, plain: Turns, limit: Limit, watch: Watch) -> Turns:
    """Return the turns that are the least where some pixels have a price."""
    bunches = field.regions.bunches
    of_pixel = bunches.of_region[limit.region]
    order = np.argsort(of_pixel, kind="stable")
    numbers, starts = np.unique(of_pixel[order], return_index=True)
    cuts = [slice(*ends) for ends in pairwise([*starts, len(order)])]

    def least(of_bunch: tuple[int, slice]) -> tuple[Index, Turns]:
        number, cut = of_bunch
        bunch = bunches.read(number)
        solver = LeastTurns(bunch, watch.check)
        turns = plain[bunch.regions].astype(np.int64)
        return bunch.regions, solver.descend(turns, limit.some(order[cut]).of(bunch))

    after = plain.copy()
    work = list(zip(numbers.tolist(), cuts, strict=True))
    for own, turns in in_threads(least, work, watch.quiet(len(work))):
        after[own] = turns
    return after


@dataclass(frozen=True)
class Rims:
    """Pixels of the smallest regions, and how much of all others lies on which side.

    Parameters
    ----------
    positive, clear : int
        Pixels that are more than a turn above the empty field; that are above or below it.
    above, below : ndarray of int, shape (2, bins)
        How many pixels lie so far above the empty field, or below it, in bins up to a turn; the
        last has all beyond. Of all larger regions, and of those of the empty field.
    region : ndarray of int
        Region of each pixel of small regions.
    phase : ndarray of float
        Its phase in radians, where its region has no turns.
    amplitude : ndarray of float
        Its amplitude as a share of its view's median; 1 where amplitude is not known.
    """

    positive: int
    clear: int
    above: Counts
    below: Counts
    region: Index
    phase: Image
    amplitude: Image


@dataclass(frozen=True)
class Looked:
    """On which side of the empty field an object lies, and its rims.

    Parameters
    ----------
    side : int
        1 if it lies above, -1 if it lies below.
    rims : Rims
        Pixels that may lie on the other side.
    """

    side: int
    rims: Rims

    def usual(self) -> float:
        """Return by how many radians what many steps hold lies on the other side."""
        other = self.rims.below if self.side > 0 else self.rims.above
        rare = RARE * int(other[0].sum())  # few pixels show nothing, of the field either
        whole, of_field = (bins_but_rare(bins, rare) for bins in other)
        return BIN * min(whole, FURTHER * of_field)

    def is_dark(self, noise: float, turns: Turns) -> bool:
        """Say whether most pixels that lie on the other side have lost their light.

        What is usual there does not count: an object that slipped as a whole makes it so.
        """
        rims, side = self.rims, self.side
        faint = rims.amplitude < HALF_LIGHT
        if not faint.any():
            return False
        needed = turns_needed(side, rims.phase, rims.amplitude, noise, 0.0)
        pays = side * (needed - turns[rims.region]) > 0
        return bool(pays.any() and faint[pays].mean() >= IN_THE_DARK)

    def limit(self, noise: float, turns: Turns, bunches: Bunches) -> Limit:
        """Return what pixels pay on the wrong side, of the bunches in which any does.

        In all others the turns are the least already.
        """
        rims, side = self.rims, self.side
        needed = turns_needed(side, rims.phase, rims.amplitude, noise, self.usual())
        mine = in_paying_bunches(rims.region, side * (needed - turns[rims.region]) > 0, bunches)
        return Limit(rims.region[mine], needed[mine], price(rims.amplitude[mine]), side)


def in_paying_bunches(region: Index, pays: Mask, bunches: Bunches) -> Mask:
    """Return which pixels are in a bunch in which any pays."""
    paying = bunches.of_region[region[pays]]
    found: Mask = np.isin(bunches.of_region[region], paying[paying >= 0])
    return found


def turns_needed(side: int, phase: Image, amplitude: Image, noise: float, usual: float) -> Short:
    """Return the turns that pixels need, not to lie further on the other side than they may."""
    noises = noise * noisier(amplitude).astype(np.float64)
    allowed = BEYOND + np.maximum(2 * noises, usual)
    steps = np.ceil((-allowed - side * phase.astype(np.float64)) / (2 * np.pi))
    # A region has few turns.
    return (side * steps).astype(np.int16)


def price(amplitude: Image) -> Numbers:
    """Return what a turn on the other side costs a pixel."""
    rough = np.float32(AS_ROUGH_AS) + fading(amplitude)
    return np.round(PARTS * weight_of(rough)).astype(np.float64)


def bins_but_rare(other: Counts, rare: float) -> int:
    """Return how many bins hold all pixels on a side but the rare ones."""
    further = np.cumsum(other[::-1])[::-1]
    return int(np.count_nonzero(further[1:] > rare))


def rims_of(field: Field, turns: Turns, joined: Mask, of_field: Mask, block: Block) -> Rims:
    """Look at a block for `side_of_object`."""
    regions = field.regions
    seen = field.scene.read(block, amplitude=True)
    free = seen.free
    region, relative = (part[free] for part in regions.read(block))
    phase = seen.phase[free]
    unwrapped = phase + TURN * (turns[region] + relative).astype(np.float32)
    known = joined[region]
    clear = known & (np.abs(unwrapped) > TURN)
    is_small = regions.size[region] <= RIM
    small = known & is_small
    large = [unwrapped[some] for some in (known & ~is_small, known & of_field[region])]
    above, below = (
        np.stack([bins_of(np.maximum(side * part, 0)) for part in large]) for side in (1, -1)
    )
    own = phase[small] + TURN * relative[small].astype(np.float32)
    bright = np.ones_like(own) if seen.amplitude is None else seen.amplitude[free][small]
    positive = int((unwrapped[clear] > 0).sum())
    return Rims(positive, int(clear.sum()), above, below, region[small], own, bright)


def bins_of(beyond: Image) -> Counts:
    """Count phase by how far it lies on a side, in bins up to a turn; the first has the rest."""
    last = int(TURN / BIN)
    numbers = np.minimum(beyond / np.float32(BIN), last).astype(np.intp)
    return np.bincount(numbers, minlength=last + 1).astype(np.int64)


def side_of_object(field: Field, turns: Turns, parts: Whole, watch: Watch) -> Looked | None:
    """Return on which side of the empty field nearly all of an object lies; None if on both.

    Nearly all cells are denser than what they lie in, everywhere. At a rim that is steeper than
    half a turn a pixel, the steps alone can't tell a phase of 5 rad from one of 5 - 2 pi.
    """
    joined = parts == parts[field.regions.held]
    of_field = np.isin(np.arange(field.regions.n), field.regions.fields)
    blocks = working_blocks(field.scene.shape)

    def work(block: Block) -> Rims:
        return rims_of(field, turns, joined, of_field, block)

    looks = list(in_threads(work, blocks, watch.quiet(len(blocks))))
    clear = sum(rims.clear for rims in looks)
    share = sum(rims.positive for rims in looks) / clear if clear else 0.5
    if 1 - NEARLY_ALL < share < NEARLY_ALL:
        return None
    above, below = (
        np.stack([getattr(rims, name) for rims in looks]).sum(axis=0)
        for name in ("above", "below")
    )
    region, phase, amplitude = (
        np.concatenate([getattr(rims, name) for rims in looks])
        for name in ("region", "phase", "amplitude")
    )
    rims = Rims(0, clear, above, below, region, phase, amplitude)
    return Looked(1 if share > 0.5 else -1, rims)


# ---- whole objects, where their rims are dark ------------------------------------------------


def with_objects(field: Field, plain: Turns, parts: Whole, side: int, watch: Watch) -> Turns:
    """Return the turns, after all pixels of objects have paid for lying on the other side.

    What the pupil cut off leaves a dark rim, and nothing holds the object that it encloses at its
    level. The steps of such a rim cost next to nothing, so that they can't say that nothing has
    slipped (`IN_EARNEST`); and most of what is in view may have (`MOST`).
    """
    regions, noise = field.regions, field.scene.noise
    joined = joined_to_field(field, parts)

    def work(block: Block) -> tuple[Counts, Counts, Numbers]:
        _, region, phase, bright = pixels_of_objects(field, joined, block)
        needed = turns_needed(side, phase, bright, noise, 0.0)
        # Most pixels of a region need the same turns: together they are one.
        keys = (region.astype(np.int64) << 16) + (needed.astype(np.int64) + 2**15)
        each, of_pixel = np.unique(keys, return_inverse=True)
        weight = np.bincount(of_pixel, price(bright)).astype(np.float64)
        return each >> 16, (each & 0xFFFF) - 2**15, weight

    blocks = working_blocks(field.scene.shape)
    found = list(in_threads(work, blocks, watch.quiet(len(blocks))))
    region, turns, weight = (np.concatenate(part) for part in zip(*found, strict=True))
    mine = in_paying_bunches(region, side * (turns - plain[region]) > 0, regions.bunches)
    return pushed_up(field, plain, Limit(region[mine], turns[mine], weight[mine], side), watch)


def joined_to_field(field: Field, parts: Whole) -> Mask:
    """Return which regions hang together with the one that is held, but for that one."""
    joined: Mask = parts == parts[field.regions.held]
    joined[field.regions.held] = False
    return joined


def pixels_of_objects(
    field: Field, joined: Mask, block: Block
) -> tuple[Mask, Index, Image, Image]:
    """Return where objects are in a block; region, phase and amplitude of each of their pixels.

    The phase is that where its region has no turns; the amplitude is 1 where it is not known.
    """
    seen = field.scene.read(block, amplitude=True)
    region, relative = field.regions.read(block)
    mine = seen.free & joined[region]
    phase = seen.phase[mine] + TURN * relative[mine].astype(np.float32)
    bright = np.ones_like(phase) if seen.amplitude is None else seen.amplitude[mine]
    return mine, region[mine], phase, bright


def objects_back(
    field: Field, plain: Turns, after: Turns, parts: Whole, side: int, watch: Watch
) -> Mask:
    """Return the regions of objects that slipped as a whole and came back.

    An object is what hangs together in a frame, and by its regions from frame to frame.

    Parameters
    ----------
    field, plain, parts, side
        See `with_objects`.
    after : ndarray of int
        Turns of every region, after all pixels have paid.
    """
    regions, noise = field.regions, field.scene.noise
    joined = joined_to_field(field, parts)

    def look(block: Block) -> tuple[Counts, Index, Counts]:
        """Return pairs of regions of one object, and what is counted of each region."""
        mine, region, phase, bright = pixels_of_objects(field, joined, block)
        labels, _ = scipy.ndimage.label(mine, WITHIN_FRAME)
        keys = np.unique(labels[mine].astype(np.int64) * regions.n + region)
        of_object, member = np.divmod(keys, regions.n)
        same = of_object[1:] == of_object[:-1]
        pairs = np.stack([member[:-1][same], member[1:][same]])
        each, of_pixel = np.unique(region, return_inverse=True)
        before, then = (side * (phase + TURN * turns[region]) for turns in (plain, after))
        faint, moved = bright < HALF_LIGHT, then > before + CLEARLY
        needed = turns_needed(side, phase, bright, noise, 0.0)
        pays = (regions.size[region] <= RIM) & (side * (needed - plain[region]) > 0)
        asked = (
            np.ones_like(moved), moved, moved & ~faint & (before > CLEARLY), then < -CLEARLY,
            pays, pays & faint,
        )  # fmt: skip
        counts = [np.bincount(of_pixel[some], minlength=len(each)) for some in asked]
        return pairs, each, np.stack(counts)

    blocks = working_blocks(field.scene.shape)
    counts = np.zeros((6, regions.n), dtype=np.int64)
    links = []
    for pairs, region, own in in_threads(look, blocks, watch.quiet(len(blocks))):
        counts[:, region] += own
        links.append(pairs)
    first, second = np.concatenate(links, axis=1)
    shape = regions.n, regions.n
    graph = scipy.sparse.coo_array((np.ones(len(first), dtype=bool), (first, second)), shape)
    count, of_region = scipy.sparse.csgraph.connected_components(graph, directed=False)
    sums = [np.bincount(of_region, own, count).astype(np.int64) for own in counts]
    found: Mask = came_back(*sums)[of_region]
    return found


def came_back(
    size: Counts, moved: Counts, right: Counts, left: Counts, pays: Counts, dark: Counts
) -> Mask:
    """Say of objects whether they slipped as a whole and came back.

    A wrong turn leaves the thick part of an object on the right side and takes the rest to the
    other. So one that lay on the other side with all of it, as a bubble does, has not slipped;
    nor has one of which only a part moves.

    Parameters
    ----------
    size, moved, right, left : ndarray of int
        Pixels of each object; those that moved; those that did though they lay clearly on the
        right side, in good light; those that are on the other side still.
    pays, dark : ndarray of int
        Pixels of its rim on the other side; how many of these have lost their light.
    """
    found: Mask = (pays > 0) & (dark >= IN_THE_DARK * pays) & (moved >= MOVED * size)
    return found & (right >= PARTLY * size) & (left <= LEFT * size)
