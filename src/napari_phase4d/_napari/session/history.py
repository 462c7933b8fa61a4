"""The lobes as they were before, for undoing."""

from __future__ import annotations

from napari_phase4d.holography import Lobe

__all__ = ["LobeHistory"]

#: How many changes of the lobes can be undone.
UNDO_DEPTH = 50


class LobeHistory:
    """The lobes before each change, the newest last."""

    def __init__(self) -> None:
        self._before: list[tuple[Lobe, ...]] = []

    def remember(self, lobes: tuple[Lobe, ...]) -> None:
        """Note lobes that are about to be changed, unless they are the newest noted."""
        if not self._before or self._before[-1] != lobes:
            self._before = [*self._before[-UNDO_DEPTH:], lobes]

    def back_from(self, lobes: tuple[Lobe, ...]) -> tuple[Lobe, ...]:
        """Return, and forget, the newest lobes that differ from the present ones.

        Raises
        ------
        ValueError
            If there is nothing to take back.
        """
        while self._before:
            before = self._before.pop()
            if before != lobes:
                return before
        msg = "there is nothing to undo"
        raise ValueError(msg)

    def forget(self) -> None:
        """Forget all changes."""
        self._before = []
