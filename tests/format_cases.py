"""One recording in every format: how it is written, and what must be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from format_writers import (
    KOALA_MS,
    RAW,
    Write,
    film,
    gif,
    hdf5,
    hdf5_numbered,
    hyperspy,
    imagej,
    images,
    inside,
    koala_images,
    koala_raw,
    npy,
    npz,
    ome_series,
    ome_tiff,
    ome_zarr,
    pattern,
    picture,
    raw,
    stacks,
    tiff,
    windows_film,
    zarr_array,
    zarr_zip,
)


@dataclass(frozen=True)
class Case:
    """A format: how to write it, what it notes, and how to damage it."""

    write: Write
    kind: str
    dtype: Any = np.uint16
    pixel: bool = False
    interval: bool = False
    times: Sequence[float] | None = None
    exact: bool = True
    whole: bool = False
    single: bool = False
    options: dict[str, Any] = field(default_factory=dict)
    piece: Callable[[Path], Path] = lambda path: path


BYTES = np.uint8
UNEVEN = [0.0, 0.125, 0.3, 0.5]
B_FRAMES = {"bf": "3", "g": "12", "crf": "18", "b-adapt": "0"}

CASES = {
    "TIFF": Case(tiff(), "TIFF"),
    "TIFF, big-endian": Case(tiff(byteorder=">"), "TIFF"),
    "TIFF, compressed": Case(tiff(compression="zlib"), "TIFF, adobe_deflate"),
    "BigTIFF": Case(tiff(bigtiff=True), "BigTIFF"),
    "ImageJ TIFF": Case(imagej, "ImageJ TIFF", pixel=True, interval=True),
    "OME-TIFF": Case(ome_tiff, "OME-TIFF", pixel=True, interval=True),
    "OME-TIFF, one file a frame": Case(
        ome_series, "OME-TIFF", pixel=True, interval=True, piece=inside("rec_9.ome.tif")
    ),
    "folder of PNG": Case(images(".png"), "PNG images", BYTES, piece=inside("frame9.png")),
    "folder of TIFF stacks": Case(stacks, "TIFF files", piece=inside("rec_1.tif")),
    "name with *": Case(pattern, "TIFF files", piece=inside("rec_1.tif")),
    "NPY": Case(npy, "NPY"),
    "NPZ": Case(npz, "NPZ", whole=True),
    "HDF5": Case(hdf5(), "HDF5", pixel=True, interval=True),
    "HDF5, compressed": Case(
        hdf5(chunks=(2, 48, 64), compression="gzip", shuffle=True), "HDF5",
        pixel=True, interval=True,
    ),
    "HDF5, a dataset a frame": Case(hdf5_numbered, "HDF5", pixel=True),
    "HDF5 of HyperSpy": Case(hyperspy, "HDF5", pixel=True, interval=True),
    "Zarr 2": Case(zarr_array(2), "Zarr (version 2)", piece=inside("9.0.0")),
    "Zarr 3": Case(zarr_array(3), "Zarr (version 3)", piece=inside("c/9/0/0")),
    "Zarr 3, sharded": Case(
        zarr_array(3, shards=(4,)), "Zarr (version 3)", piece=inside("c/2/0/0")
    ),
    "Zarr in a zip": Case(zarr_zip, "Zarr (version 3)"),
    "OME-Zarr 0.4": Case(
        ome_zarr("0.4"), "OME-Zarr (version 2)", pixel=True, interval=True,
        piece=inside("0/9.0.0.0.0"),
    ),
    "OME-Zarr 0.5": Case(
        ome_zarr("0.5"), "OME-Zarr (version 3)", pixel=True, interval=True,
        piece=inside("0/c/9/0/0/0/0"),
    ),
    "AVI, uncompressed grey": Case(
        film(".avi", "rawvideo", "gray"), "uncompressed in AVI", BYTES, interval=True
    ),
    "AVI, uncompressed RGB": Case(
        film(".avi", "rawvideo", "bgr24"), "uncompressed in AVI", BYTES, interval=True
    ),
    "AVI, uncompressed YUV": Case(
        film(".avi", "rawvideo", "yuyv422"), "uncompressed in AVI", BYTES, interval=True
    ),
    "AVI, uncompressed, bottom up": Case(
        windows_film, "uncompressed in AVI", BYTES, interval=True
    ),
    "AVI, FFV1": Case(film(".avi", "ffv1", "gray"), "FFV1 in AVI", BYTES, interval=True),
    "AVI, Motion JPEG": Case(
        film(".avi", "mjpeg", "yuvj420p"), "Motion JPEG in AVI", BYTES, interval=True, exact=False
    ),
    "AVI, H.264 with B-frames": Case(
        film(".avi", "libx264", "yuv420p", B_FRAMES), "H.264 in AVI", BYTES, interval=True,
        exact=False,
    ),
    "MP4, H.264 with B-frames": Case(
        film(".mp4", "libx264", "yuv420p", B_FRAMES), "H.264 in MP4", BYTES, interval=True,
        exact=False,
    ),
    "MP4, H.264 without loss": Case(
        film(".mp4", "libx264", "yuv420p", {"qp": "0", "bf": "2", "g": "8"}), "H.264 in MP4",
        BYTES, interval=True,
    ),
    "MKV, H.264 with B-frames": Case(
        film(".mkv", "libx264", "yuv420p", B_FRAMES), "H.264 in MKV", BYTES, interval=True,
        exact=False,
    ),
    "MKV, FFV1 16 bit": Case(
        film(".mkv", "ffv1", "gray16le"), "FFV1 in MKV", interval=True
    ),
    "MKV, FFV1, uneven times": Case(
        film(".mkv", "ffv1", "gray", times=[UNEVEN[i % 4] + i // 4 for i in range(64)]),
        "FFV1 in MKV", BYTES, times=UNEVEN,
    ),
    "MOV, uncompressed": Case(
        film(".mov", "rawvideo", "gray"), "uncompressed in MOV", BYTES, interval=True
    ),
    "raw dump": Case(raw, "raw", options={"raw": RAW}),
    "Koala, raw": Case(
        koala_raw, "Koala raw", BYTES, times=[t / 1000 for t in KOALA_MS],
        piece=inside("Holograms/holo.raw"),
    ),
    "Koala, images": Case(
        koala_images, "Koala, ", BYTES, times=[t / 1000 for t in KOALA_MS],
        piece=inside("Holograms/00009_holo.tif"),
    ),
    "GIF, read with bioio": Case(gif, "GIF, read with bioio", BYTES),
    "PNG": Case(picture(".png"), "PNG image", BYTES, single=True),
    "BMP": Case(picture(".bmp"), "BMP image", BYTES, single=True),
    "JPEG": Case(picture(".jpg"), "JPEG image", BYTES, exact=False, single=True),
}  # fmt: skip
