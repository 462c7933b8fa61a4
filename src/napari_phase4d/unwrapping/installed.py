"""Unwrapping methods that other packages bring."""

from __future__ import annotations

import functools
import re
import threading
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points

from napari_phase4d.unwrapping.method import Method

__all__ = ["GROUP", "WithInstalled"]

#: The group of entry points under which a package names its methods.
GROUP = "napari_phase4d.methods"
#: What an id may look like: it stands in file names, commands and recipes.
ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
#: Keywords of `unwrap`, which no option may take.
TAKEN = {"phase", "method", "boundary", "mask", "progress", "cancelled", "amplitude"}


class WithInstalled(Mapping[str, Method]):
    """Methods of this program, and of what is installed when they are first looked at.

    A package that can't be used is left out with a warning: it must not stop the others.

    Parameters
    ----------
    own : mapping of str to Method
        The program's methods by their ids.
    """

    def __init__(self, own: Mapping[str, Method]) -> None:
        self._own = dict(own)
        self._lock = threading.RLock()

    @functools.cached_property
    def _all(self) -> dict[str, Method]:
        with self._lock:
            return self._own | installed_methods(self._own)

    def __getitem__(self, method: str) -> Method:
        found = self._own.get(method)
        return self._all[method] if found is None else found

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)


def installed_methods(own: Mapping[str, Method]) -> dict[str, Method]:
    """Return the methods of installed packages, in the order of their ids."""
    found: dict[str, Method] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            found[point.name] = loaded(point, {*own, *found})
        except (Exception, SystemExit) as error:  # whatever the package does wrong
            why = " ".join(str(error).split()) or type(error).__name__
            warnings.warn(
                f"the unwrapping method {point.name!r} of {package_of(point)} is left out: {why}",
                stacklevel=2,
            )
    return found


def loaded(point: EntryPoint, taken: set[str]) -> Method:
    """Return the method of an entry point.

    Only the program's own methods stream: how each goes through the blocks is written for it.

    Raises
    ------
    ValueError, TypeError
        If its id or an option can't be used, or it is no `Method`.
    """
    if point.name in taken:
        msg = "there is a method of this id already"
        raise ValueError(msg)
    if not ID.fullmatch(point.name):
        msg = "an id is made of small letters, digits and single hyphens"
        raise ValueError(msg)
    method = point.load()
    if not isinstance(method, Method):
        msg = f"{point.value} is a {type(method).__name__}, not a Method"
        raise TypeError(msg)
    for option in method.options:
        if option.name in TAKEN or not option.name.isidentifier():
            msg = f"an option can't be called {option.name!r}"
            raise ValueError(msg)
    return replace(method, package=package_of(point), streams=False)


def package_of(point: EntryPoint) -> str:
    """Return name and version of the package that an entry point belongs to."""
    return (
        "an unknown package" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    )
