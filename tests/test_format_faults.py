"""Files that change, lie or mean harm: one sentence, bounded memory, nothing executed."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from format_writers import film, noise, raw, zarr_array
from napari_phase4d.io import RawLayout
from napari_phase4d.io.lazy import MappedFrames

FRAMES = noise(24, (96, 128), np.uint16)
RAW = {"raw": RawLayout(96, 128, "uint16", ">", header_bytes=100, gap_bytes=12)}


def as_npy(folder: Path) -> Path:
    np.save(folder / "rec.npy", FRAMES)
    return folder / "rec.npy"


def as_tiff(folder: Path) -> Path:
    tifffile.imwrite(folder / "rec.tif", FRAMES, photometric="minisblack")
    return folder / "rec.tif"


MAPPED = {"npy": (as_npy, {}), "tiff": (as_tiff, {}), "raw": (lambda f: raw(f, FRAMES), RAW)}


@pytest.mark.parametrize("kind", MAPPED)
@pytest.mark.parametrize("change", ["shorter", "anew", "gone", "longer"])
def test_mapped_file_that_changes_while_it_is_read(tmp_path: Path, kind: str, change: str) -> None:
    """Touching a mapped file behind its end would end the program."""
    write, options = MAPPED[kind]
    path = write(tmp_path)
    rec = p4d.open_recording(path, **options)
    np.testing.assert_array_equal(rec.raw_frame(20), FRAMES[20])
    if change == "gone":
        path.unlink()
    elif change == "shorter":
        os.truncate(path, 50_000)
    elif change == "anew":
        os.utime(path, ns=(0, 0))
    else:
        with path.open("ab") as file:
            file.write(b"more")
        np.testing.assert_array_equal(rec.raw_frame(20), FRAMES[20])
        return
    said = {"shorter": "became shorter", "anew": "was written anew", "gone": "is gone"}[change]
    with pytest.raises(OSError, match=f"frame 20 of {path.name} can't be read: the file {said}"):
        rec.raw_frame(20)
    with pytest.raises(OSError, match=said):
        rec.holograms.data[20]  # as the viewer reads it


@pytest.mark.parametrize("kind", MAPPED)
def test_other_processes_map_the_file_themselves(tmp_path: Path, kind: str) -> None:
    write, options = MAPPED[kind]
    frames = p4d.open_recording(write(tmp_path), **options).holograms.data
    assert isinstance(frames, MappedFrames)
    for part, expected in ((frames, FRAMES), (frames[5:9, 3:, ::2], FRAMES[5:9, 3:, ::2])):
        sent = pickle.dumps(part)
        assert len(sent) < 1000
        again = pickle.loads(sent)
        assert isinstance(again, MappedFrames)
        np.testing.assert_array_equal(again, expected)
    total = frames.astype(np.float32) + 1  # a result lies in memory
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(total)), FRAMES + np.float32(1))


def as_hdf5(folder: Path) -> Path:
    with h5py.File(folder / "rec.h5", "w") as file:
        file.create_dataset("frames", data=FRAMES, chunks=(1, 96, 128), compression="gzip")
    return folder / "rec.h5"


def as_film(folder: Path) -> Path:
    return film(".mkv", "ffv1", "gray16le", {"g": "1"})(folder, FRAMES)


STREAMED: dict[str, Callable[[Path], Path]] = {
    "zarr": lambda folder: zarr_array(3)(folder, FRAMES), "hdf5": as_hdf5, "film": as_film
}  # fmt: skip


@pytest.mark.parametrize("kind", STREAMED)
def test_file_that_is_overwritten_while_it_is_read(tmp_path: Path, kind: str) -> None:
    path = STREAMED[kind](tmp_path)
    rec = p4d.open_recording(path)
    rec.raw_frame(0)
    if path.is_dir():
        shutil.rmtree(path / "c")
    else:
        size = path.stat().st_size
        path.write_bytes(bytes(size))
    with pytest.raises(OSError, match=rf"frame 20 of {path.name} can't be read") as caught:
        rec.raw_frame(20)
    assert "\n" not in str(caught.value)


def places_of_packets(path: Path) -> list[int]:
    import av

    with av.open(str(path)) as container:
        return [packet.pos for packet in container.demux(video=0) if packet.size]


def test_film_with_one_damaged_frame(tmp_path: Path) -> None:
    """The frame is named; the others are still there."""
    frames = noise(24, (48, 64), np.uint8)
    path = film(".mov", "png", "gray")(tmp_path, frames)
    whole = bytearray(path.read_bytes())
    place = places_of_packets(path)[12] + 1000
    whole[place : place + 40] = bytes(40)
    path.write_bytes(whole)
    rec = p4d.open_recording(path)
    with pytest.raises(OSError, match=r"frame 12 of rec\.mov can't be read"):
        rec.raw_frame(12)
    for index in (11, 13, 23, 0):
        np.testing.assert_array_equal(rec.raw_frame(index), frames[index])


def test_film_with_a_lost_frame(tmp_path: Path) -> None:
    """The others keep their times, and it is said."""
    path = as_film(tmp_path)
    whole = bytearray(path.read_bytes())
    place = places_of_packets(path)[12]
    whole[place : place + 40] = bytes(40)
    path.write_bytes(whole)
    rec = p4d.open_recording(path)
    left = [i for i in range(24) if i != 12]
    np.testing.assert_array_equal(rec.holograms.values, FRAMES[left])
    np.testing.assert_allclose(rec.times_s, np.array(left) * 0.125)
    assert any("1 frames seem to be missing, the first behind frame 11" in n for n in rec.notes)


@pytest.mark.parametrize("told", [0, 5, 100])
def test_film_whose_header_lies(tmp_path: Path, told: int) -> None:
    frames = noise(24, (48, 64), np.uint8)
    path = film(".avi", "rawvideo", "gray")(tmp_path, frames)
    whole = bytearray(path.read_bytes())
    place = whole.index(b"strh") + 8 + 32
    assert struct.unpack("<I", whole[place : place + 4]) == (24,)
    whole[place : place + 4] = struct.pack("<I", told)
    path.write_bytes(whole)
    rec = p4d.open_recording(path)
    np.testing.assert_array_equal(rec.holograms.values, frames)
    assert any(f"tells of {told} frames" in note for note in rec.notes) == (told > 0)


def test_film_without_its_list_of_frames(tmp_path: Path) -> None:
    frames = noise(24, (48, 64), np.uint8)
    path = film(".avi", "rawvideo", "gray")(tmp_path, frames)
    path.write_bytes(path.read_bytes().replace(b"idx1", b"JUNK"))
    rec = p4d.open_recording(path)
    assert rec.n_frames == 24
    for index in (23, 0, 11):
        np.testing.assert_array_equal(rec.raw_frame(index), frames[index])


def test_film_is_not_searched_for_each_next_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from napari_phase4d.io.films import FilmReader

    searched = []
    search = FilmReader._search
    monkeypatch.setattr(FilmReader, "_search", lambda s, n: searched.append(n) or search(s, n))
    path = film(".mp4", "libx264", "yuv420p", {"g": "6"})(tmp_path, noise(60, (96, 128), np.uint8))
    rec = p4d.open_recording(path)
    for index in range(60):
        rec.raw_frame(index)
    for index in (58, 59, 57, 56, 55):  # as threads ask
        rec.raw_frame(index)
    assert searched == [0]


def test_film_in_colour(tmp_path: Path) -> None:
    import av

    red = np.zeros((32, 32, 3), np.uint8)
    red[..., 0] = 200
    for codec, pixels in (("png", "rgb24"), ("libx264", "yuv444p")):
        path = tmp_path / "a.mov"
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=5)
            stream.height, stream.width, stream.pix_fmt = 32, 32, pixels
            for _ in range(3):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(red, format="rgb24")))
            container.mux(stream.encode(None))
        if pixels == "rgb24":
            with pytest.raises(ValueError, match=r"a\.mov is in colour"):
                p4d.open_recording(path)
        else:
            notes = p4d.open_recording(path).notes
            assert any("The film is in colour; its brightness is used." in n for n in notes)


def bomb(folder: Path) -> object:
    class Bomb:
        def __reduce__(self) -> tuple:
            return (os.mkdir, (str(folder / "exploded"),))

    return Bomb()


@pytest.mark.parametrize("place", ["filters", "compressor"])
def test_zarr_that_would_run_code(tmp_path: Path, place: str) -> None:
    path = tmp_path / "rec.zarr"
    path.mkdir()
    head = {
        "zarr_format": 2, "shape": [2, 16, 16], "chunks": [1, 16, 16], "dtype": "<u2",
        "fill_value": 0, "order": "C", "filters": None, "compressor": None,
    }  # fmt: skip
    pickling = {"id": "pickle", "protocol": 5}
    head[place] = [pickling] if place == "filters" else pickling
    (path / ".zarray").write_text(json.dumps(head))
    for i in range(2):
        (path / f"{i}.0.0").write_bytes(pickle.dumps(bomb(tmp_path)))
    with pytest.raises(OSError, match=r"never loaded|rec\.zarr can't be read"):
        p4d.open_recording(path)
    assert not (tmp_path / "exploded").exists()


def test_hdf5_that_leads_to_other_files(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(2 * 16 * 16))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("frames", (2, 16, 16), "u1", external=[(str(secret), 0, 512)])
        file["link"] = h5py.ExternalLink("/etc/other.h5", "/frames")
    with pytest.raises(OSError, match="keeps '/frames' in other files, which are not followed"):
        p4d.open_recording(tmp_path / "a.h5")


def test_hdf5_joined_of_files(tmp_path: Path) -> None:
    for i in range(2):
        with h5py.File(tmp_path / f"{i}.h5", "w") as file:
            file["data"] = FRAMES[12 * i : 12 * i + 12]
    layout = h5py.VirtualLayout(FRAMES.shape, "u2")
    for i in range(2):
        layout[12 * i : 12 * i + 12] = h5py.VirtualSource(f"{i}.h5", "data", (12, 96, 128))
    with h5py.File(tmp_path / "all.h5", "w") as file:
        file.create_virtual_dataset("data", layout)
    rec = p4d.open_recording(tmp_path / "all.h5")
    np.testing.assert_array_equal(rec.raw_frame(13), FRAMES[13])
    (tmp_path / "1.h5").unlink()
    with pytest.raises(OSError, match=r"all\.h5 needs 1\.h5, which is not there"):
        p4d.open_recording(tmp_path / "all.h5")


def absurd_npz(path: Path, *, lying: bool) -> Path:
    """An array of 2 TB: said to be in few bytes, or packed as zeros into few."""
    head = io.BytesIO()
    shape = (2**20, 2**10, 2**10)
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<u2", "fortran_order": False, "shape": shape}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("holograms.npy", head.getvalue() + bytes(100))
    if not lying:
        whole = bytearray(path.read_bytes())
        place = whole.rindex(b"PK\x01\x02") + 24  # the size in the list of files
        whole[place : place + 4] = struct.pack("<I", 2**32 - 2)
        path.write_bytes(whole)
    return path


def absurd_png(path: Path) -> Path:
    def part(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0)
    body = zlib.compress(bytes(10_000))
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", body) + part(b"IEND", b"")
    )
    return path


def absurd_npy(path: Path) -> Path:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<u2", "fortran_order": False, "shape": (2**40, 2**10, 2**10)}
        )
        file.write(bytes(1000))
    return path


def absurd_tiff(path: Path) -> Path:
    """One packed page whose size was changed to 200000 x 200000."""
    tifffile.imwrite(path, np.zeros((4, 300, 301), np.uint8), compression="zlib",
                     photometric="minisblack", metadata=None)  # fmt: skip
    whole = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tif:
        for page in tif.pages:
            for code in (256, 257, 278):
                tag = page.aspage().tags[code]
                whole[tag.valueoffset : tag.valueoffset + 4] = struct.pack("<I", 200_000)
                whole[tag.offset + 2 : tag.offset + 4] = struct.pack("<H", 4)
    path.write_bytes(whole)
    return path


def absurd_hdf5(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        data = file.create_dataset("frames", (100, 40_000, 40_000), "u2",
                                   chunks=(1, 40_000, 40_000), compression="gzip")  # fmt: skip
        data.id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(100)))
    return path


def absurd_zarr(path: Path) -> Path:
    path.mkdir()
    head = {
        "zarr_format": 2, "shape": [10, 10**6, 10**6], "chunks": [1, 10**6, 10**6],
        "dtype": "<u2", "fill_value": 0, "order": "C", "filters": None, "compressor": None,
    }  # fmt: skip
    (path / ".zarray").write_text(json.dumps(head))
    return path


ABSURD = {
    "npz, lying": (lambda f: absurd_npz(f / "a.npz", lying=True), "but holds less"),
    "npz, packed": (lambda f: absurd_npz(f / "a.npz", lying=False), "holds less|GB"),
    "png": (lambda f: absurd_png(f / "a.png"), "more than so small a file|can't be read"),
    "npy": (lambda f: absurd_npy(f / "a.npy"), "can't be read as a NumPy file"),
    "tiff": (lambda f: absurd_tiff(f / "a.tif"), "GB, but"),
    "hdf5": (lambda f: absurd_hdf5(f / "a.h5"), "in pieces of 3.0 GB"),
    "zarr": (lambda f: absurd_zarr(f / "a.zarr"), "in pieces of"),
}


@pytest.mark.parametrize("case", ABSURD)
def test_absurd_sizes_take_no_memory(tmp_path: Path, case: str) -> None:
    make, sentence = ABSURD[case]
    path = make(tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises((OSError, ValueError), match=sentence) as caught:
            p4d.open_recording(path).raw_frame(0)
        assert tracemalloc.get_traced_memory()[1] < 5e7
    finally:
        tracemalloc.stop()
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path: Path) -> None:
    path = as_npy(tmp_path)
    path.chmod(0)
    with pytest.raises(OSError, match=r"rec\.npy can't be read"):
        p4d.open_recording(path)
