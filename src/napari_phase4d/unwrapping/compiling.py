"""Loops that can't be written as array operations, compiled where numba is there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

__all__ = ["compiled"]

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function when it is first called, and keep the result on disk.

    Compiled functions leave the interpreter's lock, so that frames can be worked on in threads.
    The plain function is the attribute ``py_func``.
    """
    import numba

    return cast("F", numba.njit(cache=True, nogil=True)(function))
