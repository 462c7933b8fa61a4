"""OME-Zarr that is written in blocks of frames, by many hands and in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from napari_phase4d.io.describing import PROGRAM, described
from napari_phase4d.io.zarr_results import ALL_CHUNKS, ARRAY, new_array, ome_note

__all__ = ["ALL_CHUNKS", "ARRAY", "create_blocks", "finish_blocks"]


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

    # Chunks of single frames take twice as long to write; the packer keeps up with the work.
    top = zarr.create_group(group, zarr_format=3)
    new_array(top, shape, np.float32, frames=frames, packer="lz4")
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
        {"ome": ome_note(stack, (low, high)), PROGRAM: described(stack)}
    )
