"""Choosing what of a file is the recording: one of its arrays, and the place on further axes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

__all__ = [
    "USUAL_NAMES",
    "Found",
    "axes_in_words",
    "axes_to_choose",
    "choice",
    "chosen_name",
    "chosen_places",
    "listed",
    "other_arrays",
]

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


#: Axes of a picture; every other one may be time.
PICTURE = "YXS"


def chosen_places(
    path: Path, axes: str, shape: Sequence[int], dataset: str | None, whole: str = PICTURE
) -> tuple[int | slice, ...]:
    """Return what to take along each axis: a number, or all.

    Parameters
    ----------
    path : Path
        The file, named in messages.
    axes : str
        A letter an axis; those that a file doesn't name may share one.
    shape : sequence of int
        Their lengths.
    dataset : str or None
        The choice of the user, as "C=1,Z=0".
    whole : str, optional
        Axes of which no place can be chosen. Default: those of a picture.

    Raises
    ------
    ValueError
        If there is no such place.
    """
    # An axis of length 1 says nothing, but a picture keeps its own. By number: axes that a file
    # doesn't name are all called Q.
    places: list[int | slice] = [
        slice(None) if n > 1 or a in PICTURE else 0 for a, n in zip(axes, shape, strict=True)
    ]
    for part in () if dataset is None else dataset.split(","):
        name, _, number = part.strip().partition("=")
        named = [i for i, a in enumerate(axes) if a == name.strip().upper()]
        axis = next((i for i in named if isinstance(places[i], slice)), named[0] if named else -1)
        digits = number.strip().isdigit()
        if axis < 0 or axes[axis] in whole or not digits or int(number) >= shape[axis]:
            known = axes_in_words(axes, shape)
            msg = f"{path.name} has {known}; {part.strip()!r} is no place there"
            raise ValueError(msg)
        places[axis] = int(number)
    return tuple(places)


def axes_in_words(axes: Iterable[str], shape: Iterable[int]) -> str:
    """Return axes with their lengths."""
    named = ", ".join(f"{a}={n}" for a, n in zip(axes, shape, strict=True))
    return f"the axes {named}"


def axes_to_choose(axes: Iterable[str], *, has_time: bool) -> list[str]:
    """Return the axes of which a place must be chosen; without T, the first one is time."""
    others = [a for a in axes if a not in "TYX"]
    return others if has_time else others[1:]


def choice(axes: Iterable[str]) -> str:
    """Return an example of how places on axes are chosen."""
    return 'dataset="' + ",".join(f"{a}=0" for a in axes) + '"'
