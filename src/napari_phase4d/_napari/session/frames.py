"""Which frames and views there are, and which of them are the same after a reconstruction."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from napari_phase4d.holography import pair_distance

__all__ = ["checked_frames", "moved_frames"]


def moved_frames(
    frames: Sequence[tuple[int, int]], old: xr.Dataset | None, new: xr.Dataset
) -> tuple[tuple[int, int], ...]:
    """Return the same frames (time, angle) in a new reconstruction, without those that have gone.

    Parameters
    ----------
    frames : sequence of tuple of int
        In the old reconstruction.
    old : xarray.Dataset or None
        What they were chosen in; None if there was nothing yet.
    new : xarray.Dataset
        The new reconstruction.
    """
    if old is not None:
        moved = [(t, same_view(old, a, new)) for t, a in frames]
        frames = [(t, a) for t, a in moved if a is not None]
    shape = new["phase"].shape[:2]
    return tuple(frame for frame in frames if is_frame(frame, shape))


def is_frame(frame: tuple[int, int], shape: tuple[int, ...]) -> bool:
    """Say whether there is a frame (time, angle); negative numbers count from the end."""
    return all(-n <= i < n for i, n in zip(frame, shape, strict=True))


def checked_frames(
    frames: Sequence[tuple[int, int]], shape: tuple[int, ...]
) -> tuple[tuple[int, int], ...]:
    """Return frames (time, angle) counted from 0.

    Raises
    ------
    ValueError
        If one of them is not there.
    """
    missing = [frame for frame in frames if not is_frame(frame, shape)]
    if missing:
        msg = f"there is no thin frame {missing[0]}; there are {shape[0]} times, {shape[1]} views"
        raise ValueError(msg)
    return tuple((t % shape[0], a % shape[1]) for t, a in frames)


def same_view(old: xr.Dataset, view: int, new: xr.Dataset) -> int | None:
    """Return the number in a new reconstruction of a view of an old one, None if it has gone."""
    lobes = old.attrs["lobes"]
    if not -len(lobes) <= view < len(lobes):
        return None
    distances = [
        pair_distance(lobe["carrier"], lobes[view]["carrier"]) for lobe in new.attrs["lobes"]
    ]
    nearest = min(distances)
    return distances.index(nearest) if nearest < lobes[view]["radius"] else None
