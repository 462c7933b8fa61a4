"""Choosing which of several arrays of a file is the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

__all__ = ["USUAL_NAMES", "Found", "chosen_name", "listed", "other_arrays"]

#: Names looked for first in a file with several arrays; the last ones say the least.
USUAL_NAMES = ("holograms", "hologram", "mux", "frames", "images", "image", "data")
#: Names of what a recording is compared with, which are taken only where nothing else is there.
ASIDE = ("ref", "background", "bg", "dark", "flat", "empty", "mask", "weight")
#: Frames of fewer pixels a side are tables.
SMALLEST_SIDE = 8
#: Names listed in a message.
LISTED = 8

#: Shape and dtype of an array.
Found = tuple[tuple[int, ...], np.dtype[np.generic]]


def chosen_name(path: Path, arrays: Mapping[str, Found], dataset: str | None) -> str:
    """Return the name of the array to read.

    Parameters
    ----------
    path : Path
        The file, named in messages.
    arrays : mapping of str to (shape, dtype)
        What it holds.
    dataset : str or None
        The name that the user gave; else one with a usual name is taken, else the largest with
        two or three axes (axes of length 1 don't count); of equal ones the first.

    Raises
    ------
    ValueError
        If there is no such array.
    """
    if dataset is not None:
        name = dataset.strip("/")
        if name in arrays:
            return name
        msg = f"{path.name} has no array {dataset!r}; it has {listed(list(arrays))}"
        raise ValueError(msg)
    usable = [name for name, found in arrays.items() if is_video(*found)]
    if not usable:
        msg = (
            f"{path.name} has no array of numbers with two or three axes; "
            f"it has {listed(list(arrays))}"
        )
        raise ValueError(msg)
    return min(usable, key=lambda name: rank(name, arrays[name]))


def is_video(shape: Sequence[int], dtype: np.dtype[np.generic]) -> bool:
    """Say whether an array may be frames."""
    long = [n for n in shape if n != 1]
    return dtype.kind in "buif" and len(long) in (2, 3) and min(shape[-2:]) >= SMALLEST_SIDE


def rank(name: str, found: Found) -> tuple[bool, int, int]:
    """Sort key: what is set aside last, usual names first, large before small."""
    last = name.rsplit("/", 1)[-1].lower()
    named = USUAL_NAMES.index(last) if last in USUAL_NAMES else len(USUAL_NAMES)
    pixels = -int(np.prod([float(n) for n in found[0]]))
    return last.startswith(ASIDE), named, pixels


def other_arrays(name: str, arrays: Mapping[str, Found], dataset: str | None) -> tuple[str, ...]:
    """Return the note that tells what was taken, where the user didn't say it."""
    others = [n for n, found in arrays.items() if n != name and is_video(*found)]
    if dataset is not None or not others:
        return ()
    return (
        f"Of several arrays {name!r} is read; the others are {listed(others)} "
        "(choose one with dataset).",
    )


def listed(names: Sequence[str]) -> str:
    """Return names in words, not too many."""
    if not names:
        return "none"
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")
