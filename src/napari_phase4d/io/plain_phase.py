"""Phase in files of any program, which say nothing about their numbers."""

from __future__ import annotations

from pathlib import Path

from napari_phase4d.io.hdf5 import HDF5_SUFFIXES, read_hdf5
from napari_phase4d.io.microscopes import is_koala_phase, read_koala_phase
from napari_phase4d.io.raw import read_npy, read_npz
from napari_phase4d.io.tiff import TIFF_SUFFIXES, read_tiff
from napari_phase4d.io.video import Video
from napari_phase4d.io.zarr_files import is_zarr, read_zarr

__all__ = ["plain_phase"]

#: Names looked for first in an .npz file with several arrays.
PHASE_NAMES = ("wrapped", "phase", "unwrapped")


def plain_phase(path: Path, dataset: str | None) -> Video:
    """Return the numbers of a file that says nothing about them, lazily where it allows that."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path)
    if suffix == ".npz":
        return read_npz(path, dataset, PHASE_NAMES, (2, 3, 4))
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path, dataset)
    if suffix in HDF5_SUFFIXES:
        return read_hdf5(path, dataset)
    if is_zarr(path):
        return read_zarr(path, dataset)
    if is_koala_phase(path):
        return read_koala_phase(path)
    msg = (
        f"{path.name} is of a kind that can't be read as phase; use OME-TIFF, OME-Zarr, HDF5, "
        ".npy, .npz or .bin of Koala"
    )
    raise OSError(msg)
