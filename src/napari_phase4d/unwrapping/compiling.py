"""Loops that can't be written as array operations, compiled where numba is there."""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

__all__ = ["can_compile", "compiled", "is_on_disk"]

F = TypeVar("F", bound=Callable[..., Any])

HERE = Path(__file__).parent


def compiled(function: F) -> F:
    """Compile a function when it is first called, and keep the result on disk.

    Compiled functions leave the interpreter's lock, so that frames can be worked on in threads.
    Where nothing can be compiled, the function stays as it is.
    """
    if not can_compile():
        return function
    drop_outdated()
    return cast("F", jitted(function))


def jitted(function: Callable[..., Any]) -> Any:
    """Return numba's form of a function; kept on disk where there is a place for it."""
    import numba

    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # no folder can be written to
        return numba.njit(nogil=True)(function)


@functools.cache
def can_compile() -> bool:
    """Say whether functions can be compiled here; if not, warn once and say why."""
    try:
        return bool(jitted(one_more)(1) == 2)
    except Exception as error:  # whatever it is, there is another way
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        warnings.warn(
            f"numba can't compile here ({reason}); unwrapping takes the slower way round",
            RuntimeWarning,
            stacklevel=2,
        )
        return False


@functools.cache
def drop_outdated() -> None:
    """Delete compiled functions that are older than any of the sources.

    numba looks at the file of the function itself, not at those of functions that it calls.
    """
    changed = [path.stat().st_mtime for path in HERE.rglob("*.py")]
    # Clocks differ between machines: what seems to come from the future says nothing.
    newest = max((time_ for time_ in changed if time_ <= time.time()), default=0.0)
    for path in HERE.rglob("__pycache__/*.nb[ic]"):
        try:
            if path.stat().st_mtime < newest:
                path.unlink()
        except OSError:
            continue  # somebody else was quicker, or it is not ours to delete


def is_on_disk(function: Callable[..., Any]) -> bool:
    """Say whether a compiled function has been kept on disk; True where nothing is compiled."""
    stats = getattr(function, "stats", None)
    if stats is None:
        return True
    name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}-*.nbi"
    return any(Path(stats.cache_path).glob(name))


def one_more(number: int) -> int:
    """Return a number plus one, to see whether compiling works."""
    return number + 1
