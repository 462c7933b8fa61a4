"""What takes long to load is loaded when it is first used, so that the program starts quickly.

pandas and xarray take a fifth of a second together, in which no window opens and no help is
printed. Modules take them from here, under the names that the field knows them by. SciPy and
scikit-image load their own parts in this way: ``import scipy`` and ``scipy.ndimage.label``.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    import tifffile
    import xarray as xr

__all__ = ["load_ahead", "pd", "tifffile", "xr"]

#: What almost everything that is done with a recording takes.
NEEDED_SOON = (
    "numba",
    "xarray",
    "scipy.fft",
    "scipy.ndimage",
    "scipy.special",
    "tifffile",
    "matplotlib",  # for its colours
    "matplotlib.figure",  # and the first plot
    "matplotlib.backends.backend_agg",
)


class Library:
    """A library that is loaded when something of it is first asked for.

    Threads that ask at the same time wait for each other, which those of
    `importlib.util.LazyLoader` do not, and nobody else who asks for it sees a difference.

    Parameters
    ----------
    name : str
        What it is imported as.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        """Load the library, and return something of it."""
        value = getattr(importlib.import_module(self._name), name)
        setattr(self, name, value)  # so that it is found at once from now on
        return value

    def __dir__(self) -> list[str]:
        """List what there is."""
        return dir(importlib.import_module(self._name))

    def __repr__(self) -> str:
        """Say which library it is."""
        return f"Library({self._name!r})"

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        """Let functions that use it be sent to the workers of a cluster."""
        return Library, (self._name,)


if not TYPE_CHECKING:  # so that type checkers see the libraries themselves
    pd = Library("pandas")
    tifffile = Library("tifffile")
    xr = Library("xarray")


def load_ahead(
    then: Sequence[Callable[[], object]], closed: Callable[[], bool]
) -> threading.Thread:
    """Load in a thread what is needed soon, so that the first click does not wait for it.

    Parameters
    ----------
    then : sequence of callable
        What to do in that thread when all is there. Where one fails, what needs it will say so.
    closed : callable
        Whether there will be no click any more; what is left is left out then.

    Returns
    -------
    threading.Thread
        It ends by itself, after about a second.
    """
    loads: list[Callable[[], object]] = [
        partial(importlib.import_module, name) for name in NEEDED_SOON
    ]

    def work() -> None:
        for do in (*loads, *then):
            if closed():
                return
            with suppress(Exception):
                do()

    thread = threading.Thread(target=work, name="loading ahead")
    thread.start()
    return thread
