"""Whether what is read at once fits into memory."""

from __future__ import annotations

from napari_phase4d.machine import free_memory
from napari_phase4d.words import size_in_words

__all__ = ["check_fits", "memory_lacks"]

#: Share of the free memory that what is read whole may take; work on it takes as much again.
SHARE_OF_A_FILE = 0.5


def memory_lacks(needed: float, share: float = SHARE_OF_A_FILE) -> str:
    """Say what so many bytes need and what is free; nothing where a share of that is enough."""
    free = free_memory()
    if needed <= share * free:
        return ""
    return f"{size_in_words(needed)}, but {size_in_words(free)} of memory are free"


def check_fits(needed: float, name: str) -> None:
    """Raise OSError if a file that is read whole does not fit.

    Parameters
    ----------
    needed : float
        Bytes that its numbers take in memory.
    name : str
        Name of the file.
    """
    if lacks := memory_lacks(needed):
        msg = (
            f"{name} is read whole and takes {lacks}; "
            "OME-Zarr written by this program is read in parts"
        )
        raise OSError(msg)
