"""Frames that fit neither the one before nor the one after, while these two fit each other.

As after a lost packet, which leaves half a frame shifted, or a blow to the stage. What changes on
the way there and back is torn, and as both say the same of the object, with the opposite sign, all
other frames would follow them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, inlined
from napari_phase4d.stack import Block
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.registration import Frames, Seen, Shifts
from napari_phase4d.unwrapping.frames import moved
from napari_phase4d.unwrapping.given import working_blocks

__all__ = ["outlying_frames", "outlying_shares"]

#: Two phases are the same if they differ by less than the first, and others if by more than the
#: second, in radians; both are larger by so many times the noise.
SAME, OTHER, NOISES = 0.5, 1.5, 1.5
#: A frame is an outlier if this share of the object is one in it and had been steady before, or is
#: after; and this many times as much as seems to be one in nearly all others: what beats, or moves
#: far, does so in many of them.
SHARE, TIMES, NEARLY_ALL = 0.03, 4.0, 0.9
#: With fewer frames nothing tells an outlier from what beats.
FEWEST = 6

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Shares = NDArray[np.float64]


def outlying_frames(frames: Frames, shifts: Shifts, watch: Watch) -> Mask:
    """Mark those of the kept frames that are outliers, in all views together.

    Parameters
    ----------
    frames : Frames
        Level with their empty field.
    shifts : ndarray of int, shape (time, angle, 2)
        What keeps the object in place.
    watch : Watch
        Stops the work.
    """
    n = frames.shape[0]
    found = np.zeros(n, dtype=bool)
    if n < FEWEST:
        return found
    blocks = working_blocks(frames.shape)

    def work(block: Block) -> Shares:
        wider = block.wider(2, 2, n)
        return outlying_shares(
            frames.read(wider), shifts[wider.start : wider.stop], frames.background.noise
        )[block.of(wider)]

    shares = np.concatenate(list(in_threads(work, blocks, watch.quiet(len(blocks)))))
    apart, steady = shares.T
    usual = usual_of_others(apart)
    more = outliers_among(steady, usual)
    while (more & ~found).any():
        found |= more
        # A damaged frame is no witness that another one is damaged: the next one beyond it is.
        beside = np.append(found[2:], [False] * 2) | np.append([False] * 2, found[:-2])
        for time in np.flatnonzero((apart > SHARE) & beside & ~found).tolist():
            watch.check()
            five = with_witnesses(time, found)
            block = Block(five[0], five[-1] + 1)
            seen, own = frames.read(block), [k - five[0] for k in five]
            some = Seen(seen.phase[own], seen.empty[own], seen.usable[own], None)
            share = outlying_shares(some, shifts[five], frames.background.noise)
            steady[time] = share[five.index(time), 1]
        more = outliers_among(steady, usual)
    return found


def usual_of_others(apart: Shares) -> Shares:
    """Return below which share nearly all frames but this one, the first and the last lie."""
    ordered = np.sort(apart[1:-1])
    last = int(np.ceil(NEARLY_ALL * (len(ordered) - 2)))
    # Where the frame itself is among those below, there is one more of the others.
    usual: Shares = np.where(apart > ordered[last], ordered[last], ordered[last + 1])
    return usual


def outliers_among(steady: Shares, usual: Shares) -> Mask:
    """Return which frames are outliers, by shares of their objects and what is usual in others."""
    return (steady > SHARE) & (steady > TIMES * usual)


def with_witnesses(time: int, found: Mask) -> list[int]:
    """Return a frame, its neighbours, and the nearest beyond these that are no known outliers."""
    before = [k for k in range(time - 1) if not found[k]][-1:]
    after = [k for k in range(time + 2, len(found)) if not found[k]][:1]
    return [*before, time - 1, time, time + 1, *after]


def outlying_shares(seen: Seen, shifts: Shifts, noise: float) -> Shares:
    """Return which shares of the object are outliers in each frame, shape (time, 2).

    The first is that which differs from both neighbours where these agree; the second that of it
    which had been as steady before, or is after. Frames are compared as they are and with the
    object held in place, and the least of both ways counts; 0 for the first and last, and where no
    empty field tells what frames are level with. Two frames on either side of each are needed,
    where there are as many.
    """
    same, other = np.float32(SAME + NOISES * noise), np.float32(OTHER + NOISES * noise)
    ways = [seen]
    if (shifts != shifts[:1]).any():
        empty, usable = (moved(part, shifts) for part in (seen.empty, seen.usable))
        ways.append(Seen(moved(seen.phase, shifts), empty, usable, None))
    found = np.zeros((len(seen.phase), 2))
    shows = [way.free for way in ways]
    for time in range(1, len(found) - 1):
        three = slice(time - 1, time + 2)
        if not seen.empty[three].any():
            continue
        shares = []
        for way, free in zip(ways, shows, strict=True):
            object_ = np.asarray(free[three].any(axis=0) & way.usable[three].all(axis=0))
            count = int(np.count_nonzero(object_))
            five = tuple(way.phase[k] for k in around(time, len(found)))  # views, no copies
            counts = count_outlying(five, object_, same, other)
            shares.append(np.array(counts) / max(count, 1))
        found[time] = np.min(shares, axis=0)
    return found


def around(time: int, n: int) -> list[int]:
    """Return the numbers of a frame and the two on either side of it.

    In the place of what is beyond the ends the frame itself stands: it agrees with no neighbour
    where it is an outlier.
    """
    return [time + step if 0 <= time + step < n else time for step in (-2, -1, 0, 1, 2)]


@compiled
def count_outlying(
    five: tuple[Image, ...], object_: Mask, same: np.float32, other: np.float32
) -> tuple[float, float]:
    """Count the pixels in which both neighbours of the middle of five frames agree, but not that.

    What changes by half a turn a frame looks so too, as two steps of it are a turn. But that has
    changed nearly as much before and after. So those pixels are counted as well in which one of
    the neighbours agrees with the frame beyond it.

    Less what the middle frame has more of the object than its neighbours: what comes for one
    frame only, as a cell in a fast flow, is no reason to doubt it. A torn frame has as much.
    """
    outlying, steady, more = 0, 0, 0.0
    earlier, before, now, after, later = five
    for view in range(object_.shape[0]):
        for y in range(object_.shape[1]):
            for x in range(object_.shape[2]):
                if not object_[view, y, x]:
                    continue
                first, here, last = before[view, y, x], now[view, y, x], after[view, y, x]
                # Phase is level with the empty field, so that what is else is of the object.
                more += off_turns(here) > other
                more -= 0.5 * (off_turns(first) > other)
                more -= 0.5 * (off_turns(last) > other)
                if off_turns(last - first) < same:
                    apart = off_turns(here - first) > other and off_turns(here - last) > other
                    was_steady = off_turns(first - earlier[view, y, x]) < same
                    stays_so = off_turns(last - later[view, y, x]) < same
                    outlying += bool(apart)
                    steady += bool(apart and (was_steady or stays_so))
    more = max(more, 0.0)
    return max(outlying - more, 0.0), max(steady - more, 0.0)


@inlined
def off_turns(phase: np.float32) -> np.float32:
    """Return how far phase is from whole turns, in radians."""
    turn = np.float32(2 * np.pi)
    return abs(phase - turn * np.rint(phase / turn))
