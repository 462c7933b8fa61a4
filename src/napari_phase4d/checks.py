"""What arguments must be, in one sentence that names them; warnings that point at the caller."""

from __future__ import annotations

import os
import sys
import warnings
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["as_numbers", "check_bool", "check_number", "check_type", "shown", "warn"]

PACKAGE = str(Path(__file__).resolve().parent)


def check_number(name: str, value: Any) -> float:
    """Return a number as float; TypeError if it is none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        msg = f"{name} must be a number, but is {shown(value)}"
        raise TypeError(msg)
    return float(value)


def check_bool(name: str, value: Any) -> None:
    """Raise TypeError for what is neither True nor False: "no" would count as True."""
    if not isinstance(value, bool) and type(value).__name__ not in ("bool", "bool_"):
        msg = f"{name} must be True or False, but is {shown(value)}"
        raise TypeError(msg)


def check_type(name: str, value: Any, wanted: type, advice: str) -> None:
    """Raise TypeError for what is of another class, and say where to get the right one."""
    if not isinstance(value, wanted):
        msg = f"{name} must be a {wanted.__name__}, but is {type(value).__name__}; {advice}"
        raise TypeError(msg)


def as_numbers(name: str, values: Any) -> NDArray[Any]:
    """Return real numbers as an array; TypeError if they are none."""
    try:
        found = np.asarray(values)
    except ValueError as error:
        msg = f"{name} must be numbers in rows of one length, but is {shown(values)}"
        raise TypeError(msg) from error
    if found.dtype.kind not in "biuf":
        msg = f"{name} must be real numbers, but is {shown(values)}"
        raise TypeError(msg)
    return found


def shown(value: Any) -> str:
    """Return a value in one short line."""
    if isinstance(value, np.ndarray) or hasattr(value, "dims"):
        return f"{type(value).__name__} of shape {getattr(value, 'shape', ())}"
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else f"{line[:77]}..."


def warn(sentence: str) -> None:
    """Warn of what is probably wrong, at the line outside of this package that asked for it."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and is_ours(frame.f_code.co_filename):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, UserWarning, stacklevel=level)


def is_ours(file: str) -> bool:
    """Say whether code is of this package, or made by a dataclass."""
    return file.startswith((PACKAGE + os.sep, "<string>"))
