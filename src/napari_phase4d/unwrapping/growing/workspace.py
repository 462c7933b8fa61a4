"""Memory that is used again for frame after frame."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PerThread", "Workspace"]


class Workspace:
    """Arrays by name, kept until a larger one is asked for.

    Fresh memory is handed out by the system page by page, which costs more than most kernels
    take, and threads wait for each other at it.
    """

    def __init__(self) -> None:
        self._held: dict[str, NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Return an array of any content; it is overwritten when the name is asked for again."""
        size = math.prod(shape)
        held = self._held.get(name)
        if held is None or held.size < size or held.dtype != dtype:
            held = self._held[name] = np.empty(size, dtype=dtype)
        return held[:size].reshape(shape)

    def clear(self) -> None:
        """Let go of all arrays."""
        self._held.clear()


class PerThread(threading.local):
    """A workspace of each thread's own."""

    def __init__(self) -> None:
        self.workspace = Workspace()
