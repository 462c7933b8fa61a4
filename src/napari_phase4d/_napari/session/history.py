"""What a session remembers: the lobes as they were before; what its work warned of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntEnum

from napari_phase4d.holography import Lobe

__all__ = ["Heard", "LobeHistory", "StepNumber", "as_sentence"]

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


class StepNumber(IntEnum):
    """The steps in the order in which they follow from each other."""

    RECORDING = 0
    LOBES = 1
    PHASE = 2
    UNWRAP = 3
    COMPARE = 4


class Heard:
    """What was warned of in the work of each step, while what it made is there.

    Examples
    --------
    >>> heard = Heard()
    >>> heard.take(StepNumber.UNWRAP, "Unwrapping", ["the views are apart"])
    >>> heard.of(3), heard.of(3, said=["The views are apart."])
    (['The views are apart.'], [])
    """

    def __init__(self) -> None:
        self._of: dict[int, dict[str, tuple[str, ...]]] = {}

    def take(self, step: StepNumber, work: str, sentences: Sequence[str]) -> None:
        """Take what was warned of in a work, in place of what was so when it was done before."""
        self._of.setdefault(step, {})[work] = tuple(sentences)

    def add(self, step: StepNumber, work: str, sentences: Sequence[str]) -> None:
        """Take what has been warned of so far in a work that goes on."""
        self.take(step, work, (*self._of.get(step, {}).get(work, ()), *sentences))

    def forget(self, step: StepNumber) -> None:
        """Forget what was warned of from a step on."""
        self._of = {number: works for number, works in self._of.items() if number < step}

    def of(self, step: int, said: Iterable[str] = ()) -> list[str]:
        """Return the sentences of a step, each once, without what is said already."""
        known = [plain(words) for words in said]
        works = self._of.get(step, {}).values()
        sentences = dict.fromkeys(as_sentence(words) for work in works for words in work)
        return [s for s in sentences if not any(words in plain(s) for words in known)]


def as_sentence(words: str) -> str:
    """Return what was warned of as a sentence of its own, with units as on screen."""
    end = "" if words.endswith(("?", ".", "!")) else "."
    return f"{words[:1].upper()}{words[1:]}{end}".replace(" um", " µm")


def plain(sentence: str) -> str:
    """Return a sentence without what depends on where it stands."""
    return sentence.casefold().rstrip(".")
