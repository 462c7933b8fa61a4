"""Folders for what is needed on the way only, and those that a killed run has left behind."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import zlib
from pathlib import Path
from platform import node

import psutil

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
    machine = f"{zlib.crc32(node().encode()):08x}"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        remove_dead(parent, f"{prefix}-{machine}")
        name = f"{prefix}-{machine}-{os.getpid()}-"
        return Path(tempfile.mkdtemp(prefix=name, dir=parent))
    except OSError as error:
        msg = f"the folder {parent} can't be written ({error.strerror}); choose another one"
        raise OSError(error.errno, msg) from error


def remove_dead(parent: Path, prefix: str) -> None:
    """Remove the folders of processes of this machine that are no more."""
    for folder in parent.glob(f"{prefix}-*"):
        owner = re.match(rf"{re.escape(prefix)}-(\d+)-", folder.name)
        if owner is not None and not psutil.pid_exists(int(owner[1])):
            shutil.rmtree(folder, ignore_errors=True)
