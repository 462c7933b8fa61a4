"""What is probably wrong is warned of, once, in one sentence; who hears it."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

__all__ = ["hearing", "warn"]

PACKAGE = str(Path(__file__).resolve().parent)
#: Where sentences go instead of to Python's own warnings.
HEARD: ContextVar[list[str] | None] = ContextVar("HEARD", default=None)


def warn(sentence: str) -> None:
    """Warn of what is probably wrong, at the line outside of this package that asked for it."""
    heard = HEARD.get()
    if heard is not None:
        if sentence not in heard:
            heard.append(sentence)
        return
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and is_ours(frame.f_code.co_filename):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, UserWarning, stacklevel=level)


@contextmanager
def hearing(heard: list[str] | None = None) -> Iterator[list[str]]:
    """Hear what is warned of in this thread, in place of Python, which has one hook for all.

    Parameters
    ----------
    heard : list of str, optional
        Where the sentences go, each once, as soon as they are said.

    Yields
    ------
    list of str
        The same list.

    Examples
    --------
    >>> with hearing() as heard:
    ...     warn("the fringes are weak")
    >>> heard
    ['the fringes are weak']
    """
    heard = [] if heard is None else heard
    before = HEARD.set(heard)
    try:
        yield heard
    finally:
        HEARD.reset(before)


def is_ours(file: str) -> bool:
    """Say whether code is of this package, or made by a dataclass."""
    return file.startswith((PACKAGE + os.sep, "<string>"))
