"""Writing files and folders so that a half-written one is never seen.

Names of temporary files say whose they are, so that the next run can remove them.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from platform import node

import psutil

__all__ = [
    "UnreadableError",
    "folder_written_whole",
    "machine",
    "put_in_place",
    "remove_dead",
    "remove_folder",
    "text_of",
    "written_whole",
]

#: Bytes of a temporary file's name that tell what it is to become; names may have 255.
SHORT = 40
#: No note, description or list of times is longer, in bytes.
MOST_TEXT = 2**28


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


#: Between tries to remove what is still written into, in seconds, and how often.
AGAIN_S, TRIES = 0.05, 40
#: A folder is gone if it is not there so many looks in a row.
QUIET = 4


def remove_folder(folder: Path) -> None:
    """Remove a folder for good, if it is there; what can't be removed is left.

    Zarr writes chunks side by side: when one fails, as on a full disk, others still come and make
    their folder anew.
    """
    gone = QUIET if not folder.exists() else 0
    for _ in range(TRIES):
        if gone >= QUIET:
            return
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(AGAIN_S)
        gone = 0 if folder.exists() else gone + 1


#: A disk with less room than this is full.
LEFT_BYTES = 2**17


class UnreadableError(OSError):
    """What was to be written could not be read or computed; its message is for the user."""


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it to ``path`` once all is written.

    Raises
    ------
    OSError
        If the folder can't be written or the disk is full; ``path`` is then as it was before.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=own_prefix(path.stem), suffix=path.suffix
        )
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o666 & ~umask())
        onto_disk(temporary)
        temporary.replace(path)
        onto_disk(path.parent)
    except OSError as error:
        raise not_written(path, error) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: Path) -> Iterator[Path]:
    """Give an empty temporary folder to fill, and rename it to ``path`` once all is written.

    An older folder of that name is replaced.

    Raises
    ------
    OSError
        If it can't be written or the disk is full; ``path`` is then as it was before.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix=own_prefix(path.stem)))
        yield temporary
        temporary.chmod(0o777 & ~umask())
        put_in_place(temporary, path, path.with_name(f"{temporary.name}-old"))
    except OSError as error:
        raise not_written(path, error) from error
    finally:
        if temporary is not None:
            remove_folder(temporary)


def put_in_place(new: Path, path: Path, old: Path) -> None:
    """Rename a folder to ``path``; what was there is called ``old`` meanwhile, then removed.

    Raises
    ------
    OSError
        If it can't be renamed; ``path`` is then as it was before.
    """
    if not path.exists():
        new.rename(path)
        return
    path.rename(old)  # no system replaces a folder that holds something in one step
    try:
        new.rename(path)
    except OSError:
        old.rename(path)
        raise
    shutil.rmtree(old) if old.is_dir() else old.unlink()


def onto_disk(path: Path) -> None:
    """Wait until what was written lies on the disk, so that a crash leaves it whole.

    Folders can't be waited for on every system.
    """
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF, errno.EACCES, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


def umask() -> int:
    """Return which rights new files do not get.

    Temporary files are private; results should be as readable as any other new file.
    """
    mask = os.umask(0)
    os.umask(mask)
    return mask


def not_written(path: Path, error: OSError) -> OSError:
    """Return the error that says so in one sentence, unless it was no fault of writing."""
    if isinstance(error, UnreadableError):
        return error
    number = error.errno or (errno.ENOSPC if is_full(path) else None)
    why = error.strerror or (str(error) if number is None else os.strerror(number))
    failure = OSError(f"{path} could not be written ({why}); nothing was changed there")
    failure.errno = number
    return failure


def text_of(path: Path) -> str:
    """Return the text of a note or another small file.

    Raises
    ------
    OSError
        If it can't be read, is a pipe or a device, which may have no end, or far too large.
    UnicodeDecodeError
        If it is no text.
    """
    if path.exists() and not path.is_file():
        msg = f"{path.name} is not a file, but a folder, a pipe or a device"
        raise OSError(msg)
    if path.stat().st_size > MOST_TEXT:
        msg = f"{path.name} is larger than any text that is read here ({MOST_TEXT} bytes)"
        raise OSError(msg)
    return path.read_text(encoding="utf-8")


def is_full(path: Path) -> bool:
    """Say whether a disk has no room left; NumPy does not say that this is why it failed."""
    try:
        return shutil.disk_usage(path.parent).free < LEFT_BYTES
    except OSError:
        return False
