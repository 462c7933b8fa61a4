"""How long work will still take, from how fast it has been."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["TimeLeft", "in_words"]

#: Nothing is said before so many seconds, when too little is known.
TOO_EARLY_S = 1.5


class TimeLeft:
    """Guesses the seconds left of one stretch of work; a new message begins a new stretch.

    Parameters
    ----------
    clock : callable, optional
        Gives the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._message = ""
        self._began = 0.0
        self._first = 0

    def seconds(self, done: int, total: int, message: str) -> float | None:
        """Return the seconds left, None while they can't be told."""
        now = self._clock()
        if message != self._message or done < self._first:
            self._message, self._began, self._first = message, now, done
        elapsed, steps = now - self._began, done - self._first
        if elapsed < TOO_EARLY_S or steps < 1 or total <= done:
            return None
        return elapsed / steps * (total - done)


def in_words(seconds: float | None) -> str:
    """Return a time left as it is said on screen; "" where it is not known."""
    if seconds is None:
        return ""
    if seconds < 60:
        return f", about {max(1, round(seconds))} s left"
    return f", about {round(seconds / 60)} min left"
