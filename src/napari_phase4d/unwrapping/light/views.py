"""Some views of a stack as a stack of their own: those of one wavelength."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block, ReadOnly, Stack, Store, Temporary

__all__ = ["Named", "Together", "ViewsOf", "frames_among", "views_by_light"]

ALL = slice(None)
Views = tuple[int, ...]
Frame = tuple[int, int]


def views_by_light(wavelengths_um: NDArray[np.float64] | None) -> list[Views]:
    """Return the numbers of the views of each wavelength, shortest first.

    Parameters
    ----------
    wavelengths_um : ndarray of shape (view,) or None
        In micrometres; None where they are not known.

    Returns
    -------
    list of tuple of int
        Empty if there is one wavelength only.
    """
    if wavelengths_um is None or len(np.unique(wavelengths_um)) < 2:
        return []
    return [
        tuple(np.flatnonzero(wavelengths_um == light).tolist())
        for light in np.unique(wavelengths_um)
    ]


def frames_among(
    frames: Sequence[Frame], views: Sequence[int], places: NDArray[np.floating]
) -> list[Frame]:
    """Return which frames of some views stand for the boundary frames of all views.

    A boundary frame holds at its time for every wavelength: there it is the frame of the same
    angle, or of the nearest.

    Parameters
    ----------
    frames : sequence of (int, int)
        Boundary frames (time, view) among all views.
    views : sequence of int
        The views that are asked for.
    places : ndarray of shape (view,)
        Angle of every view in degrees.
    """
    found = []
    for time, view in frames:
        near = np.abs(places[list(views)] - places[view])
        found.append((time, int(np.argmin(near))))
    return list(dict.fromkeys(found))


@dataclass(frozen=True)
class ViewsOf:
    """Some views of a stack.

    Parameters
    ----------
    stack : Stack
        All views.
    views : tuple of int
        Which of them.
    """

    stack: Stack
    views: Views

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, view, y, x)."""
        n_times, _, *frame = self.stack.shape
        return (n_times, len(self.views), *frame)

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views."""
        each = [self.stack.read(block, slice(v, v + 1)) for v in self.views[angles]]
        return each[0] if len(each) == 1 else np.concatenate(each, axis=1)

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views."""
        for i, view in enumerate(self.views[angles]):
            self.stack.write(block, values[:, i : i + 1], slice(view, view + 1))


@dataclass(frozen=True)
class Together(ReadOnly):
    """Stacks of some views each, put together to one of all; to be read only.

    Parameters
    ----------
    parts : tuple of (tuple of int, Stack)
        Numbers of the views, and their stack; every view is in one of them.
    """

    parts: tuple[tuple[Views, Stack], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, view, y, x)."""
        n_times, _, *frame = self.parts[0][1].shape
        return (n_times, sum(len(views) for views, _ in self.parts), *frame)

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views."""
        place = {view: (stack, i) for views, stack in self.parts for i, view in enumerate(views)}
        wanted = [place[view] for view in range(self.shape[1])[angles]]
        return np.concatenate([stack.read(block, slice(i, i + 1)) for stack, i in wanted], axis=1)


@dataclass(frozen=True)
class Named:
    """A store whose stacks have a word before their names, so that several may share a place.

    Parameters
    ----------
    store : Store
        The place.
    word : str
        The word.
    """

    store: Store
    word: str

    def temporary(self, name: str, shape: tuple[int, ...], dtype: str) -> Temporary:
        """Return a new stack of zeros."""
        return self.store.temporary(f"{self.word}_{name}", shape, dtype)
