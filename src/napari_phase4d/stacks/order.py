"""Whether the frames of a stack lie in the order of time, and its axes in that of plain arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks.numbers import Doubt

__all__ = ["doubts_of_axes", "doubts_of_order"]

#: At fewer places than the first, where the order of names parts from that of numbers, it may be
#: something that comes and goes by itself; so many are looked at, in frames of about so many
#: pixels.
LEAST_PLACES, PLACES, PIXELS = 4, 6, 1024
#: Frames that follow each other in the one order are so many times as far from each other as in
#: the other one, this share of them farther than any there; frames that stand still tell nothing.
FARTHER, MOST, STILL = 1.3, 0.8, 1e-4
#: Pairs within the order that are held against each place: frames that a camera gave twice have
#: no distance at all from one to the next.
BESIDE = 3
#: The last axis of a plain array is so many times shorter than the others where it may be time.
NARROW = 4

Distance = Callable[[int, int], float]


def doubts_of_order(stack: xr.DataArray) -> Iterator[Doubt]:
    """Yield the doubt that frames lie in the order of time.

    Parameters
    ----------
    stack : DataArray
        Wrapped phase in radians; of long ones some frames of the first view are read.
    """
    if "time" not in stack.dims:
        return
    if are_sorted_as_text(stack):
        yield Doubt(
            "seems to have its frames in the order of their names as text, 1, 10, 11, 2, and not "
            "of their times; sort the files by their numbers",
            "seems to have its frames in the order 1, 10, 11, 2 of their names, and not of their "
            "times",
        )


def doubts_of_axes(stack: xr.DataArray) -> Iterator[Doubt]:
    """Yield the doubt that time is the last axis of an array that does not name its axes."""
    if may_have_time_last(stack):
        n_times, n_rows, n_columns = stack.shape
        yield Doubt(
            f"has {n_times} frames of {n_rows} x {n_columns} pixels; if its axes are (y, x, "
            "time), give numpy.moveaxis(phase, -1, 0)"
        )


def are_sorted_as_text(stack: xr.DataArray) -> bool:
    """Say whether frames were numbered, and then put in the order 1, 10, 11, 2 of these names.

    What moves or grows is then farther from frame to frame where that order parts from that of
    numbers, and only there, than beside such a place and than to the frame of the next number.
    """
    n_frames, apart = stack.sizes["time"], distances_in(stack)
    return any(fits_names(sorted(range(k, k + n_frames), key=str), apart) for k in (0, 1))


def fits_names(names: list[int], apart: Distance) -> bool:
    """Say whether frames lie in the order of these names, by how far they are from each other."""
    follows = np.diff(names) == 1
    parted, joined = np.flatnonzero(~follows), np.flatnonzero(follows)
    if len(parted) < LEAST_PLACES or not len(joined):
        return False
    chosen = parted[np.unique(np.linspace(0, len(parted) - 1, PLACES).astype(int))]
    over = [apart(int(i), int(i) + 1) for i in chosen]
    near = {int(i) for at in chosen for i in joined[np.argsort(np.abs(joined - at))[:BESIDE]]}
    if not farther(over, [apart(i, i + 1) for i in near]):
        return False
    place = {name: i for i, name in enumerate(names)}
    numbered = [(int(i), place.get(names[i] + 1)) for i in chosen]
    return farther(over, [apart(i, j) for i, j in numbered if j is not None])


def farther(over: Iterable[float], within: Iterable[float]) -> bool:
    """Say whether distances are clearly larger than others."""
    far, near = (np.array([d for d in some if np.isfinite(d)]) for some in (over, within))
    if len(far) < 2 or not len(near):
        return False
    mean = float(far.mean())
    clear = mean > STILL and mean > FARTHER * near.mean()
    return clear and bool(np.mean(far > near.max()) >= MOST)


def distances_in(stack: xr.DataArray) -> Distance:
    """Return what tells how far two frames of the first view are apart, whatever their level."""
    read: dict[int, tuple[NDArray[np.complex64], NDArray[np.float32]]] = {}
    axes = [str(axis) for axis in stack.dims]
    every = max(math.isqrt(stack.sizes["y"] * stack.sizes["x"] // PIXELS), 1)

    def phasors(time: int) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
        """Return those of a frame, 0 where nothing is known, and where something is."""
        if time not in read:
            at = {"time": time, "angle": 0}
            chosen = tuple(at.get(axis, slice(None, None, every)) for axis in axes)
            phase = np.array(stack.data[chosen], dtype=np.float32).ravel()
            known = np.isfinite(phase)
            phase[~known] = 0
            phasor = np.empty(phase.shape, np.complex64)
            phasor.real, phasor.imag = np.cos(phase) * known, np.sin(phase) * known
            read[time] = phasor, known.astype(np.float32)
        return read[time]

    def apart(one: int, other: int) -> float:
        (first, known), (second, also_known) = phasors(one), phasors(other)
        n_pixels = float(known @ also_known)
        return 1 - float(abs(np.vdot(first, second))) / n_pixels if n_pixels else math.nan

    return apart


def may_have_time_last(stack: xr.DataArray) -> bool:
    """Say whether the last axis may be time: it is far shorter, and the first two are alike."""
    if stack.dims != ("time", "y", "x") or NARROW * stack.shape[2] > min(stack.shape[:2]):
        return False
    every = max(stack.size // 2**20, 1)
    rough = [roughness(stack, axis, every) for axis in range(3)]
    if not all(rough):
        return False
    along_time, along_y, along_x = np.log(rough)
    return bool(abs(along_time - along_y) < abs(along_x - along_y))


def roughness(stack: xr.DataArray, axis: int, every: int) -> float:
    """Return how much phase changes from one number to the next along an axis.

    Of each other axis but the shortest one in so many numbers is looked at.
    """
    thinned = int(np.argmax([0 if i == axis else n for i, n in enumerate(stack.shape)]))
    chosen = tuple(slice(None, None, every if i == thinned else 1) for i in range(3))
    some = np.asarray(stack.data[chosen], dtype=np.float32)
    step = np.diff(np.where(np.isfinite(some), some, np.float32(np.nan)), axis=axis)
    known = step[np.isfinite(step)]
    return 1.0 - float(np.cos(known).mean()) if known.size else 0.0
