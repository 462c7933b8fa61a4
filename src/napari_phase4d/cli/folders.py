"""The folder that results go to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from napari_phase4d.pipeline import make_folder

__all__ = ["made"]


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder for results; one that was made in vain goes again.

    Raises
    ------
    OSError
        If it can't be made.
    """
    was_there = folder.exists()
    make_folder(folder)
    try:
        yield
    except BaseException:
        if not was_there:
            with suppress(OSError):  # something lies in it
                folder.rmdir()
        raise
