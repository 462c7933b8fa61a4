"""Frames that are being written are never misread, wherever the writing stands."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tifffile
import zarr
from numpy.typing import NDArray

from napari_phase4d.io import ArrivedFrames, Arriving, arriving_at
from napari_phase4d.io.arriving import SETTLED_S

Video = NDArray[np.uint16]


@pytest.fixture(scope="module")
def video() -> Video:
    return np.random.default_rng(5).integers(1, 4000, (4, 40, 56), dtype=np.uint16)


@pytest.fixture
def in_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take what is there for what it will be: then only what a file says tells if it is whole."""
    monkeypatch.setattr("napari_phase4d.io.arriving.SETTLED_S", 0.0)


def bytes_of(frames: Video, **how: object) -> bytes:
    held = io.BytesIO()
    with tifffile.TiffWriter(held, bigtiff=bool(how.pop("bigtiff", False))) as tif:
        for frame in frames:
            tif.write(frame, contiguous=False, metadata=None, **how)  # type: ignore[arg-type]
    return held.getvalue()


def taken(arriving: Arriving) -> list[NDArray[np.generic] | None]:
    arriving.poll()
    return [arrival.frame for arrival in arriving.take(100)]


LAYOUTS: list[dict[str, object]] = [
    {},
    {"rowsperstrip": 8},
    {"rowsperstrip": 8, "compression": "zlib"},
    {"bigtiff": True, "tile": (16, 16)},
]


@pytest.mark.usefixtures("in_no_time")
@pytest.mark.parametrize("how", LAYOUTS, ids=str)
def test_a_tiff_cut_anywhere_gives_its_whole_pages(
    video: Video, tmp_path: Path, how: dict[str, object]
) -> None:
    content, path = bytes_of(video, **how), tmp_path / "growing.tif"
    arriving = arriving_at(path, 60.0)
    found: list[NDArray[np.generic] | None] = []
    for end in [*range(0, len(content), 151), len(content)]:
        path.write_bytes(content[:end])
        found += taken(arriving)
        for frame, expected in zip(found, video, strict=False):
            np.testing.assert_array_equal(frame, expected)
    assert len(found) == len(video)


@pytest.mark.usefixtures("in_no_time")
@pytest.mark.parametrize("how", LAYOUTS, ids=str)
def test_an_image_cut_anywhere_is_waited_for(
    video: Video, tmp_path: Path, how: dict[str, object]
) -> None:
    folder = tmp_path / "camera"
    folder.mkdir()
    content = bytes_of(video[1:2], **how)
    (folder / "f0.tif").write_bytes(bytes_of(video[:1]))
    arriving = arriving_at(folder, 60.0)
    assert len(taken(arriving)) == 1
    for end in range(0, len(content) - 8, 151):
        (folder / "f1.tif").write_bytes(content[:end])
        assert taken(arriving) == []
    (folder / "f1.tif").write_bytes(content)
    (frame,) = taken(arriving)
    np.testing.assert_array_equal(frame, video[1])


def write_backwards(path: Path, content: bytes, frame: Video, look: Callable[[], None]) -> None:
    """Write pixels into a file that is as long already, from the last row to the first."""
    picture = content.rindex(frame.tobytes())
    with path.open("r+b", buffering=0) as file:
        row = frame.shape[1] * frame.itemsize
        for y in reversed(range(0, len(frame), 4)):
            file.seek(picture + y * row)
            file.write(content[picture + y * row : picture + (y + 4) * row])
            written = time.monotonic()
            for _ in range(2):
                time.sleep(SETTLED_S / 4)
                if time.monotonic() - written < 0.8 * SETTLED_S:  # else the machine held this up
                    look()


@pytest.mark.slow
@pytest.mark.parametrize("pages", [False, True])
def test_what_changes_is_not_read(video: Video, tmp_path: Path, *, pages: bool) -> None:
    path = tmp_path / "growing.tif"
    arriving = arriving_at(path if pages else tmp_path, 60.0)
    content = bytes_of(video[:2] if pages else video[:1])
    frame = video[1] if pages else video[0]
    picture = content.rindex(frame.tobytes())
    found: list[NDArray[np.generic] | None] = []
    path.write_bytes(content[:picture] + bytes(frame.nbytes) + content[picture + frame.nbytes :])

    def look() -> None:
        found.extend(taken(arriving))

    write_backwards(path, content, frame, look)
    assert len(found) == int(pages)
    time.sleep(1.5 * SETTLED_S)
    look()
    for one, expected in zip(found, video, strict=False):
        np.testing.assert_array_equal(one, expected)
    assert len(found) == 1 + int(pages)


# ---- what was given out is another by now ----------------------------------------------------


def folder_of(path: Path, frames: Video, **note: object) -> None:
    """Write a folder of frames from its first one on, as another acquisition does."""
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    for number, frame in enumerate(frames):
        tifffile.imwrite(path / f"frame_{number}.tif", frame, **note)  # type: ignore[arg-type]


def tiff_of(path: Path, frames: Video, **note: object) -> None:
    path.write_bytes(bytes_of(frames, **note))


def zarr_of(path: Path, frames: Video, **note: object) -> None:
    array = zarr.create_array(
        path, shape=frames.shape, chunks=(1, 20, 28), dtype=frames.dtype, overwrite=True
    )
    array[:] = frames
    array.attrs.update(note)


WAYS = pytest.mark.parametrize(
    ("name", "write"),
    [("camera", folder_of), ("camera.tif", tiff_of), ("camera.zarr", zarr_of)],
)


@contextmanager
def watched(path: Path, video: Video, patience_s: float = 60.0) -> Iterator[Arriving]:
    """Give what has given out all frames of a recording, which are there already."""
    arriving = arriving_at(path, patience_s)
    arriving.poll()
    time.sleep(1.5 * SETTLED_S)
    for frame, expected in zip(taken(arriving), video, strict=True):
        np.testing.assert_array_equal(frame, expected)
    try:
        yield arriving
    finally:
        arriving.close()


@pytest.mark.slow
@WAYS
def test_a_recording_that_begins_anew_is_another(
    video: Video, tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    path = tmp_path / name
    write(path, video[:2])
    with watched(path, video[:2]) as arriving:
        write(path, video[::-1])
        ends = time.monotonic() + 20
        while not arriving.begun_anew and time.monotonic() < ends:
            assert not taken(arriving)
        assert arriving.begun_anew
        assert arriving.seen == arriving.taken == 2
        assert not taken(arriving)
        assert arriving.look_back() == {0, 1}
        assert not ArrivedFrames(arriving).read(0).any()


@WAYS
def test_the_same_pixels_written_again_are_the_same_recording(
    video: Video, tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    """Some programs write a file again for each frame, or add to what it says of itself."""
    path = tmp_path / name
    write(path, video[:2])
    with watched(path, video[:2]) as arriving:
        note = "a sentence that moves the pixels to another place of the file"
        write(path, video, **({"note": note} if name.endswith("zarr") else {"description": note}))
        found, ends = list[NDArray[np.generic] | None](), time.monotonic() + 5
        while len(found) < 2 and time.monotonic() < ends:
            found += taken(arriving)
        np.testing.assert_array_equal(found, video[2:])
        assert not arriving.begun_anew
        assert arriving.look_back() == set()


@WAYS
def test_one_frame_written_over_is_noticed_at_the_end(
    video: Video, tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    path = tmp_path / name
    write(path, video)
    with watched(path, video) as arriving:
        write(path, np.concatenate([video[:2], video[:1], video[3:]]))
        time.sleep(1.5 * SETTLED_S)
        assert not taken(arriving)
        assert not arriving.begun_anew
        assert arriving.look_back() == {2}
        np.testing.assert_array_equal(ArrivedFrames(arriving).read(1), video[1])


@WAYS
def test_what_is_removed_is_noticed_at_the_end(
    video: Video, tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    """Frames that are moved away when they are whole end no recording."""
    path = tmp_path / name
    write(path, video)
    with watched(path, video) as arriving:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
        assert not taken(arriving)
        assert not arriving.begun_anew
        assert arriving.look_back() == {0, 1, 2, 3}
        assert not ArrivedFrames(arriving).read(1).any()


def large(n: int, seed: int) -> Video:
    """Return pages of several blocks whose border, as that of a covered sensor, is constant."""
    frames = np.full((n, 120, 160), 7, dtype=np.uint16)
    frames[:, 30:-30, 30:-30] = np.random.default_rng(seed).integers(1, 4000, (n, 60, 100))
    return frames


def zarr_of_pieces(path: Path, frames: Video) -> None:
    array = zarr.create_array(
        path, shape=frames.shape, chunks=(4, *frames.shape[1:]), dtype=frames.dtype, overwrite=True
    )
    array[:] = frames


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "write"),
    [("camera", folder_of), ("camera.tif", tiff_of), ("camera.zarr", zarr_of_pieces)],
)
def test_what_waits_is_not_filled_from_another_recording(
    tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    """Frames are behind when it begins anew, and nobody looks what is new any more."""
    first, other, path = large(8, 1), large(8, 2), tmp_path / name
    write(path, first)
    arriving = arriving_at(path, 60.0)
    arriving.poll()
    time.sleep(1.5 * SETTLED_S)
    arriving.poll()
    found = [arrival.frame for arrival in arriving.take(3)]
    np.testing.assert_array_equal(found, first[:3])
    write(path, other)
    time.sleep(1.5 * SETTLED_S)
    ends = time.monotonic() + 20
    while not arriving.begun_anew and time.monotonic() < ends:
        assert not arriving.take(4)
        time.sleep(0.02)
        if arriving.held:
            arriving.poll()
    assert arriving.begun_anew
    assert arriving.taken == arriving.seen == 3
    assert arriving.look_back() == {0, 1, 2}
    arriving.close()


@WAYS
def test_one_frame_of_large_ones_written_over_is_noticed(
    tmp_path: Path, name: str, write: Callable[..., None]
) -> None:
    """Nothing is said from what was read before."""
    first, path = large(6, 1), tmp_path / name
    write = zarr_of_pieces if name.endswith("zarr") else write
    write(path, first)
    with watched(path, first) as arriving:
        changed = first.copy()
        changed[4] = large(1, 3)[0]
        write(path, changed)
        assert arriving.look_back() == {4}
        assert arriving.look_back() == {4}


@pytest.mark.slow
def test_a_first_file_that_is_written_again_in_portions_is_waited_for(tmp_path: Path) -> None:
    """As one is that is copied once more: as long as it will be, its end still black."""
    first, path = large(3, 1), tmp_path / "camera"
    folder_of(path, first)
    with watched(path, first) as arriving:
        place = path / "frame_0.tif"
        content = place.read_bytes()
        place.write_bytes(content[: len(content) // 2] + bytes(len(content) - len(content) // 2))
        tifffile.imwrite(path / "frame_3.tif", first[0])
        ends = time.monotonic() + 1.5
        while time.monotonic() < ends:
            assert not taken(arriving)
        assert arriving.held
        assert not arriving.begun_anew
        place.write_bytes(content)
        found, ends = list[NDArray[np.generic] | None](), time.monotonic() + 5
        while not found and time.monotonic() < ends:
            found += taken(arriving)
        np.testing.assert_array_equal(found, first[:1])
        assert arriving.look_back() == set()


@pytest.mark.slow
def test_a_first_file_that_changes_for_ever_stops_nothing(tmp_path: Path) -> None:
    """A program may write what the camera sees now under the first name."""
    first, path = large(4, 1), tmp_path / "camera"
    folder_of(path, first)
    with watched(path, first, 2.0) as arriving:
        tifffile.imwrite(path / "frame_4.tif", first[2])
        found, ends = list[NDArray[np.generic] | None](), time.monotonic() + 10
        number = 10
        while not found and time.monotonic() < ends:
            tifffile.imwrite(path / "frame_0.tif", large(1, number)[0])
            number += 1
            found += taken(arriving)
        np.testing.assert_array_equal(found, first[2:3])


@pytest.mark.slow
def test_a_folder_that_fails_at_the_end_costs_no_result(
    video: Video, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that does not answer is no reason to give up what came."""
    folder_of(tmp_path / "camera", video)
    with watched(tmp_path / "camera", video) as arriving:
        loop = tmp_path / "loop"
        loop.symlink_to(loop)
        monkeypatch.setattr(arriving, "_files", dict.fromkeys(range(4), loop / "frame.tif"))
        monkeypatch.setattr(arriving, "path", loop)
        for _ in range(3):
            assert not taken(arriving)
        assert len(arriving.notes) == 1
        assert "loop can't be looked at" in arriving.notes[0]
        assert arriving.look_back() == {0, 1, 2, 3}
        assert not ArrivedFrames(arriving).read(2).any()
