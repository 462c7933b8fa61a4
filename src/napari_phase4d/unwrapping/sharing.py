"""Steps that several methods start from, done once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["FIELD", "GRAPH", "SharedSteps"]

#: Name of what the directional methods start from.
FIELD = "field"
#: Name of the graph of all pixels, which confidence goes along.
GRAPH = "graph"

T = TypeVar("T")


class SharedSteps:
    """Holds what was computed once, and how long it took.

    Attributes
    ----------
    seconds : dict of str to float
        Time that each step took.
    used : set of str
        Steps that were asked for since this was last emptied.
    """

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}
        self.seconds: dict[str, float] = {}
        self.used: set[str] = set()

    def once(self, name: str, work: Callable[[], T]) -> T:
        """Return what ``work()`` returned when it was first asked for by this name."""
        self.used.add(name)
        if name not in self._known:
            began = time.perf_counter()
            self._known[name] = work()
            self.seconds[name] = time.perf_counter() - began
        found: T = self._known[name]
        return found

    def knows(self, name: str) -> bool:
        """Say whether something has been computed by this name."""
        return name in self._known

    def forget(self, name: str) -> None:
        """Let go of what was computed by this name."""
        self._known.pop(name, None)

    def forget_field(self) -> None:
        """Let go of what the directional methods share: it is as large as many results."""
        self.forget(FIELD)
        self.forget(GRAPH)

    def tidy(self) -> None:
        """Remove what was needed on the way only, where that lies on disk."""
