"""What a session remembers: the lobes as they were before; what its work warned of."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from enum import IntEnum

from napari_phase4d.holography import Lobe

__all__ = ["Heard", "LobeHistory", "StepNumber", "as_sentence", "news"]

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
    >>> heard.take(StepNumber.UNWRAP, "Unwrapping", ["The views are apart."])
    >>> heard.of(3)
    ['The views are apart.']
    """

    def __init__(self) -> None:
        self._of: dict[int, dict[str, tuple[str, ...]]] = {}

    def take(self, step: StepNumber, work: str, sentences: Sequence[str]) -> None:
        """Take what was warned of in a work, in place of what was so when it was done before."""
        self._of.setdefault(step, {})[work] = tuple(sentences)

    def forget(self, step: StepNumber) -> None:
        """Forget what was warned of from a step on."""
        self._of = {number: works for number, works in self._of.items() if number < step}

    def of(self, step: int) -> list[str]:
        """Return the sentences of a step, each once."""
        works = self._of.get(step, {}).values()
        return list(dict.fromkeys(words for work in works for words in work))


def news(sentences: Iterable[str], said: Iterable[str]) -> list[str]:
    """Return what was warned of as sentences, without what is said already.

    Examples
    --------
    >>> news(["cell.tif: 2 frames are lost", "the views are apart"], ["2 frames are lost."])
    ['The views are apart.']
    """
    known = [plain(words) for words in said]
    new = dict.fromkeys(as_sentence(words) for words in sentences)
    return [words for words in new if not any(one in plain(words) for one in known)]


#: Letters in which the name of a recording ends, before what is said of it.
LONGEST_NAME = 30


def as_sentence(words: str) -> str:
    """Return what was warned of as a sentence of its own, with units as on screen.

    Examples
    --------
    >>> as_sentence("the pixels are 3 um wide"), as_sentence("cell.tif: is it phase?")
    ('The pixels are 3 µm wide.', 'cell.tif: is it phase?')
    """
    end = "" if words.endswith(("?", ".", "!")) else "."
    starts_with_name = ": " in words[:LONGEST_NAME] or not words.split(" ", 1)[0].isalpha()
    first = words[:1] if starts_with_name else words[:1].upper()
    return re.sub(r"\bum\b", "µm", f"{first}{words[1:]}{end}")


def plain(sentence: str) -> str:
    """Return a sentence without what depends on where it stands."""
    return sentence.casefold().rstrip(".")
