"""OME-Zarr that is written in blocks of frames, by many hands and in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from napari_phase4d.io.describing import SIGNATURE, described
from napari_phase4d.io.zarr_results import ARRAY, NAMES, ome_note

__all__ = ["ARRAY", "create_blocks", "finish_blocks"]


def create_blocks(group: Path, shape: tuple[int, ...], frames: int) -> Path:
    """Make an empty float32 stack (time, angle, y, x) on disk.

    Parameters
    ----------
    group : Path
        Folder to make.
    shape : tuple of int
        Shape of the stack.
    frames : int
        Frames in a block. A file holds one; different ones may be written at the same time.

    Returns
    -------
    Path
        The folder of its array, for ``zarr.open_array``.
    """
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    zarr.create_group(group, zarr_format=3).create_array(
        ARRAY,
        shape=shape,
        # One view of a block a chunk: chunks of single frames take twice as long to write.
        chunks=(min(frames, shape[0]), 1, *shape[2:]),
        dtype=np.float32,
        # The quickest: it keeps up with the reconstruction. Blosc trusts what it reads, so that a
        # damaged file could end the program; the sum is looked at first.
        compressors=[BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle"), Crc32cCodec()],
        dimension_names=NAMES,
        config={"write_empty_chunks": True},
    )
    return group / ARRAY


def finish_blocks(group: Path, stack: xr.DataArray, limits: tuple[float, float]) -> None:
    """Note in a stack that is written by now what it is.

    Parameters
    ----------
    group : Path
        Its folder.
    stack : xarray.DataArray
        Its axes, name and attributes; the values do not count.
    limits : tuple of float
        Smallest and largest number, for programs that show it.
    """
    import zarr

    low, high = (np.full(stack.sizes["angle"], limit) for limit in limits)
    zarr.open_group(group, mode="r+").update_attributes(
        {"ome": ome_note(stack, group, (low, high)), SIGNATURE: described(stack)}
    )
