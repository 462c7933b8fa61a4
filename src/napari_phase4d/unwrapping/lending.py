"""A problem as a package's method is given it: to look at, not to write into."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import InMemory
from napari_phase4d.task import CancelledCall, ProgressCall
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["LentProblem"]


class LentProblem(Problem):
    """A view of a problem whose arrays can't be written into.

    What is written there would reach all methods that run later, and the array of the caller.

    Parameters
    ----------
    owner : Problem
        What is computed once is computed there, so that other methods have it too.
    """

    def __init__(self, owner: Problem) -> None:
        vars(self).update(vars(owner))
        self._owner = owner
        self.boundaries = list(owner.boundaries)
        self.wrapped = read_only(owner.wrapped)
        self.usable = read_only(owner.usable)
        self._given = None  # the owner's may be written to
        if isinstance(owner.template.data, np.ndarray):
            self.template = owner.template.copy(data=read_only(owner.template.data))

    @property
    def amplitude(self) -> NDArray[np.float32] | None:
        """Amplitude of all frames as a share of its view's median, or None."""
        share = super().amplitude
        return None if share is None else read_only(share)

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels to unwrap."""
        return read_only(self._owner.mask)

    def spatial(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.float32]:
        """Return all frames unwrapped one by one."""
        return read_only(self._owner.spatial(progress, cancelled))

    def shifts(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.intp]:
        """Return the shifts that register all frames, shape (time, angle, 2)."""
        return read_only(self._owner.shifts(progress, cancelled))

    def background(self) -> Background:
        """Return the empty field of every frame, and its level."""
        found = self._owner.background()
        empty = InMemory(read_only(found.mask))
        return replace(found, empty=empty, level=read_only(found.level))


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return a view of an array that can't be written into."""
    view = values.view()
    view.flags.writeable = False
    return view
