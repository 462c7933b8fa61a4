"""Cells that swim over one another: taken for one for a while, and told apart again after it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["DAUGHTER", "LEAST_PART", "Ways", "touching_pairs"]

#: Cells touch where at most so many pixels lie between them.
BETWEEN = 2
#: A cell has taken in another that is gone if they touched, or if it has grown by this share of
#: that one.
TAKEN_IN = 0.3
#: Cells lie over one another where together they cover less than this share of what they do apart.
COVERED = 0.85
#: ... and below this share what each of them holds is in doubt.
SHARED = 0.95
#: A daughter takes at most this share of its parent's area, and less where the other one begins at
#: the border of the frame.
DAUGHTER, DAUGHTER_AT_EDGE = 0.85, 0.75
#: Smaller than this share of the one beside it, a part is no cell: neither is it what is left of
#: one that another covers, nor a daughter if it is gone again at once.
LEAST_PART = 0.35
#: Frames before and after a meeting by which the way of a cell is told.
FRAMES = 5
#: Cells that do not touch for so many frames are still in the same meeting.
PAUSE = 3

#: What becomes of a track, in the order in which it is looked at.
ENDS, PARTS, STARTS = 0, 1, 2

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


def touching_pairs(labels: NDArray[np.integer]) -> set[tuple[int, int]]:
    """Return the pairs of numbers, the smaller one first, that touch in a frame (y, x)."""
    found: set[tuple[int, int]] = set()
    for axis in (0, 1):
        turned = np.moveaxis(labels, axis, 0)
        for step in range(1, BETWEEN + 1):
            one, other = turned[:-step], turned[step:]
            touch = (one != other) & (one > 0) & (other > 0)
            if touch.any():
                pairs = np.sort(np.stack([one[touch], other[touch]], axis=1), axis=1)
                found |= {(int(a), int(b)) for a, b in np.unique(pairs, axis=0)}
    return found


class Ways:
    """Tracks of the cells of a view that meet, and which of them goes on as which.

    A track ends where its cell is taken for one with another, and two begin where they part. If
    they have only touched, who was nearer goes on. If they have covered each other, they have
    swum on, each on its own way.

    Parameters
    ----------
    frames : ndarray of int
        Of every spot, rising.
    places : ndarray, shape (spots, 3)
        What tells spots apart: y, x, and a length for the size.
    areas : ndarray
        Of every spot.
    at_edge : ndarray of bool
        Whether a spot touches the border of the frame.
    track : ndarray of int
        Of every spot; it is changed.
    divisions : sequence of (int, int)
        (daughter, parent), numbers of tracks.
    touching : iterable of (int, int)
        Spots of the same frame that touch.
    reach : float
        How far a cell moves from frame to frame at most.
    """

    def __init__(
        self,
        frames: Ints,
        places: Floats,
        areas: Floats,
        at_edge: NDArray[np.bool_],
        track: Ints,
        divisions: Sequence[tuple[int, int]],
        touching: Iterable[tuple[int, int]],
        reach: float,
    ) -> None:
        self.frames, self.places, self.areas, self.at_edge = frames, places, areas, at_edge
        self.track, self.reach = track, reach
        self._beside: dict[int, list[int]] = defaultdict(list)
        for one, other in touching:
            self._beside[one].append(other)
            self._beside[other].append(one)
        self._spots: dict[int, list[int]] = defaultdict(list)
        for spot, number in enumerate(track.tolist()):
            self._spots[number].append(spot)
        self._kids: dict[int, list[int]] = defaultdict(list)
        for daughter, parent in divisions:
            self._kids[parent].append(daughter)
        self._born = {daughter for daughter, _ in divisions}
        #: Tracks that have ended in another one.
        self._hidden: dict[int, list[int]] = defaultdict(list)
        #: Tracks of parts that were cut off by mistake: no cells that others could take in.
        self._cut_off: set[int] = set()
        #: Track to the one that it goes on from.
        self._names: dict[int, int] = {}
        #: Whether a spot is several cells, or a part of what several cover.
        self.mixed = np.zeros(len(frames), dtype=bool)
        #: Frames in which two tracks touch, or one is hidden in the other.
        self._meets: dict[tuple[int, int], set[int]] = defaultdict(set)

    def untangle(self) -> list[tuple[int, int]]:
        """Join the tracks of cells that were taken for one; return the divisions that are left."""
        left = self._parted()
        self.track[:] = [self._name(number) for number in self.track.tolist()]
        for one, others in self._beside.items():
            for other in others:
                self._meet(self.track[one], self.track[other], self.frames[one])
        self._untwist()
        ends = ((self._spots[kid][0], self._spots[parent][-1]) for kid, parent in left)
        return [(int(self.track[a]), int(self.track[b])) for a, b in ends]

    def _name(self, number: int) -> int:
        return self._names.get(number, number)

    def _meet(self, one: int, other: int, frame: int) -> None:
        if one != other:
            self._meets[min(int(one), int(other)), max(int(one), int(other))].add(int(frame))

    # ---- taken for one ---------------------------------------------------------------------

    def _parted(self) -> list[tuple[int, int]]:
        """Let the parts of a cell that was several go on as these; return the other divisions."""
        events = [
            (self._end(number), ENDS + (number in self._kids), number) for number in self._spots
        ]
        events += [
            (self._start(number) - 1, STARTS, number)
            for number in self._spots
            if number not in self._born
        ]
        left: list[tuple[int, int]] = []
        for frame, kind, number in sorted(events):
            if kind == PARTS:
                left += [(kid, number) for kid in self._divided(number)]
            elif kind == STARTS and frame >= 0:
                self._come_out(number)
            elif kind == ENDS and frame < self.frames[-1]:
                self._go_in(number)
        for host, guests in self._hidden.items():  # and never told apart again
            for guest in guests[:1]:
                self._hide(host, guest, self._spots[host][-1])
                self.mixed[self._spots[host][-1]] = True
        return left

    def _go_in(self, number: int) -> None:
        """Hide a track that ends in the one that has taken it in, if there is one."""
        host = None if self._was_cut_off(number) else self._host_of(number)
        if host is not None:
            self._hidden[host] += [number, *self._hidden.pop(number, [])]

    def _was_cut_off(self, number: int) -> bool:
        """Say whether a track is no cell but a part that was there for a moment."""
        start = self._spots[number][0]
        from_nowhere = number not in self._names and number not in self._born
        short = self._end(number) - self._start(number) < PAUSE
        came_in = self.at_edge[start] or self._start(number) == int(self.frames[0])
        return number in self._cut_off or bool(from_nowhere and short and not came_in)

    def _come_out(self, number: int) -> None:
        """Let a track that begins beside another be the one that was hidden in that."""
        beside = (int(self.track[other]) for other in self._beside[self._spots[number][0]])
        host = next((each for each in beside if self._hidden[each]), None)
        if host is not None:
            guest = self._hidden[host].pop(0)
            self._names[number] = self._name(guest)
            self._hide(host, guest, self._spots[number][0])

    def _divided(self, number: int) -> list[int]:
        """Return the daughters of a track that parts, none if it was several cells before."""
        kids = self._kids[number]
        guests = self._hidden.pop(number, []) or self._late(kids)
        lasting = [kid for kid in kids if not self._is_splinter(kid, kids)]
        if guests:
            self._go_on(number, guests, kids)
        elif len(lasting) == 1:
            self._names[lasting[0]] = self._name(number)
            self._cut_off |= set(kids) - set(lasting)
        elif all(self._is_daughter(kid, number, kids) for kid in kids):
            return kids
        else:  # another has come close to it
            end = self.places[self._spots[number][-1]]
            away = [float(np.sum((self.places[self._spots[kid][0]] - end) ** 2)) for kid in kids]
            self._names[kids[int(np.argmin(away))]] = self._name(number)
        return []

    def _is_daughter(self, kid: int, parent: int, kids: list[int]) -> bool:
        """Say whether a track may be a part of its parent: neither nearly all of it, nor come in.

        What begins at the border of the frame may have come in beside a cell that is all there.
        """
        whole = self.areas[self._spots[parent][-1]]
        begins = {each: self._spots[each][0] for each in kids}
        came_in = any(self.at_edge[spot] for each, spot in begins.items() if each != kid)
        most = DAUGHTER_AT_EDGE if came_in else DAUGHTER
        return bool(self.areas[begins[kid]] <= most * whole)

    def _is_splinter(self, number: int, kids: list[int]) -> bool:
        """Say whether a track is gone again at once, and was no daughter either.

        A daughter may soon leave at the border, or not be found any more. A part that is small, or
        that another part takes in again, was cut off by mistake.
        """
        end, last = self._end(number), self._spots[number][-1]
        short = end - self._start(number) < PAUSE
        if not short or end >= int(self.frames[-1]) or number in self._kids:
            return False
        begins = {kid: self.areas[self._spots[kid][0]] for kid in kids}
        small = begins[number] < LEAST_PART * max(begins.values())
        sisters = [spot for kid in kids for spot in self._spots[kid] if kid != number]
        return bool(small and not self.at_edge[last]) or any(
            self.frames[spot] == end and self._takes_in(spot, last) for spot in sisters
        )

    def _late(self, kids: list[int]) -> list[int]:
        """Return the track of which a splinter was still seen when it parted as one of these."""
        start = min(self._start(kid) for kid in kids)
        for number in self._spots:
            if number not in kids and start <= self._end(number) < start + PAUSE:
                small = self.areas[self._spots[number]]
                if small[-1] < small.max() / 2 and self._host_of(number) in kids:
                    return [number]
        return []

    def _hide(self, host: int, guest: int, until: int) -> None:
        """Note that a track is hidden in another from where it ends to a spot."""
        end, parted = self._end(guest), int(self.frames[until])
        for frame in range(end, parted):
            self._meet(self._name(host), self._name(guest), frame)
        held = np.array(self._spots[host])
        self.mixed[held[(self.frames[held] > end) & (self.frames[held] < parted)]] = True

    def _start(self, number: int) -> int:
        return int(self.frames[self._spots[number][0]])

    def _end(self, number: int) -> int:
        return int(self.frames[self._spots[number][-1]])

    def _host_of(self, number: int) -> int | None:
        """Return the track that has taken in one that ends, None if none has."""
        spot = self._spots[number][-1]
        if self.at_edge[spot]:  # it has left
            return None
        frame, best, host = self.frames[spot], self.reach, None
        for other in np.flatnonzero(self.frames == frame).tolist():
            if other == spot:
                continue
            then = self._next(other)
            close = other in self._beside[spot]
            way = float(np.hypot(*(self.places[then, :2] - self.places[spot, :2])))
            if (close or self._takes_in(other, spot)) and way < best:
                best, host = way, int(self.track[other])
        return host

    def _next(self, spot: int) -> int:
        """Return the spot that follows one on its track, itself where it is the last."""
        among = self._spots[int(self.track[spot])]
        return among[min(among.index(spot) + 1, len(among) - 1)]

    def _takes_in(self, other: int, spot: int) -> bool:
        """Say whether a cell grows by what another one had."""
        grown = self.areas[self._next(other)] - self.areas[other]
        return bool(grown >= TAKEN_IN * self.areas[spot])

    def _go_on(self, host: int, guests: list[int], kids: list[int]) -> None:
        """Name the parts of a track after it, and those that were hidden in it, the nearest."""
        start = min(self._end(number) for number in guests)
        before = [s for s in self._spots[host] if self.frames[s] <= start] or self._spots[host][:1]
        ends = {host: before[-1]} | {number: self._spots[number][-1] for number in guests}
        begins = {kid: self._spots[kid][0] for kid in kids}
        ways = sorted(
            (float(np.sum((self.places[begins[kid]] - self.places[end]) ** 2)), number, kid)
            for number, end in ends.items()
            for kid in kids
        )
        waiting, free = list(ends), list(kids)
        for _, number, kid in ways:
            if number in waiting and kid in free:
                self._names[kid] = self._name(number)
                waiting.remove(number)
                free.remove(kid)
        for number in guests:
            self._hide(host, number, min(begins.values()))
        if waiting:  # three were one, and two of them still are
            largest = max(kids, key=lambda kid: self.areas[begins[kid]])
            self._hidden[largest] += [number for number in waiting if number != host]

    # ---- on their own ways -----------------------------------------------------------------

    def _untwist(self) -> None:
        """Look at all meetings, the earliest first, and exchange tracks that have swum on."""
        waiting = self._in_order()
        while waiting:
            pair, met = waiting.pop()
            self._meets[pair] -= set(range(met[0], met[1] + 1))
            since = self._crossed_at(pair, met)
            if since is not None:
                self._exchange(pair, since)
                waiting = self._in_order()

    def _in_order(self) -> list[tuple[tuple[int, int], list[int]]]:
        """Return the meetings that were not looked at, the earliest last."""
        return sorted(self._meetings(), key=lambda each: (each[1][0], each[0]), reverse=True)

    def _exchange(self, pair: tuple[int, int], since: int) -> None:
        """Let two tracks be each other from a frame on, also where they meet others later."""
        later = self.frames >= since
        one, other = (later & (self.track == number) for number in pair)
        self.track[one], self.track[other] = pair[1], pair[0]
        turned = dict(zip(pair, reversed(pair), strict=True))
        moved: list[tuple[int, int, int]] = []
        for met, frames in self._meets.items():
            if len(turned.keys() & set(met)) == 1:
                gone = {frame for frame in frames if frame >= since}
                frames.difference_update(gone)
                moved += [(*met, frame) for frame in gone]
        for a, b, frame in moved:
            self._meet(turned.get(a, a), turned.get(b, b), frame)

    def _meetings(self) -> Iterable[tuple[tuple[int, int], list[int]]]:
        """Yield pairs of tracks, and the frames from which to which they meet."""
        for pair, frames in self._meets.items():
            if not frames:
                continue
            ordered = np.array(sorted(frames))
            for run in np.split(ordered, np.flatnonzero(np.diff(ordered) > PAUSE) + 1):
                yield pair, [int(run[0]), int(run[-1])]

    def _crossed_at(self, pair: tuple[int, int], met: list[int]) -> int | None:
        """Return the frame in which two tracks cover each other most, if they have swum on."""
        spots = [np.flatnonzero(self.track == number) for number in pair]
        before = [s[self.frames[s] < met[0]][-FRAMES:] for s in spots]
        after = [s[self.frames[s] > met[1]][:FRAMES] for s in spots]
        sides = [side for side in (before, after) if all(len(s) for s in side)]
        if not sides:
            return None
        apart = float(np.mean([sum(self.areas[s].mean() for s in side) for side in sides]))
        covered: dict[int, float] = defaultdict(float)
        for of_one in spots:
            for spot in of_one[(self.frames[of_one] >= met[0]) & (self.frames[of_one] <= met[1])]:
                covered[int(self.frames[spot])] += float(self.areas[spot])
        over = [frame for frame, area in covered.items() if area <= SHARED * apart]
        for of_one in spots:
            self.mixed[of_one[np.isin(self.frames[of_one], over)]] = True
        if len(sides) < 2 or not covered or min(covered.values()) > COVERED * apart:
            return None
        middle = min(covered, key=lambda frame: covered[frame])
        length = max(met[1] - met[0], FRAMES)
        come, gone = ([self._way(s, middle, length) for s in side] for side in (before, after))
        kept, crossed = (
            sum(float(np.sum((come[i] - gone[j]) ** 2)) for i, j in enumerate(order))
            for order in ((0, 1), (1, 0))
        )
        return middle if crossed < kept else None

    def _way(self, spots: Ints, frame: int, length: int) -> Floats:
        """Return where a cell would be in a frame, its size, and how far it swims meanwhile."""
        times, places = self.frames[spots] - frame, self.places[spots]
        if len(spots) < 2:
            return np.concatenate([places[0], np.zeros(2)])
        speed, start = np.polyfit(times, places[:, :2], 1)
        return np.concatenate([start, [np.median(places[:, 2])], speed * length])
