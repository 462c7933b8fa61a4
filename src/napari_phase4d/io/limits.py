"""What files may say of themselves; whatever is beyond is damage, or made to fill the memory."""

from __future__ import annotations

__all__ = [
    "LARGEST_KOALA_SIDE",
    "LARGEST_PIECE",
    "LARGEST_SIDE",
    "MOST_DESCRIBED_FRAMES",
    "MOST_LISTED_FRAMES",
]

#: Pixels along a side of a frame.
LARGEST_SIDE = 2**20
#: The same in the header of a file of Koala, which knows one file from another by it.
LARGEST_KOALA_SIDE = 2**16
#: Bytes of a piece (a chunk of HDF5 or Zarr) unpacked; a camera's holds a few frames.
LARGEST_PIECE = 2**30
#: Frames that the description of a TIFF file may tell of: laying out more would take minutes.
MOST_DESCRIBED_FRAMES = 2_000_000
#: Frames of which a list fits into memory, at some 100 bytes each.
MOST_LISTED_FRAMES = 20_000_000
