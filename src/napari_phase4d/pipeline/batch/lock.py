"""One batch at a time in a folder."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

__all__ = ["alone"]

LOCK = "batch.lock"
#: Seconds after which a lock that was taken over is looked at again: another may have done so too.
SETTLED_S = 0.1
#: Where Linux says which start of the machine this is, and when a process began, in ticks of it.
BOOT, STAT = Path("/proc/sys/kernel/random/boot_id"), "/proc/{}/stat"
#: The place of that in what follows the name of the process.
BEGAN = 19


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other batches out of a folder.

    What a batch that was killed has left behind does not count.

    Raises
    ------
    OSError
        If another batch works there, or the folder can't be written.
    """
    lock, mine = out / LOCK, own_mark()
    temporary = out / f".{LOCK}-{os.getpid()}"
    try:
        temporary.write_text(json.dumps(mine), encoding="utf-8")
        take(lock, temporary, mine)
    except OSError as error:
        if error.errno is None:
            raise
        msg = f"the folder {out} can't be written ({error.strerror}); choose another one"
        failure = OSError(msg)
        failure.errno = error.errno
        raise failure from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    remove_left(out)
    try:
        yield
    finally:
        with suppress(OSError):
            if mark_in(lock) == mine:
                lock.unlink()


def remove_left(out: Path) -> None:
    """Remove what a process that was killed while it took the lock has left."""
    for left in out.glob(f".{LOCK}-*"):
        number = left.name.rpartition("-")[2]
        if number.isdigit() and not psutil.pid_exists(int(number)):
            with suppress(OSError):  # another user's, or held open
                left.unlink(missing_ok=True)


def take(lock: Path, temporary: Path, mine: dict[str, Any]) -> None:
    """Put a lock in its place if there is none, or none of a batch that still runs."""
    try:
        put(lock, temporary)
    except FileExistsError:
        other = mark_in(lock)
        if other is not None and is_alive(other):
            raise OSError(in_use(lock, other)) from None
        temporary.replace(lock)
        time.sleep(SETTLED_S)
        if mark_in(lock) != mine:
            raise OSError(in_use(lock, mark_in(lock) or {})) from None


def put(lock: Path, temporary: Path) -> None:
    """Put a lock in its place; raise FileExistsError if there is one."""
    try:
        # A link is made whole or not at all, and never over another file.
        os.link(temporary, lock)
    except FileExistsError:
        raise
    except OSError:  # no links on this kind of disk
        with lock.open("x", encoding="utf-8") as file:
            file.write(temporary.read_text(encoding="utf-8"))


def in_use(lock: Path, other: dict[str, Any]) -> str:
    """Return the sentence for a folder that another batch works in."""
    return (
        f"another batch (process {other.get('pid', '?')} on {other.get('host', '?')}) works in "
        f"{lock.parent}; wait for its end, choose another folder, or, if it does not run any "
        f"more, remove {lock.name}"
    )


def own_mark() -> dict[str, Any]:
    """Return what tells this process from all others."""
    number = os.getpid()
    return {"pid": number, "began": began(number), "host": socket.gethostname()}


def began(number: int) -> str:
    """Return when a process began, the same whatever happens to the clock meanwhile.

    Raises
    ------
    psutil.Error
        If there is no such process.
    """
    try:
        stat = Path(STAT.format(number)).read_text(encoding="utf-8", errors="replace")
        # The name of the process, in brackets, may hold anything.
        ticks = stat.rpartition(")")[2].split()[BEGAN]
        return f"{BOOT.read_text(encoding='utf-8').strip()} {ticks}"
    except (OSError, IndexError):
        # Other systems note the time once, and leave it when the clock is put right.
        return repr(psutil.Process(number).create_time())


def mark_in(lock: Path) -> dict[str, Any] | None:
    """Return what a lock says, None if it says nothing."""
    try:
        found = json.loads(lock.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def is_alive(mark: dict[str, Any]) -> bool:
    """Say whether the process that a lock names still runs; of other machines it can't be told."""
    if mark.get("host") != socket.gethostname():
        return True
    try:
        # The number of a process that has ended may be that of another one by now.
        return began(int(mark["pid"])) == str(mark["began"])
    except psutil.AccessDenied:
        return True
    except (psutil.Error, KeyError, TypeError, ValueError):
        return False
