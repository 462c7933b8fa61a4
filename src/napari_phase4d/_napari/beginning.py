"""Before the first click: what is loaded ahead in a thread, and a Qt binding that is no good."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable
from typing import Any

import pint
from pint.registry import LazyRegistry
from qtpy.QtCore import QObject, Signal

from napari_phase4d.later import load_ahead
from napari_phase4d.pipeline import load_object_finder, warm_up_elsewhere

__all__ = ["Units", "binding_advice", "get_ready", "start_loop"]

#: With it each call takes a reference from None, until a Python before 3.12 ends for lack of them.
ENDING_PYSIDE = "6.12.0"


def binding_advice(python: tuple[int, ...], pyside: str | None) -> str:
    """Return what is wrong with a version of the Qt binding for one of Python, or nothing."""
    if python >= (3, 12) or pyside != ENDING_PYSIDE:
        return ""
    return (
        f"PySide6 {ENDING_PYSIDE} makes Python {python[0]}.{python[1]} end without a word after "
        "some minutes; install another version of it, for example: pip install 'PySide6<6.12'"
    )


class Units(QObject):  # type: ignore[misc]
    """Reads in a thread the units of which napari needs some for the first layer.

    pint takes a third of a second for it, in which the window would stand still.
    """

    read = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.read.connect(self._take)

    def read_ahead(self) -> None:
        """Read them, in a thread, if nobody has before."""
        if self._missing():
            self.read.emit(pint.UnitRegistry(on_redefinition="raise"))

    def _take(self, registry: pint.UnitRegistry[Any]) -> None:
        """Let napari have them, unless somebody has needed units meanwhile."""
        # Those of two registries can't be compared, so that none may be in use.
        if self._missing():
            pint.set_application_registry(registry)  # type: ignore[no-untyped-call]

    @staticmethod
    def _missing() -> bool:
        return isinstance(pint.get_application_registry().get(), LazyRegistry)  # type: ignore[no-untyped-call]


#: Of the program: Qt objects may not end in a thread.
units = functools.cache(Units)


def get_ready(closed: Callable[[], bool]) -> None:
    """Begin, unless the dock has closed, with what the first click would wait for otherwise.

    Parameters
    ----------
    closed : callable
        Whether the dock has closed, also while this goes on in a thread.
    """
    if not closed():
        then = (units().read_ahead, start_loop, warm_up_elsewhere, load_object_finder)
        load_ahead(then, closed)


def start_loop() -> None:
    """Start the thread of Zarr that reads and writes for all plugins.

    Work that gives way would start it else, and it would give way from then on.
    """
    from zarr.core.sync import sync

    sync(asyncio.sleep(0))
