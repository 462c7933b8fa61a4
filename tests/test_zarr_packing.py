"""How Zarr packs its pieces: whatever is packed well is read right, what would burst is not."""

from __future__ import annotations

import bz2
import gc
import gzip
import lzma
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import psutil
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
from napari_phase4d.io import zarr_packing

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


@pytest.mark.slow
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


@pytest.mark.parametrize("place", ["start", "end"])
@pytest.mark.parametrize("order", ["little", "big"])
def test_wherever_a_shard_lists_its_pieces_they_are_looked_at(
    order: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zarr_packing, "HARMLESS", 2**16)
    within = ShardingCodec(
        chunk_shape=(1, 64, 64), codecs=[BytesCodec(), GzipCodec()],
        index_codecs=[BytesCodec(endian=order)], index_location=place,
    )  # fmt: skip
    array = zarr.create(
        store=str(tmp_path / "rec.zarr"), shape=FRAMES.shape, dtype="u2", chunks=(4, 64, 64),
        zarr_format=3, codecs=[within],
    )  # fmt: skip
    array[:] = FRAMES
    check_reads_right(tmp_path / "rec.zarr")
    shard = tmp_path / "rec.zarr" / "c" / "0" / "0" / "0"
    packed, entry = shard.read_bytes(), {"little": "<u8", "big": ">u8"}[order]
    at = 0 if place == "start" else len(packed) - 64
    listed = np.frombuffer(packed[at : at + 64], entry).reshape(4, 2).copy()
    for begins, holds, expected in (
        (len(packed) if place == "start" else at, ZEROS, "would unpack to more than 8192 bytes"),
        (2 * len(packed), b"", "its piece 0 is cut short"),
    ):
        listed[1] = begins, len(ZEROS)
        if place == "start":
            shard.write_bytes(listed.tobytes() + packed[64:] + holds)
        else:
            shard.write_bytes(packed[:at] + holds + listed.tobytes())
        with pytest.raises(OSError, match=expected):
            p4d.open_recording(tmp_path / "rec.zarr").raw_frame(1)


def test_a_shard_within_a_shard_is_refused(tmp_path: Path) -> None:
    """Where its pieces lie is listed in each shard of the shard, and never looked at."""
    packed = ShardingCodec(chunk_shape=(1, 64, 64), codecs=[BytesCodec(), GzipCodec()])
    within = ShardingCodec(chunk_shape=(2, 64, 64), codecs=[packed])
    zarr.create(
        store=str(tmp_path / "rec.zarr"), shape=FRAMES.shape, dtype="u2", chunks=(4, 64, 64),
        zarr_format=3, codecs=[within],
    )  # fmt: skip
    with pytest.raises(OSError, match=r"packs its pieces more than once \(shardingcodec\)"):
        p4d.open_recording(tmp_path / "rec.zarr")


def test_what_is_changed_after_packing_is_refused(tmp_path: Path) -> None:
    """Its header says nothing, so that it could hold anything."""
    path = store_of(tmp_path, compressors=[GzipCodec(), packed_by.Shuffle(elementsize=1)])
    with pytest.raises(OSError, match=r"rec\.zarr changes its pieces after packing .*\(shuffle\)"):
        p4d.open_recording(path)


def zstd_frame(n_blocks: int) -> bytes:
    """Return a frame that does not say that it holds so many times 128 KiB of zeros (RFC 8878)."""
    block = (2**17 << 3 | 1 << 1).to_bytes(3, "little") + b"\0"  # one byte, repeated
    last = (2**17 << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    return b"\x28\xb5\x2f\xfd\0\x58" + block * (n_blocks - 1) + last


SKIPPED = bytes.fromhex("502a4d18 04000000 00000000")
SAID = bytes(numcodecs.Zstd().encode(np.zeros(2**20, np.uint8)))
FEW = bytes(numcodecs.Zstd().encode(np.zeros(9, np.uint8)))
ZEROS = gzip.compress(bytes(2**20), 9)
#: What holds far more than the 8192 bytes of a frame, some of it behind what holds few.
BURSTING: dict[str, tuple[Any, bytes]] = {
    "zstd, not said": (ZstdCodec(), zstd_frame(8)),
    "zstd, skipped first": (ZstdCodec(), SKIPPED + SAID),
    "zstd, skipped first, not said": (ZstdCodec(), SKIPPED + zstd_frame(8)),
    "zstd, said behind few": (ZstdCodec(), FEW + SAID),
    "zstd, not said behind few": (ZstdCodec(), FEW + zstd_frame(8)),
    "gzip, behind few": (GzipCodec(), gzip.compress(b"few") + ZEROS),
    "gzip, behind zeros": (GzipCodec(), gzip.compress(b"few") + bytes(2**15) + ZEROS),
    "bz2, behind few": (packed_by.BZ2, bz2.compress(b"few") + bz2.compress(bytes(2**20))),
    "lzma, behind few": (packed_by.LZMA, lzma.compress(b"few") + lzma.compress(bytes(2**20))),
}


@pytest.mark.parametrize("case", BURSTING)
def test_a_piece_that_does_not_say_what_it_holds_is_looked_into(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.io.zarr_packing.HARMLESS", 2**16)
    codec, piece = BURSTING[case]
    path = store_of(tmp_path, compressors=[codec() if isinstance(codec, type) else codec])
    (path / "c" / "3" / "0" / "0").write_bytes(piece)
    with pytest.raises(OSError, match="its piece 0 would unpack to more than 8192 bytes"):
        p4d.open_recording(path).raw_frame(3)


@pytest.mark.parametrize("skipped", [b"", SKIPPED])
@pytest.mark.parametrize("said", [True, False])
def test_zstandard_is_read_however_it_is_written(
    said: bool, skipped: bytes, tmp_path: Path
) -> None:
    """Some programs write as a stream, and don't know the size when they begin."""
    path = store_of(tmp_path, compressors=[ZstdCodec()])
    piece = path / "c" / "3" / "0" / "0"
    packed = numcodecs.Zstd().encode(FRAMES[3].tobytes())
    if not said:  # blocks as they are, in a frame that says no size
        raw = (8192 << 3 | 1).to_bytes(3, "little") + FRAMES[3].tobytes()
        packed = b"\x28\xb5\x2f\xfd\0\x58" + raw
    piece.write_bytes(skipped + packed)
    check_reads_right(path)


def test_what_zarr_python_writes_says_its_size(tmp_path: Path) -> None:
    """So that none of it is unpacked twice."""
    for version in (2, 3):
        folder = tmp_path / str(version)
        packer = ZstdCodec() if version == 3 else numcodecs.Zstd()
        path = store_of(folder, version, compressors=[packer])
        pieces = [f for f in path.rglob("*") if f.is_file() and "z" not in f.name]
        assert len(pieces) == len(FRAMES)
        assert [zarr_packing.zstd_said(f.read_bytes()) for f in pieces] == [8192] * len(FRAMES)


@pytest.mark.parametrize("version", [2, 3])
def test_lzma_of_other_forms_is_read(
    version: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a header there is nothing to know its form by but what the store says."""
    monkeypatch.setattr("napari_phase4d.io.zarr_packing.HARMLESS", 2**10)
    form = {"format": lzma.FORMAT_RAW, "filters": [{"id": lzma.FILTER_LZMA2, "preset": 1}]}
    packer = packed_by.LZMA(**form) if version == 3 else numcodecs.LZMA(**form)
    check_reads_right(store_of(tmp_path, version, compressors=packer))


@pytest.mark.parametrize("shards", [None, (8, 64, 64)])
@pytest.mark.parametrize("packed", [True, False])
def test_pieces_are_looked_at_once(
    packed: bool, shards: tuple | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame of a shard looked at the pieces of all others."""
    looked: list[int] = []
    look = zarr_packing.unpacked_bytes
    monkeypatch.setattr(
        zarr_packing, "unpacked_bytes", lambda *args: looked.append(args[1]) or look(*args)
    )
    path = store_of(tmp_path, compressors=GzipCodec() if packed else None, shards=shards)
    recording = p4d.open_recording(path)
    for _ in range(2):
        for number, frame in enumerate(FRAMES):
            np.testing.assert_array_equal(recording.raw_frame(number), frame)
    assert len(looked) == (len(FRAMES) if packed else 0)


def test_a_piece_that_has_changed_is_looked_at_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zarr_packing, "HARMLESS", 2**16)
    path = store_of(tmp_path, compressors=GzipCodec())
    recording = p4d.open_recording(path)
    recording.raw_frame(3)
    (path / "c" / "3" / "0" / "0").write_bytes(ZEROS)
    recording.raw_frame(4)
    with pytest.raises(OSError, match="would unpack to more than 8192 bytes"):
        recording.raw_frame(3)


def test_not_all_that_was_looked_at_is_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zarr_packing, "MOST_NOTED", 3)
    path = store_of(tmp_path, compressors=GzipCodec())
    pieces = zarr_packing.Pieces(zarr.open_array(str(path), mode="r"))
    opened: list[Path] = []
    for _ in range(2):
        for file in sorted((path / "c").glob("*/0/0")):
            opening = lambda file=file: opened.append(file) or file.open("rb")  # noqa: E731
            pieces.check(opening, file.stat().st_size, "0", (file,))
    assert len(opened) == 2 * len(FRAMES)


def zipped(path: Path, method: int = zipfile.ZIP_STORED) -> Path:
    """Return a folder as a zip beside it."""
    target = path.with_name("rec.zarr.zip")
    with zipfile.ZipFile(target, "w", method) as archive:
        for file in path.rglob("*"):
            archive.write(file, file.relative_to(path))
    return target


@pytest.mark.slow
def test_a_zipped_store_is_closed_with_its_recording(tmp_path: Path) -> None:
    """On Windows an open file can be neither moved nor removed."""
    path = zipped(store_of(tmp_path, compressors=GzipCodec()))
    recording = p4d.open_recording(path)
    recording.raw_frame(3)

    def is_open() -> bool:
        return str(path) in [file.path for file in psutil.Process().open_files()]

    assert is_open()
    del recording
    gc.collect()
    assert not is_open()


METHODS = {
    "deflated": zipfile.ZIP_DEFLATED, "bzip2": zipfile.ZIP_BZIP2, "lzma": zipfile.ZIP_LZMA,
}  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["none", "gzip", "zstd", "shard, zstd"])
def test_what_a_zip_packs_is_read_right(
    case: str, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zarr_packing, "HARMLESS", 2**10)
    check_reads_right(zipped(store_of(tmp_path, **THREE[case]()), METHODS[method]))


@pytest.mark.parametrize("true", [True, False])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shards", [None, (4, 64, 64)])
def test_what_a_zip_packs_holds_no_more_than_it_may(
    shards: tuple | None, method: str, true: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the zip says that it were little, which Python looks at when all is unpacked."""
    monkeypatch.setattr(zarr_packing, "HARMLESS", 2**16)
    path = store_of(tmp_path, compressors=None, shards=shards)
    piece = path / "c" / "0" / "0" / "0"
    written = piece.read_bytes()
    piece.write_bytes(written + bytes(2**20))
    store = zipped(path, METHODS[method])
    if not true:
        sizes = [len(written).to_bytes(4, "little"), piece.stat().st_size.to_bytes(4, "little")]
        store.write_bytes(store.read_bytes().replace(sizes[1], sizes[0]))
        with zipfile.ZipFile(store) as archive:
            assert archive.getinfo("c/0/0/0").file_size == len(written)
    with pytest.raises(OSError, match=f"unpack to more than {8192 * (4 if shards else 1)} bytes"):
        p4d.open_recording(store).raw_frame(0)
