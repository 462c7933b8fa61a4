"""Loops that can't be written as array operations, compiled where numba is there."""

from __future__ import annotations

import functools
import inspect
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

__all__ = ["can_compile", "compiled", "inlined", "is_on_disk", "unchecked", "vectorized"]

F = TypeVar("F", bound=Callable[..., Any])

HERE = Path(__file__).parent
#: What lets a loop work on several pixels at once: a division by zero gives infinity, and sums may
#: be taken in another order, always the same on one machine.
VECTORIZED = {"error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}
#: Held while numba is told of a function, so that threads don't tell it of one twice.
FORMING = threading.RLock()


def compiled(function: F) -> F:
    """Compile a function when it is first called, and keep the result on disk.

    Compiled functions leave the interpreter's lock, so that frames can be worked on in threads.
    Where nothing can be compiled, the function stays as it is.
    """
    return cast("F", WhenCalled(function, {}))


def vectorized(function: F) -> F:
    """Do the same with a loop over pixels that does not depend on the order of its sums."""
    return cast("F", WhenCalled(function, VECTORIZED))


def inlined(function: F) -> F:
    """Do the same with a loop that others call in one place or two: it becomes part of them.

    What is compiled by itself and again as part of each of its callers takes longer to compile.
    """
    return cast("F", WhenCalled(function, {"inline": "always"}))


def unchecked(function: F) -> F:
    """Do the same as `compiled` with a loop that divides: by zero gives infinity.

    A loop that is to raise an error there works on one number at a time.
    """
    return cast("F", WhenCalled(function, {"error_model": "numpy"}))


class WhenCalled:
    """A function that numba is told of when it is first called, also by a compiled one.

    There are a hundred of them in modules that every window and every command loads, and numba
    itself takes a third of a second to load.

    Parameters
    ----------
    function : callable
        As it is written.
    options : dict
        Those of numba.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self._options = options
        self._form: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Call what it was compiled to; numbers and arrays go by their place, not by name."""
        try:
            return (self._form or self.form())(*arguments)
        except SystemError as error:
            # What a signal raises while numba hands over comes wrapped, and looks like a fault.
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, KeyboardInterrupt):
                cause = cause.__cause__
            if cause is None:
                raise
            raise cause from None

    def __getattr__(self, name: str) -> Any:
        """Return what numba knows of it."""
        return getattr(self.form(), name)

    def __reduce__(self) -> str:
        """Let it be sent to other processes, by its name, as functions are."""
        return str(self.__qualname__)

    @property
    def _numba_type_(self) -> Any:
        """What a compiled function that calls this one takes it for; the name is numba's."""
        return self.form()._numba_type_

    def form(self) -> Any:
        """Return numba's form of it, or where nothing can be compiled the function itself."""
        with FORMING:
            if self._form is None:
                self._form = compiled_with(self.__wrapped__, self._options)
        return self._form


def compiled_with(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Compile a function with some options of numba, if anything can be compiled here."""
    if not can_compile():
        return function
    drop_outdated(room_of(function))
    return jitted(function, options)


def jitted(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return numba's form of a function; kept on disk where there is a place for it."""
    import numba

    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    except RuntimeError:  # no folder can be written to
        return numba.njit(nogil=True, **options)(function)


def room_of(function: Callable[..., Any]) -> Path:
    """Return the folder right below the package's in which a function is written."""
    file = Path(inspect.getfile(function))
    return next((room for room in file.parents if room.parent == HERE), file.parent)


@functools.cache
def can_compile() -> bool:
    """Say whether functions can be compiled here; if not, warn once and say why."""
    try:
        trial = jitted(one_more, {})
        if has_compiled(trial):
            return True
        works = bool(trial(1) == 2)
        for path in kept_forms(trial):
            with suppress(OSError):
                path.touch()  # also if it was kept before a library was installed again
        return works
    except Exception as error:  # whatever it is, there is another way
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        warnings.warn(
            f"numba can't compile here ({reason}), so all work takes much longer",
            RuntimeWarning,
            stacklevel=2,
        )
        return False


def has_compiled(trial: Any) -> bool:
    """Say whether these versions have compiled a function before, without loading it.

    To load the first compiled function takes a quarter of a second, in which no window opens.
    """
    import llvmlite  # type: ignore[import-untyped]
    import numba

    installed = max(Path(library.__file__).stat().st_mtime for library in (llvmlite, numba))
    return any(path.stat().st_mtime > installed for path in kept_forms(trial))


@functools.cache
def drop_outdated(room: Path) -> None:
    """Delete a room's compiled functions that are older than any source that they may call.

    numba looks at the file of the function itself, not at those of functions that it calls. Rooms
    call loops of the package's own folder too; what lies there calls nothing of the rooms.
    """
    sources = {*HERE.glob("*.py"), *(room.glob("*.py") if room == HERE else room.rglob("*.py"))}
    changed = [path.stat().st_mtime for path in sources]
    # Clocks differ between machines: what seems to come from the future says nothing.
    newest = max((time_ for time_ in changed if time_ <= time.time()), default=0.0)
    for path in (room.glob if room == HERE else room.rglob)("__pycache__/*.nb[ic]"):
        try:
            if path.stat().st_mtime < newest:
                path.unlink()
        except OSError:
            continue  # somebody else was quicker, or it is not ours to delete


def is_on_disk(function: Callable[..., Any]) -> bool:
    """Say whether a compiled function has been kept on disk; True where nothing is compiled."""
    return not hasattr(function, "stats") or any(kept_forms(function))


def kept_forms(function: Any) -> Iterator[Path]:
    """Yield the files that say what this Python has kept of a compiled function."""
    folder = function.stats.cache_path
    if folder is not None:  # where nothing can be written, nothing is kept
        python = f"py{sys.version_info.major}{sys.version_info.minor}"
        name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}-*.{python}*.nbi"
        yield from Path(folder).glob(name)


def one_more(number: int) -> int:
    """Return a number plus one, to see whether compiling works."""
    return number + 1
