"""What the system tells of the files in a folder: which are new, and which nobody writes any more.

Linux tells it, by inotify (man 7 inotify); other systems do not say when a file is closed. Of
what another machine writes into a folder of a server, nothing is told anywhere.
"""

from __future__ import annotations

import ctypes
import os
import select
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["FolderEvents"]

# Bits of the kernel's <linux/inotify.h>.
MODIFIED, CLOSED, LEFT, CAME, MADE, DELETED = 0x2, 0x8, 0x40, 0x80, 0x100, 0x200
RENAMED, OVERFLOWN, ENDED, IS_FOLDER = 0x800, 0x4000, 0x8000, 0x40000000
ASKED_FOR = MODIFIED | CLOSED | LEFT | CAME | MADE | DELETED | RENAMED
#: Number of the watch, bits, a number that joins two events, length of the name that follows.
HEAD = struct.Struct("iIII")
#: Bytes of events that are read at a time.
AT_ONCE = 1 << 16
#: Files are written in pieces; each is an event, and those of so many seconds are one look.
TOGETHER_S = 0.002


class FolderEvents:
    """What happens in a folder from now on.

    Parameters
    ----------
    folder : Path
        It must be there.

    Raises
    ------
    OSError
        If the system does not tell it.
    """

    def __init__(self, folder: Path) -> None:
        #: Whether events were lost, or the folder is gone or has another name.
        self.broken = False
        self._names: set[str] = set()
        self._whole: set[str] = set()
        libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None
        if libc is None:
            msg = f"{sys.platform} does not tell what happens in {folder}"
            raise OSError(msg)
        self._file = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._file < 0 or libc.inotify_add_watch(self._file, bytes(folder), ASKED_FOR) < 0:
            error = ctypes.get_errno()
            self.close()
            raise OSError(error, os.strerror(error), str(folder))

    def news(self) -> set[str]:
        """Return the names of files that are new, or were changed, since this was asked last."""
        self._heed()
        names, self._names = self._names, set()
        return names

    def is_whole(self, name: str) -> bool:
        """Say whether a file was closed by who wrote it, or moved here, and not changed since."""
        self._heed()
        return name in self._whole

    def forget(self, name: str) -> None:
        """Let go of a file that has been read."""
        self._whole.discard(name)

    def wait(self, seconds: float) -> None:
        """Wait until something happens, at most so long."""
        waiting = select.poll()
        waiting.register(self._file, select.POLLIN)
        if waiting.poll(1000 * seconds):
            time.sleep(TOGETHER_S)

    def close(self) -> None:
        """Ask for no more events."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _heed(self) -> None:
        """Take note of what has happened."""
        for bits, name in self._events():
            if bits & (OVERFLOWN | ENDED | RENAMED):
                self.broken = True
                self._whole.clear()
            elif bits & (LEFT | DELETED):
                self._whole.discard(name)
                self._names.discard(name)
            elif not bits & IS_FOLDER:
                self._names.add(name)
                if bits & (CLOSED | CAME):
                    self._whole.add(name)
                else:
                    self._whole.discard(name)

    def _events(self) -> Iterator[tuple[int, str]]:
        """Yield what has happened: its bits, and the name of the file."""
        while True:
            try:
                told = os.read(self._file, AT_ONCE)
            except BlockingIOError:
                return
            start = 0
            while start < len(told):
                _, bits, _, length = HEAD.unpack_from(told, start)
                start += HEAD.size + length
                yield bits, os.fsdecode(told[start - length : start].rstrip(b"\0"))
