"""Warnings that point at the caller's own line."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

__all__ = ["warn"]

PACKAGE = str(Path(__file__).resolve().parents[1])


def warn(sentence: str) -> None:
    """Warn of what is probably wrong, at the line outside of this package that asked for it."""
    level, frame = 1, sys._getframe()  # it is the documented way to find the caller
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, UserWarning, stacklevel=level)
