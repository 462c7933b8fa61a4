"""Faults as the user is told of them: in one sentence."""

from __future__ import annotations

__all__ = ["EXPECTED", "is_expected", "sentence_of"]

#: Faults whose sentence is for the user.
EXPECTED = (ImportError, MemoryError, OSError, TypeError, ValueError)


def is_expected(error: BaseException) -> bool:
    """Say whether an error has a sentence of its own that is for the user."""
    return isinstance(error, MemoryError) or (isinstance(error, EXPECTED) and bool(str(error)))


def sentence_of(error: BaseException) -> str:
    """Return an error in one line, without its number."""
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f" ({error.filename})"
        return f"{error.strerror}{where}"
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    words = " ".join(str(error).split())
    if is_expected(error):
        return words
    return f"an unexpected fault, {type(error).__name__}" + (f": {words}" if words else "")
