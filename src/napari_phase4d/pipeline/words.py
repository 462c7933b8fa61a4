"""Sizes and times as they are said on screen."""

from __future__ import annotations

__all__ = ["size_in_words", "time_in_words"]


def size_in_words(size: int) -> str:
    """Return a number of bytes in the unit that suits it."""
    if size >= 2**30:
        return f"{size / 2**30:.1f} GB"
    return f"{size / 2**20:.0f} MB" if size >= 10 * 2**20 else f"{size / 2**20:.1f} MB"


def time_in_words(seconds: float) -> str:
    """Return a time in the unit that suits it."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
