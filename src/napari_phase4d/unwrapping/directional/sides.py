"""Directional L1 on one side of the empty field: the price of lying on the other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.bunches import Bunches
from napari_phase4d.unwrapping.directional.groups import PARTS, Index, weight_of
from napari_phase4d.unwrapping.directional.least_turns import LeastTurns, Limit
from napari_phase4d.unwrapping.directional.regions import Regions
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Floors, fading, noisier
from napari_phase4d.unwrapping.given import working_blocks

__all__ = ["Field", "on_one_side"]

TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]
Whole = NDArray[np.int32]
Turns = NDArray[np.signedinteger[Any]]
Counts = NDArray[np.int64]
Short = NDArray[np.int16]
Prices = NDArray[np.float64]

#: A pixel lies beyond the empty field if its phase does so by this many radians and twice its
#: noise, which is the larger the fainter its light. Each turn beyond costs as much as a step of
#: so much roughness, in radians, that is off.
BEYOND, AS_ROUGH_AS = 0.5, 2.0
#: What many steps hold may lie on the other side as well, as where the empty field sags under the
#: object. A pixel pays only beyond that, but for this share of it, in bins of so many radians.
RARE, BIN = 0.003, 0.1
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
#: Where at least this share of what would pay has less than half of its light, as round a cell
#: that is steeper than the optics let pass, nothing holds the cell at its level: all of it pays.
IN_THE_DARK = 0.5


@dataclass(frozen=True)
class Field:
    """What both methods start from.

    Parameters
    ----------
    scene : Scene
        The frames, the object held in place.
    floors : Floors
        What noise alone makes of the weights.
    regions : Regions
        Pixels that certain steps join, and the edges between them.
    """

    scene: Scene
    floors: Floors
    regions: Regions


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
    noise, bunches = field.scene.noise, field.regions.bunches
    strict = looked.limit(0.0, noise, plain, bunches)
    if is_dark(strict, strict.paid(plain, field.regions.n)):
        limit = limit_of_all(field, parts, looked.side, watch)
        after = pushed_up(field, plain, limit, watch)
        then = side_of_object(field, after, parts, watch)
        if then is not None and then.side == looked.side and then.usual() <= BEYOND:
            return after
    limit = looked.limit(looked.usual(), noise, plain, bunches)
    if limit.paid(plain, field.regions.n).sum() > IN_EARNEST * cost:
        return plain
    after = pushed_up(field, plain, limit, watch)
    size = np.where(parts == parts[field.regions.held], field.regions.size, 0)
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


def is_dark(limit: Limit, paid: Prices) -> bool:
    """Say whether most of what pays has lost its light."""
    half = PARTS * weight_of(np.float32(AS_ROUGH_AS) + fading(np.array([0.5], dtype=np.float32)))
    weights = limit.weight[paid[limit.region] > 0]
    return len(weights) > 0 and bool((weights < half).mean() >= IN_THE_DARK)


@dataclass(frozen=True)
class Rims:
    """Pixels of the smallest regions, and how much of all others lies on which side.

    Parameters
    ----------
    positive, clear : int
        Pixels that are more than a turn above the empty field; that are above or below it.
    above, below : ndarray of int
        How many pixels of larger regions lie so far above the empty field, or below it, in bins
        up to a turn; the last has all beyond.
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
        return BIN * usual_bins(other, self.rims.above.sum())

    def limit(self, usual: float, noise: float, turns: Turns, bunches: Bunches) -> Limit:
        """Return what pixels pay on the wrong side, of the bunches in which any does.

        In all others the turns are the least already.
        """
        rims, side = self.rims, self.side
        whole = least_turns(side, rims.phase, rims.amplitude, noise, usual)
        paying = bunches.of_region[rims.region[side * (whole - turns[rims.region]) > 0]]
        mine = np.isin(bunches.of_region[rims.region], paying[paying >= 0])
        return Limit(rims.region[mine], whole[mine], price(rims.amplitude[mine]), side)


def least_turns(side: int, phase: Image, amplitude: Image, noise: float, usual: float) -> Short:
    """Return the turns that pixels need, not to lie further on the other side than they may."""
    noises = noise * noisier(amplitude).astype(np.float64)
    allowed = BEYOND + np.maximum(2 * noises, usual)
    found: Short = (side * np.ceil((-allowed - side * phase.astype(np.float64)) / TURN)).astype(
        np.int16
    )
    return found


def price(amplitude: Image) -> Prices:
    """Return what a turn on the other side costs a pixel."""
    rough = np.float32(AS_ROUGH_AS) + fading(amplitude)
    return np.round(PARTS * weight_of(rough)).astype(np.float64)


def limit_of_all(field: Field, parts: Whole, side: int, watch: Watch) -> Limit:
    """Return what pixels pay if all do but those that certain steps join to the empty field."""
    regions, noise = field.regions, field.scene.noise
    pays = parts == parts[regions.held]
    pays[regions.held] = False

    def work(block: Block) -> tuple[Any, Any, Any]:
        seen = field.scene.read(block, amplitude=True)
        region, relative = regions.read(block)
        mine = seen.free & pays[region]
        own = seen.phase[mine] + TURN * relative[mine].astype(np.float32)
        bright = np.ones_like(own) if seen.amplitude is None else seen.amplitude[mine]
        turns = least_turns(side, own, bright, noise, 0.0)
        # Most pixels of a region need the same turns: together they are one.
        pairs = np.stack([region[mine], turns])
        each, of_pixel = np.unique(pairs, axis=1, return_inverse=True)
        return each[0], each[1], np.bincount(of_pixel, price(bright))

    blocks = working_blocks(field.scene.shape)
    found = in_threads(work, blocks, watch.quiet(len(blocks)))
    region, turns, weight = (np.concatenate(part) for part in zip(*found, strict=True))
    return Limit(region, turns, weight, side)


def usual_bins(other: Counts, all_: int) -> int:
    """Return how many bins hold all pixels on a side but the rare ones."""
    further = np.cumsum(other[::-1])[::-1]
    return int(np.count_nonzero(further[1:] > RARE * all_))


def rims_of(field: Field, turns: Turns, joined: NDArray[np.bool_], block: Block) -> Rims:
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
    small, large = known & is_small, unwrapped[known & ~is_small]
    above, below = (bins_of(np.maximum(side * large, 0)) for side in (1, -1))
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
    blocks = working_blocks(field.scene.shape)

    def work(block: Block) -> Rims:
        return rims_of(field, turns, joined, block)

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
