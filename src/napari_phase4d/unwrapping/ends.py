"""Steps along an axis of a stack: what lies at their two ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["both_ends", "ends_along"]

Part = tuple[slice, ...]


def ends_along(axis: int, ndim: int) -> tuple[Part, Part]:
    """Return the parts of a stack that hold the first and the second ends of all steps.

    Parameters
    ----------
    axis : int
        Along which the steps go.
    ndim : int
        Number of dimensions of the stack.

    Examples
    --------
    >>> stack = np.array([[1, 2, 4], [7, 11, 16]])
    >>> head, tail = ends_along(1, stack.ndim)
    >>> stack[tail] - stack[head]
    array([[1, 2],
           [4, 5]])
    """
    head = tuple(slice(None, -1) if i == axis % ndim else slice(None) for i in range(ndim))
    tail = tuple(slice(1, None) if i == axis % ndim else slice(None) for i in range(ndim))
    return head, tail


def both_ends(mask: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Mark the steps along an axis whose two ends both lie in a mask.

    Examples
    --------
    >>> both_ends(np.array([True, True, False, True]), 0)
    array([ True, False, False])
    """
    head, tail = ends_along(axis, mask.ndim)
    both: NDArray[np.bool_] = mask[head] & mask[tail]
    return both
