"""The tilt of single frames, where the arms of the interferometer move against each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.emptyfield import (
    joined_to_the_border,
    mode_phase,
    wrapped,
)
from napari_phase4d.holography.polar import ENOUGH_BACKGROUND

__all__ = ["FrameTilt"]

#: A tilt is fitted to the means of about so many squares.
SQUARES = 1200
#: Squares of the empty field deviate by less than this from the fit, in radians.
TILT_LIMITS_RAD = (1.0, 0.6, 0.4)

Array = NDArray[np.float64]


class FrameTilt:
    """Fits a tilt to the empty field of single frames; what all have in common is off already.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the fields in pixels.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.step = max(1, math.isqrt(math.prod(shape) // SQUARES))
        self._size = (shape[0] // self.step, shape[1] // self.step)
        self._y, self._x = (np.linspace(-1, 1, n) for n in shape)
        y, x = (
            line[: n * self.step].reshape(n, self.step).mean(axis=1)
            for line, n in zip((self._y, self._x), self._size, strict=True)
        )
        grid = np.broadcast_arrays(1.0, y[:, None], x[None, :])
        self._terms: Array = np.stack([np.broadcast_to(g, self._size).ravel() for g in grid])
        self._per_step = tuple(float(line[1] - line[0]) for line in (y, x))
        # An object is mostly in the middle.
        self._weights = (self._terms[1] ** 2 + self._terms[2] ** 2) ** 2
        self._weights /= self._weights.sum()

    def take_off(self, fields: NDArray[np.complex64]) -> None:
        """Take the tilt off the fields of all views of a frame, (view, y, x), in place."""
        for field in fields:
            along_y, along_x = self.of(field)
            if along_y or along_x:
                rows, columns = (
                    np.exp(-1j * slope * line).astype(np.complex64)
                    for slope, line in ((along_y, self._y), (along_x, self._x))
                )
                field *= rows[:, None]
                field *= columns

    def of(self, field: NDArray[np.complex64]) -> tuple[float, float]:
        """Return the tilt of a field, in radians from the middle to the edge along y and x.

        It is 0 where too little empty field is in view, or where a tilt would explain no more of
        the field than none: so an object that fills the view is not levelled.
        """
        (height, width), step = self._size, self.step
        strips = field[: height * step].reshape(height, step, -1).sum(axis=1)
        seen = strips[:, : width * step].reshape(height, width, step).sum(axis=2)
        phase = np.angle(seen).astype(np.float64)
        starts = (np.zeros(3), self._first(seen))
        wide = [self._explained(start, phase, TILT_LIMITS_RAD[0]) for start in starts]
        found = self._refined(starts[int(np.argmax(wide))], phase)
        shares = [self._explained(each, phase, TILT_LIMITS_RAD[-1]) for each in (starts[0], found)]
        if shares[1] <= shares[0]:
            return 0.0, 0.0
        return float(found[1]), float(found[2])

    def _first(self, seen: NDArray[np.complexfloating]) -> Array:
        """Return the tilt that the median difference of neighbours gives."""
        steps = (seen[1:] * seen[:-1].conj(), seen[:, 1:] * seen[:, :-1].conj())
        slopes = [
            float(np.median(np.angle(each))) / step
            for each, step in zip(steps, self._per_step, strict=True)
        ]
        return np.array([0.0, *slopes])

    def _rest(self, found: Array, phase: Array) -> Array:
        """Return what a tilt leaves, relative to the most frequent phase."""
        rest = wrapped(phase - (found @ self._terms).reshape(self._size))
        return wrapped(rest - mode_phase(rest))

    def _refined(self, found: Array, phase: Array) -> Array:
        """Return the tilt fitted to the empty field near a first one; none if there is little."""
        for limit in TILT_LIMITS_RAD:
            rest = self._rest(found, phase)
            near = joined_to_the_border(np.abs(rest) < limit)
            if near.mean() < ENOUGH_BACKGROUND:
                return np.zeros(3)
            weighed = self._terms * near.ravel()
            found = found + np.linalg.solve(weighed @ self._terms.T, weighed @ rest.ravel())
        return found

    def _explained(self, found: Array, phase: Array, limit: float) -> float:
        """Return the share of the field that lies near a tilt; the outer field counts most."""
        rest = self._rest(found, phase).ravel()
        return float(np.maximum(1 - (rest / limit) ** 2, 0) @ self._weights)
