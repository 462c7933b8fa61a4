"""Long work, ready to run anywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """Work on a snapshot of the session, so that the user can go on while it runs.

    Parameters
    ----------
    title : str
        What the user sees.
    work : callable
        ``work(progress, cancelled)``, where each may be None; touches nothing but its own
        snapshot.
    receive : callable
        Takes the result into the session; to be called in the window's thread. It refuses a
        result for what has changed since.
    cancellable : bool
        Whether the work looks at ``cancelled``; if not, its result is just not waited for.
    gives_way : bool
        Whether it runs unseen and ends as soon as other work is started.
    keeps_parts : bool
        Whether the work, when cancelled, returns what is finished instead of raising Cancelled.
    """

    title: str
    work: Callable[[ProgressCall | None, CancelledCall | None], Any]
    receive: Callable[[Any], None]
    cancellable: bool = True
    gives_way: bool = False
    keeps_parts: bool = False

    def run(self) -> None:
        """Do the work here and now."""
        self.receive(self.work(None, None))
