"""Axes beyond time, y and x: which a file has, and the place that the user chose on each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

__all__ = ["PICTURE", "axes_in_words", "axes_to_choose", "choice", "chosen_places"]

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
