"""How Zarr packs its pieces: whatever is packed well is read right, what would burst is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from zarr.codecs import (
    BloscCodec,
    BytesCodec,
    Crc32cCodec,
    GzipCodec,
    ShardingCodec,
    TransposeCodec,
    ZstdCodec,
)
from zarr.codecs import numcodecs as packed_by

import napari_phase4d as p4d

numcodecs = pytest.importorskip("numcodecs")

pytestmark = pytest.mark.filterwarnings("ignore:Numcodecs codecs are not in the Zarr version 3")

#: Frames of noise on a slope, so that packing makes them smaller, but pieces stay real ones.
FRAMES = np.random.default_rng(4).integers(0, 9, (8, 64, 64)).cumsum(2).astype(np.uint16)
#: As they are made, since each warns that version 3 of the format does not know them.
THREE: dict[str, Any] = {
    "none": lambda: {"compressors": None},
    "zstd": lambda: {"compressors": [ZstdCodec()]},
    "zstd with a checksum": lambda: {"compressors": [ZstdCodec(checksum=True)]},
    "gzip": lambda: {"compressors": [GzipCodec()]},
    "blosc": lambda: {"compressors": [BloscCodec()]},
    "crc32c": lambda: {"compressors": [Crc32cCodec()]},
    "blosc, crc32c": lambda: {"compressors": [BloscCodec(), Crc32cCodec()]},
    "transpose, zstd": lambda: {
        "filters": [TransposeCodec(order=(2, 1, 0))], "compressors": [ZstdCodec()],
    },
    "delta, zstd": lambda: {
        "filters": [packed_by.Delta(dtype="<u2")], "compressors": [ZstdCodec()],
    },
    "shuffle, zstd": lambda: {"compressors": [packed_by.Shuffle(elementsize=2), ZstdCodec()]},
    "zlib": lambda: {"compressors": [packed_by.Zlib()]},
    "lzma": lambda: {"compressors": [packed_by.LZMA()]},
    "bz2": lambda: {"compressors": [packed_by.BZ2()]},
    "lz4": lambda: {"compressors": [packed_by.LZ4()]},
    "blosc, crc32": lambda: {"compressors": [packed_by.Blosc(), packed_by.CRC32()]},
    "blosc, crc32 at the end": lambda: {
        "compressors": [packed_by.Blosc(), packed_by.CRC32(location="end")],
    },
    "blosc, adler32": lambda: {"compressors": [packed_by.Blosc(), packed_by.Adler32()]},
    "lz4, adler32": lambda: {"compressors": [packed_by.LZ4(), packed_by.Adler32()]},
    "lz4, adler32, crc32c": lambda: {
        "compressors": [packed_by.LZ4(), packed_by.Adler32(), Crc32cCodec()],
    },
    "crc32, gzip": lambda: {"compressors": [packed_by.CRC32(), GzipCodec()]},
    "gzip, fletcher32": lambda: {"compressors": [GzipCodec(), packed_by.Fletcher32()]},
    "shard": lambda: {"compressors": None, "shards": (4, 64, 64)},
    "shard, zstd": lambda: {"compressors": [ZstdCodec()], "shards": (4, 64, 64)},
    "shard, blosc, crc32c": lambda: {
        "compressors": [BloscCodec(), Crc32cCodec()], "shards": (4, 64, 64),
    },
    "shard, blosc, crc32": lambda: {
        "compressors": [packed_by.Blosc(), packed_by.CRC32()], "shards": (4, 64, 64),
    },
}  # fmt: skip
TWO: dict[str, dict[str, Any]] = {
    "blosc": {"compressors": numcodecs.Blosc()},
    "delta, blosc": {"filters": [numcodecs.Delta("<u2")], "compressors": numcodecs.Blosc()},
    "shuffle, lzma": {"filters": [numcodecs.Shuffle(2)], "compressors": numcodecs.LZMA()},
    "crc32, bz2": {"filters": [numcodecs.CRC32()], "compressors": numcodecs.BZ2()},
    "blosc, crc32": {"filters": [numcodecs.Blosc(), numcodecs.CRC32()], "compressors": None},
    "blosc, crc32 as a packer": {
        "filters": [numcodecs.Blosc()], "compressors": numcodecs.CRC32(),
    },
    "lz4, adler32": {"filters": [numcodecs.LZ4(), numcodecs.Adler32()], "compressors": None},
}  # fmt: skip


def store_of(folder: Path, version: int = 3, **options: Any) -> Path:
    """Write the frames as a Zarr store, of pieces of one frame unless told."""
    path = folder / "rec.zarr"
    made = {"chunks": (1, 64, 64), "filters": None, **options}
    array = zarr.create_array(
        str(path), shape=FRAMES.shape, dtype=FRAMES.dtype, zarr_format=version, **made
    )
    array[:] = FRAMES
    return path


def check_reads_right(path: Path) -> None:
    """Compare every frame as it is read with what was written."""
    recording = p4d.open_recording(path)
    for number, frame in enumerate(FRAMES):
        np.testing.assert_array_equal(recording.raw_frame(number), frame)


@pytest.mark.parametrize("case", THREE)
def test_what_is_packed_well_is_read_right(case: str, tmp_path: Path) -> None:
    check_reads_right(store_of(tmp_path, **THREE[case]()))


@pytest.mark.parametrize("case", TWO)
def test_so_it_is_in_version_2(case: str, tmp_path: Path) -> None:
    check_reads_right(store_of(tmp_path, 2, **TWO[case]))


@pytest.mark.filterwarnings("ignore:Combining a `sharding_indexed` codec")
def test_checksums_around_a_shard_are_no_damage(tmp_path: Path) -> None:
    within = ShardingCodec(chunk_shape=(1, 64, 64), codecs=[BytesCodec(), BloscCodec()])
    array = zarr.create(
        store=str(tmp_path / "rec.zarr"), shape=FRAMES.shape, dtype="u2", chunks=(4, 64, 64),
        zarr_format=3, codecs=[within, packed_by.CRC32(), Crc32cCodec()],
    )  # fmt: skip
    array[:] = FRAMES
    check_reads_right(tmp_path / "rec.zarr")


def test_what_is_changed_after_packing_is_refused(tmp_path: Path) -> None:
    """Its header says nothing, so that it could hold anything."""
    path = store_of(tmp_path, compressors=[GzipCodec(), packed_by.Shuffle(elementsize=1)])
    with pytest.raises(OSError, match=r"rec\.zarr changes its pieces after packing .*\(shuffle\)"):
        p4d.open_recording(path)
