"""Names of temporary files that say whose they are, so that the next run can remove them."""

from __future__ import annotations

import os
import re
import shutil
import zlib
from contextlib import suppress
from pathlib import Path
from platform import node

import psutil

__all__ = ["machine", "own_prefix", "remove_dead"]

#: Bytes of a temporary file's name that tell what it is to become; names may have 255.
SHORT = 40


def own_prefix(name: str) -> str:
    """Return what the name of a hidden temporary file of this process begins with.

    Parameters
    ----------
    name : str
        What it is to become.
    """
    short = name.encode(errors="replace")[:SHORT].decode(errors="ignore")
    return f".{short}-{machine()}-{os.getpid()}-"


def machine() -> str:
    """Return what tells this machine from others that may see the same disk."""
    return f"{zlib.crc32(node().encode()):08x}"


def remove_dead(parent: Path, begins: str = ".") -> None:
    """Remove temporary files and folders of processes of this machine that are no more.

    Parameters
    ----------
    parent : Path
        Where they lie.
    begins : str, optional
        What their names begin with. Default: what `own_prefix` hides.
    """
    owner = re.compile(rf"{re.escape(begins)}.*-{machine()}-(\d+)-[^-]*$", re.DOTALL)
    for path in parent.iterdir():
        found = owner.match(path.name)
        if found is None or psutil.pid_exists(int(found[1])):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):  # another user's, or held open
                path.unlink(missing_ok=True)
