"""Folders for what is needed on the way only, and those that a killed run has left behind."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from napari_phase4d.io.atomic import machine, remove_dead

__all__ = ["new_folder"]


def new_folder(parent: Path, prefix: str) -> Path:
    """Return a new, empty folder whose name says which process it belongs to.

    Such folders of processes that are no more are removed first.

    Parameters
    ----------
    parent : Path
        Where to make it; made too if it is not there.
    prefix : str
        What its name begins with.

    Raises
    ------
    OSError
        If it can't be made.
    """
    try:
        parent.mkdir(parents=True, exist_ok=True)
        remove_dead(parent, prefix)
        name = f"{prefix}-{machine()}-{os.getpid()}-"
        return Path(tempfile.mkdtemp(prefix=name, dir=parent))
    except OSError as error:
        msg = f"the folder {parent} can't be written ({error.strerror}); choose another one"
        raise OSError(error.errno, msg) from error
