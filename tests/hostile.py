"""Files made to harm, and how to write them."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from damaging import npy_header, zip_bomb
from faulty import FRAMES

ABSURD = 200_000


class Runs:
    """Runs code when it is unpickled: makes a file."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.trace),)


def tiff_bomb(path: Path) -> None:
    """Write a TIFF of one compressed strip that says it is 200000 pixels wide and high."""
    tifffile.imwrite(path, np.zeros((16, 16), np.uint8), compression="zlib", metadata=None)
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tif:
        tags = tif.pages.first.tags
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            place = tags[name].offset
            data[place + 2 : place + 12] = struct.pack("<HII", 4, 1, ABSURD)
    path.write_bytes(data)


def hollow_tiff(path: Path) -> None:
    """Write a TIFF whose description tells of a million frames."""
    tifffile.imwrite(
        path, FRAMES, imagej=True, metadata={"axes": "TYX"},
    )  # fmt: skip
    data = path.read_bytes()
    told = data.replace(b"frames=5\n", b"frames=9999999\n")
    assert told != data
    path.write_bytes(told)


def ome_without_end(path: Path) -> None:
    """Write an OME-TIFF that tells of 30 million frames; each takes room in a list."""
    tifffile.imwrite(path, FRAMES, ome=True, metadata={"axes": "TYX"})
    with tifffile.TiffFile(path) as tif:
        xml = str(tif.ome_metadata)
    tifffile.tiffcomment(path, xml.replace('SizeT="5"', 'SizeT="30000000"').encode())


def circular_tiff(path: Path) -> None:
    """Write a TIFF whose last page is followed by its first."""
    tifffile.imwrite(path, FRAMES, photometric="minisblack", metadata=None)
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tif:
        assert len(tif.pages) == len(FRAMES)
        last, first = tif.pages.next_page_offset, tif.pages.first.offset
    data[last : last + 4] = struct.pack("<I", first)
    path.write_bytes(data)


def billion_laughs(path: Path) -> None:
    """Write an OME-TIFF whose XML unfolds to gigabytes."""
    tifffile.imwrite(path, FRAMES, ome=True, metadata={"axes": "TYX"})
    entities = "".join(
        f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' if i else f'<!ENTITY a0 "{"ha" * 500}">'
        for i in range(8)
    )
    tifffile.tiffcomment(path, f"<?xml version='1.0'?><!DOCTYPE x [{entities}]><OME>&a7;</OME>")


def picture_bomb(path: Path) -> None:
    """Write a PNG of 60000 x 60000 zeros, some kB long."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        ends = struct.pack(">I", len(data)), struct.pack(">I", zlib.crc32(kind + data))
        return ends[0] + kind + data + ends[1]

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(60001 * 100)) for _ in range(20)) + packer.flush()
    head = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )


def hdf5_of(path: Path, make: Callable[[Any, Any], object]) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        make(file, h5py)


def packed_in_one_piece(file: Any, _: Any) -> None:
    """Say that a few bytes unpack to 3.6 GB, all of which a frame needs."""
    size = (4, 60000, 60000)
    data = file.create_dataset("holograms", size, "u1", chunks=(1, *size[1:]), compression="gzip")
    data.id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(10**6)))


def pointing_to_itself(file: Any, h5py: Any) -> None:
    """Let a dataset consist of itself, on which the HDF5 library ends the program."""
    layout = h5py.VirtualLayout(FRAMES.shape, "u1")
    layout[:] = h5py.VirtualSource(".", "holograms", FRAMES.shape)
    file.create_virtual_dataset("holograms", layout)


def without_end(file: Any, h5py: Any) -> None:
    """Tell of a milliard frames, which need not be anywhere."""
    layout = h5py.VirtualLayout((10**9, *FRAMES.shape[1:]), "u1")
    file.create_virtual_dataset("holograms", layout, fillvalue=1)


def zarr_of(path: Path, **changes: object) -> None:
    """Write a Zarr array, then let its description say something else."""
    import zarr

    store = zarr.create_array(str(path), shape=FRAMES.shape, chunks=FRAMES.shape, dtype="u1")
    store[:] = FRAMES
    told = json.loads((path / "zarr.json").read_text())
    told.update(changes)
    (path / "zarr.json").write_text(json.dumps(told))


GRID = {"name": "regular", "configuration": {"chunk_shape": [1, ABSURD, ABSURD]}}
HUGE = (10**6, ABSURD, ABSURD)
#: Name of the file -> how to write it.
FILES: dict[str, Callable[[Path], object]] = {
    "bomb.tif": tiff_bomb,
    "frames.tif": hollow_tiff,
    "xml.ome.tif": billion_laughs,
    "sizes.ome.tif": ome_without_end,
    "bomb.png": picture_bomb,
    "shape.npy": lambda p: p.write_bytes(npy_header(HUGE) + bytes(1000)),
    "overflow.npy": lambda p: p.write_bytes(npy_header((2**62, 2**62, 16)) + bytes(1000)),
    "negative.npy": lambda p: p.write_bytes(npy_header((-1, 32, 32)) + bytes(1000)),
    "text.npy": lambda p: p.write_bytes(npy_header((5, 32, 48), "<U2") + bytes(61440)),
    "record.npy": lambda p: np.save(p, np.zeros((4, 8, 8), [("a", "u1"), ("b", "f4")])),
    "frame.npz": lambda p: zip_bomb(p, npy_header((1, 2**17, 2**17)), 64),
    "shape.npz": lambda p: zip_bomb(p, npy_header((10**6, 512, 512)), 16),
    "absurd.h5": lambda p: hdf5_of(
        p, lambda f, _: f.create_dataset("holograms", HUGE, "u1", chunks=(1, 100, 100))
    ),
    "piece.h5": lambda p: hdf5_of(p, packed_in_one_piece),
    "itself.h5": lambda p: hdf5_of(p, pointing_to_itself),
    "many.h5": lambda p: hdf5_of(p, without_end),
    "huge.zarr": lambda p: zarr_of(p, shape=HUGE, chunk_grid=GRID),
    "object.zarr": lambda p: zarr_of(p, data_type="object"),
    "pickle.zarr": lambda p: zarr_of(p, codecs=[{"name": "numcodecs.pickle"}]),
}  # fmt: skip
