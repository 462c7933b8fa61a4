"""What several methods start from: each step is done once, by the first that asks for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["FIELD", "FRAMES_LEFT_OUT", "GRAPH", "PLATEAUS", "RESIDUES", "SharedSteps"]

#: Name of what the directional methods start from.
FIELD = "field"
#: What the frames are noted under that a directional method left out.
FRAMES_LEFT_OUT = "frames_left_out"
#: Name of the graph of all pixels, which confidence goes along.
GRAPH = "graph"
#: Name of what looks empty, and lies whole turns above the field.
PLATEAUS = "plateaus"
#: Name of the residues that stand in the way of levels.
RESIDUES = "residues"

T = TypeVar("T")


class Locks:
    """What threads wait for that share a problem; a copy of it, or one in a file, has its own."""

    def __init__(self) -> None:
        #: Held while what is known is looked through.
        self.changing = threading.Lock()
        #: Held while several things are made that belong together.
        self.together = threading.RLock()
        self._named: dict[str, threading.RLock] = {}

    def of(self, name: str) -> threading.RLock:
        """Return the lock of a step."""
        with self.changing:
            return self._named.setdefault(name, threading.RLock())

    def __reduce__(self) -> tuple[type[Locks], tuple[()]]:
        """Leave out what nobody else can hold."""
        return Locks, ()


class SharedSteps:
    """Holds what was computed once, and how long it took; several threads may ask for it.

    Attributes
    ----------
    seconds : dict of str to float
        Time that each step took.
    used : set of str
        Steps that were asked for since this was last emptied.
    locks : Locks
        What threads wait for.
    """

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}
        self.seconds: dict[str, float] = {}
        self.used: set[str] = set()
        self.locks = Locks()

    def once(self, name: str, work: Callable[[], T]) -> T:
        """Return what ``work()`` returned when it was first asked for by this name.

        Who asks while another thread is at it waits: on disk both would write the same file, and
        one would read it while it is still empty. Other names don't wait: the work may use
        threads that ask for them. None of these may ask for its own name, nor for one that waits
        for it: that would never end.
        """
        self.used.add(name)
        with self.locks.of(name):
            if name in self._known:
                found: T = self._known[name]
            else:
                began = time.perf_counter()
                found = self._known[name] = work()
                self.seconds[name] = time.perf_counter() - began
        return found

    def knows(self, name: str) -> bool:
        """Say whether something has been computed by this name."""
        return name in self._known

    def known(self, name: str) -> Any:
        """Return what was computed by this name; see `knows`."""

        def nothing() -> Any:
            msg = f"nothing is known by the name {name!r}"
            raise AssertionError(msg)

        return self.once(name, nothing)

    def note(self, name: str, found: object) -> None:
        """Keep something by a name, in the place of what was there."""
        self._known[name] = found

    def forget(self, name: str) -> None:
        """Let go of what was computed by this name."""
        self._known.pop(name, None)

    def forget_field(self) -> None:
        """Let go of what the directional methods share: it is as large as many results."""
        self.forget(FIELD)
        self.forget(GRAPH)
        self.forget(RESIDUES)

    def tidy(self) -> None:
        """Remove what was needed on the way only, where that lies on disk."""
