"""Sizes, times and counts as they are said on screen."""

from __future__ import annotations

__all__ = ["counted", "size_in_words", "time_in_words"]


def size_in_words(size: float) -> str:
    """Return a number of bytes in the unit that suits it; a GB is 2**30 bytes, a MB 2**20.

    Examples
    --------
    >>> size_in_words(3 * 2**30)
    '3.0 GB'
    """
    if size >= 2**30:
        return f"{size / 2**30:.1f} GB"
    return f"{size / 2**20:.0f} MB" if size >= 10 * 2**20 else f"{size / 2**20:.1f} MB"


def time_in_words(seconds: float) -> str:
    """Return a time in the unit that suits it.

    Examples
    --------
    >>> time_in_words(600)
    '10 min'
    """
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def counted(number: object, what: str) -> str:
    """Return a number with what it counts.

    Examples
    --------
    >>> counted(1, "frame"), counted(2, "frame")
    ('1 frame', '2 frames')
    """
    return f"{number} {what}" if str(number) == "1" else f"{number} {what}s"
