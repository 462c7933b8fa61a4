"""Which tracks of several views are one cell's."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import scipy

from napari_phase4d.later import pd

__all__ = ["joined_views"]

#: Tracks of two views are one cell's where they stay within so many diameters.
REACH_ACROSS = 1.5
#: ... and are seen together in this share of the frames of the shorter one.
TOGETHER = 0.3
#: Further tracks are the same cell's, such as those before and after it was not found in a view,
#: where they stay within so many diameters, and differ as little in size: they lie on each other.
CLOSE = 0.5

#: Number of a view, and of a track in it.
Track = tuple[int, int]


class Groups:
    """Tracks of all views, and which of them are one cell's.

    Parameters
    ----------
    views : list of DataFrame
        What `tracks_of` gives for each view.
    """

    def __init__(self, views: list[pd.DataFrame]) -> None:
        self._frames: dict[Track, set[int]] = {}
        self._parents: set[tuple[Track, Track]] = set()
        for view, spots in enumerate(views):
            for track, own in spots.groupby("track", sort=False):
                one = (view, int(str(track)))
                self._frames[one] = set(own["frame"].tolist())
                self._parents.add((one, (view, int(own["parent"].iloc[0]))))
        self._members: dict[Track, list[Track]] = {track: [track] for track in self._frames}

    def of(self, track: Track) -> list[Track]:
        """Return all tracks of the cell that a track is of."""
        return self._members[track]

    def join(self, one: Track, other: Track) -> None:
        """Make two tracks one cell's, unless two of it would then be seen at once in a view."""
        first, second = self._members[one], self._members[other]
        if first is second or not all(self._may_be_one(a, b) for a in first for b in second):
            return
        first += second
        for track in second:
            self._members[track] = first

    def _may_be_one(self, one: Track, other: Track) -> bool:
        """Say whether two tracks may be one cell's; a daughter is another one than her parent."""
        if one[0] != other[0]:
            return True
        related = {(one, other), (other, one)} & self._parents
        return not related and self._frames[one].isdisjoint(self._frames[other])


def joined_views(views: list[pd.DataFrame]) -> list[tuple[int, int]]:
    """Give tracks of all views the numbers of cells, as "cell"; return (daughter, parent)."""
    groups = Groups(views)
    seen = [number for number, view in enumerate(views) if not view.empty]
    beside = {(a, b): tracks_beside(views[a], views[b]) for a, b in combinations(seen, 2)}
    for (one, other), pairs in beside.items():
        for a, b in assigned(new_pairs(pairs, groups, one, other)):
            groups.join((one, a), (other, b))
    for (one, other), pairs in beside.items():
        close = pairs[(pairs["apart"] < CLOSE) & (pairs["grown"] < CLOSE)].sort_values("cost")
        for a, b in close.index.tolist():
            groups.join((one, int(a)), (other, int(b)))
    return numbered(views, groups)


def new_pairs(pairs: pd.DataFrame, groups: Groups, one: int, other: int) -> pd.DataFrame:
    """Return the pairs of tracks of two views that earlier views do not tell of already."""
    with_other = [
        any(view == other for view, _ in groups.of((one, int(a)))) for a, _ in pairs.index.tolist()
    ]
    alone = [len(groups.of((other, int(b)))) == 1 for _, b in pairs.index.tolist()]
    new: pd.DataFrame = pairs.loc[np.array(alone, bool) & ~np.array(with_other, bool)]
    return new


def tracks_beside(one: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Return which tracks of two views run side by side, and how near, in diameters.

    Returns
    -------
    DataFrame
        A row for each such pair, by its two tracks: how far "apart" they are, how much one has
        "grown" against the other, and the "cost" of taking them for one.
    """
    diameter = 2 * math.sqrt(float(one["area"].median()) / math.pi)
    both = one.merge(other, on="frame", suffixes=("", "_2"))
    way = both[["y_2", "x_2"]].to_numpy(np.float64) - both[["y", "x"]].to_numpy(np.float64)
    near = np.hypot(*way.T) < 2 * REACH_ACROSS * diameter
    # Objects that lie high or low are shifted between views, all by about as much.
    shift = np.median(way[near], axis=0) if near.any() else np.zeros(2)
    ratio = both["area_2"].to_numpy(np.float64) / both["area"].to_numpy(np.float64)
    both["apart"] = np.hypot(*(way - shift).T) / diameter
    both["grown"] = 0.5 * np.abs(np.log(ratio))
    of_pair = both.groupby(["track", "track_2"])
    pairs = of_pair[["apart", "grown"]].median()
    lengths = [view["track"].value_counts() for view in (one, other)]
    shorter = np.minimum(
        *(
            length.reindex(pairs.index.get_level_values(level)).to_numpy(np.float64)
            for level, length in enumerate(lengths)
        )
    )
    share = of_pair.size().to_numpy(np.float64) / shorter
    pairs["cost"] = pairs["apart"] + pairs["grown"] - 0.1 * REACH_ACROSS * share
    return pairs.loc[(pairs["apart"] < REACH_ACROSS) & (share > TOGETHER)]


def assigned(pairs: pd.DataFrame) -> list[tuple[int, int]]:
    """Return the pairs of two views that are one cell's, one to one, so that they cost least."""
    if pairs.empty:
        return []
    costs = pairs["cost"].unstack().fillna(10 * REACH_ACROSS)
    matrix = costs.to_numpy(np.float64)
    rows, columns = scipy.optimize.linear_sum_assignment(matrix)
    return [
        (int(costs.index[i]), int(costs.columns[j]))
        for i, j in zip(rows, columns, strict=True)
        if matrix[i, j] < 2 * REACH_ACROSS
    ]


def numbered(views: list[pd.DataFrame], groups: Groups) -> list[tuple[int, int]]:
    """Give cells numbers in the order in which they appear, see `joined_views`."""
    began: dict[Track, tuple[float, ...]] = {}
    for number, view in enumerate(views):
        for track, *place in view[["track", "frame", "y", "x"]].to_numpy(np.float64).tolist():
            here = (place[0], number, *place[1:])
            group = groups.of((number, int(track)))[0]
            began[group] = min(began.get(group, here), here)
    order = {group: i for i, group in enumerate(sorted(began, key=began.__getitem__), 1)}
    parents: dict[int, int] = {}
    for number, view in enumerate(views):
        cell = {
            track: order[groups.of((number, track))[0]]
            for track in view["track"].unique().tolist()
        }
        view["cell"] = [cell[track] for track in view["track"].tolist()]
        for track, parent in set(map(tuple, view[["track", "parent"]].to_numpy(int).tolist())):
            if parent >= 0:
                parents.setdefault(cell[track], cell[parent])
    return sorted((child, parent) for child, parent in parents.items() if child != parent)
