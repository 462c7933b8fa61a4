"""Which cells of following frames are one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from importlib.util import find_spec
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_crossings import DAUGHTER, Ways, touching_pairs
from napari_phase4d.later import pd, xr
from napari_phase4d.task import Watch
from napari_phase4d.words import check_positive

__all__ = ["GAP", "check_follower", "spots_of", "tracks_of"]

#: Cells are looked for within so many of their diameters from frame to frame, also after as many
#: frames without them as here.
REACH, GAP = 1.0, 1
#: What closes gaps looks so many times as far; where no reach is given, from frame to frame too.
FURTHER = 1.5
#: To begin or end is dearer than any link that is allowed, by this factor.
COSTLIER = 1.05

Mask = NDArray[np.bool_]


def spots_of(
    labels: xr.DataArray, sides: tuple[float, float], watch: Watch
) -> tuple[pd.DataFrame, list[tuple[int, int]]]:
    """Return place (um) and size of every cell of a view (time, y, x), and rows that touch."""
    rows: list[tuple[float, ...]] = []
    touching: list[tuple[int, int]] = []
    for time in range(labels.sizes["time"]):
        watch.check()
        frame = np.asarray(labels.data[time]).astype(np.int64)
        sizes = np.bincount(frame.ravel())
        numbers = np.flatnonzero(sizes[1:]) + 1
        if not len(numbers):
            continue
        places = np.nonzero(frame)
        owners = frame[places]
        centres = [np.bincount(owners, part)[numbers] / sizes[numbers] for part in places]
        row = dict(zip(numbers.tolist(), range(len(rows), len(rows) + len(numbers)), strict=True))
        touching += [(row[a], row[b]) for a, b in touching_pairs(frame)]
        edge = set(np.concatenate([frame[0], frame[-1], frame[:, 0], frame[:, -1]]).tolist())
        for number, y, x in zip(numbers.tolist(), *centres, strict=True):
            area = sizes[number] * sides[0] * sides[1]
            rows.append((time, number, y * sides[0], x * sides[1], area, number in edge))
    found = pd.DataFrame(rows, columns=["frame", "label", "y", "x", "area", "at edge"])
    return found.astype({"frame": int, "label": int, "at edge": bool}), touching


def check_follower() -> None:
    """Raise ImportError if the package that follows cells is missing: before long work."""
    if find_spec("laptrack") is None:
        msg = 'following cells needs one more package; run: pip install "napari-phase4d[cells]"'
        raise ImportError(msg)


def tracks_of(
    spots: pd.DataFrame,
    touching: list[tuple[int, int]],
    reach_um: float | None,
    gap: int,
    known: Mask,
) -> pd.DataFrame:
    """Add to the cells of a view their "track" and its "parent", -1 where there is none."""
    if spots.empty:
        none = pd.Series(dtype=int)
        return spots.assign(track=none, parent=none, mixed=none.astype(bool))
    check_follower()
    from laptrack import LapTrack

    diameter = 2 * math.sqrt(float(spots["area"].median()) / math.pi)
    reach = REACH * diameter if reach_um is None else check_positive("reach_um", reach_um)

    # A change of the area counts as a way, so that a small cell is not taken for a large one.
    spots = spots.assign(size=0.5 * diameter * np.log(spots["area"]))
    tracker = LapTrack(
        cutoff=reach**2,
        gap_closing_cutoff=(FURTHER * reach) ** 2,
        gap_closing_max_frame_count=gap + 1 if gap else 0,
        splitting_cutoff=diameter**2,
        # Else what a new cell costs would hang on what the others cost.
        track_start_cost=COSTLIER * reach**2, track_end_cost=COSTLIER * reach**2,
        segment_start_cost=COSTLIER * (FURTHER * reach) ** 2,
        segment_end_cost=COSTLIER * (FURTHER * reach) ** 2,
        no_splitting_cost=COSTLIER * diameter**2,
    )  # fmt: skip
    frames, places = spots["frame"].to_numpy(), spots[["y", "x", "size"]].to_numpy()
    known = known.copy()
    known[frames] = True  # labels of another program may lie where no phase is known
    seen, frames = frames, clock_of(known, gap)[frames]
    most = FURTHER * reach if reach_um is None else reach
    links = near_links(links_of(tracker, frames, places), frames, places, most)
    links = sure_links(links, seen, frames, places, reach)
    track, divisions = tracks_by_links(len(spots), links)
    areas, at_edge = spots["area"].to_numpy(), spots["at edge"].to_numpy()
    ways = Ways(frames, places, areas, at_edge, track, divisions, touching, reach)
    divisions = ways.untangle()
    found = spots.assign(track=track, mixed=ways.mixed)
    ends = found.groupby("track")["area"].agg(["first", "last"])
    parent = dict.fromkeys(track.tolist(), -1)
    for child, mother in divisions:
        if child != mother and ends["first"][child] <= DAUGHTER * ends["last"][mother]:
            parent[child] = mother
    return found.assign(parent=[parent[t] for t in track.tolist()])


def links_of(
    tracker: Any, frames: NDArray[np.int64], places: NDArray[np.float64]
) -> list[tuple[int, int]]:
    """Return which spots, by rising frame, follow each other by a tracker of laptrack."""
    starts = np.searchsorted(frames, np.arange(frames[0], frames[-1] + 2)).tolist()
    tree = tracker.predict([places[a:b] for a, b in pairwise(starts)])
    return [(starts[a] + i, starts[b] + j) for (a, i), (b, j) in tree.edges]


def clock_of(known: Mask, gap: int) -> NDArray[np.int64]:
    """Return the number of each frame by which cells are followed.

    Frames of which nothing is known don't count where there are more than gaps are closed over.

    Parameters
    ----------
    known : ndarray of bool, shape (time,)
        The frames of which anything is known.
    gap : int
        For how many frames a cell may not be found.
    """
    clock = np.arange(len(known))
    for earlier, later in pairwise(np.flatnonzero(known).tolist()):
        if later - earlier - 1 > gap:
            clock[later:] -= later - earlier - 1
    return clock


def near_links(
    links: list[tuple[int, int]],
    clock: NDArray[np.int64],
    places: NDArray[np.float64],
    most: float,
) -> list[tuple[int, int]]:
    """Return links without those of one cell to the next frame that are longer than it moves.

    What closes gaps reaches further, as a cell moves on in them, and so does what finds daughters;
    neither is to make one cell of two that follow each other. Of a division all links are kept.

    Parameters
    ----------
    links, clock, places
        See `sure_links`.
    most : float
        How far a cell moves from frame to frame at most.
    """
    one, other = np.array(links, dtype=np.int64).reshape(-1, 2).T
    divides = np.bincount(one, minlength=len(clock))[one] > 1
    ways = np.hypot(*(places[other, :2] - places[one, :2]).T)
    # Both round: a cell may move just as far.
    kept = divides | (clock[other] - clock[one] > 1) | (ways <= most * (1 + 1e-9))
    return [link for link, keep in zip(links, kept.tolist(), strict=True) if keep]


def sure_links(
    links: list[tuple[int, int]],
    seen: NDArray[np.int64],
    clock: NDArray[np.int64],
    places: NDArray[np.float64],
    reach: float,
) -> list[tuple[int, int]]:
    """Return links without those over lost frames in which another cell may have come there.

    What is nearest after lost frames is the same cell if it moves, by its usual steps before and
    after, by less than half its reach meanwhile. Else it may be the one that was behind it.

    Parameters
    ----------
    links : list of (int, int)
        Spots that follow each other.
    seen, clock : ndarray of int
        The frame of every spot, and the number of it by which it was followed, see `clock_of`.
    places : ndarray, shape (spots, 3)
        Where they are: y, x, and a length for the size.
    reach : float
        How far a cell moves from frame to frame at most.
    """
    one, other = np.array(links, dtype=np.int64).reshape(-1, 2).T
    frames = seen[other] - seen[one]
    over = frames > clock[other] - clock[one]
    if not over.any():
        return links
    within = [link for link, lost in zip(links, over.tolist(), strict=True) if not lost]
    track, _ = tracks_by_links(len(seen), within)
    next_one = frames == 1
    ways = np.hypot(*(places[other, :2] - places[one, :2]).T)[next_one]
    usual = pd.Series(ways).groupby(track[one[next_one]]).quantile(0.9)
    step = np.fmax(*(usual.reindex(track[ends]).fillna(0).to_numpy() for ends in (one, other)))
    kept = ~over | (frames * step < 0.5 * reach)
    return [link for link, keep in zip(links, kept.tolist(), strict=True) if keep]


def tracks_by_links(
    count: int, links: Iterable[tuple[int, int]]
) -> tuple[NDArray[np.int64], list[tuple[int, int]]]:
    """Return the track of so many spots, by rising frame, and (daughter, parent) of divisions.

    laptrack can tell this too, in a table that takes longer than all of its tracking.

    Parameters
    ----------
    count : int
        Of spots.
    links : iterable of (int, int)
        Numbers of spots that follow each other.
    """
    before = np.full(count, -1)
    for earlier, later in links:
        before[later] = earlier
    followers = np.bincount(before[before >= 0], minlength=count)
    track, divisions = np.zeros(count, dtype=np.int64), []
    tracks = 0
    for spot, last in enumerate(before.tolist()):
        if last >= 0 and followers[last] == 1:
            track[spot] = track[last]
            continue
        track[spot] = tracks
        if last >= 0:
            divisions.append((tracks, int(track[last])))
        tracks += 1
    return track, divisions
