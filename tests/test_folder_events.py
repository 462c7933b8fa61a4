"""What the system tells of a folder: frames are read when they are closed, and none is missed."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from napari_phase4d.io import Arriving, arriving_at, growing
from napari_phase4d.io.arriving import SETTLED_S

linux = pytest.mark.skipif(sys.platform != "linux", reason="no other system tells it")


@pytest.fixture
def frames() -> NDArray[np.uint16]:
    return np.random.default_rng(7).integers(1, 4000, (6, 24, 32), dtype=np.uint16)


@pytest.fixture
def only_what_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take no file for whole because it has stayed as it is."""
    monkeypatch.setattr("napari_phase4d.io.arriving.SETTLED_S", 3600.0)


@pytest.fixture
def arriving(tmp_path: Path) -> Iterator[Arriving]:
    (tmp_path / "camera").mkdir()
    arriving = arriving_at(tmp_path / "camera", 60.0)
    arriving.poll()
    yield arriving
    arriving.close()


def taken(arriving: Arriving) -> list[NDArray[np.generic] | None]:
    arriving.poll()
    return [arrival.frame for arrival in arriving.take(100)]


@linux
@pytest.mark.usefixtures("only_what_is_told")
def test_a_frame_is_read_when_it_is_closed(arriving, frames, tmp_path: Path) -> None:
    folder = arriving.path
    for number, frame in enumerate(frames[:3]):
        tifffile.imwrite(folder / f"f{number}.tif", frame)
        (found,) = taken(arriving)
        np.testing.assert_array_equal(found, frame)
    # One that is written elsewhere and moved here is whole.
    tifffile.imwrite(tmp_path / "elsewhere.tif", frames[3])
    (tmp_path / "elsewhere.tif").rename(folder / "f3.tif")
    (found,) = taken(arriving)
    np.testing.assert_array_equal(found, frames[3])
    # Nor is one that had another name until it was.
    tifffile.imwrite(folder / "new.tif", frames[4])
    assert taken(arriving) == []
    (folder / "new.tif").rename(folder / "f4.tif")
    (found,) = taken(arriving)
    np.testing.assert_array_equal(found, frames[4])
    assert not arriving.notes


@linux
@pytest.mark.usefixtures("only_what_is_told")
def test_what_is_open_is_not_read_whole_as_it_looks(arriving, frames, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "elsewhere.tif", frames[0])
    content = (tmp_path / "elsewhere.tif").read_bytes()
    path = arriving.path / "f0.tif"
    with path.open("wb", buffering=0) as file:
        file.write(content)
        assert taken(arriving) == []
    # It is opened again before it has been read.
    with path.open("r+b", buffering=0) as file:
        file.seek(content.rindex(frames[0].tobytes()))
        file.write(frames[1].tobytes())
        assert taken(arriving) == []
    (found,) = taken(arriving)
    np.testing.assert_array_equal(found, frames[1])


@linux
def test_of_more_events_than_the_system_keeps_no_frame_is_missed(arriving, frames) -> None:
    tifffile.imwrite(arriving.path / "f0.tif", frames[0])
    assert len(taken(arriving)) == 1
    limit = int(Path("/proc/sys/fs/inotify/max_queued_events").read_text())
    others = [(arriving.path / name).open("wb", buffering=0) for name in ("a.log", "b.log")]
    for number in range(limit + 10):  # the same one twice would be one event
        others[number % 2].write(b".")
    for other in others:
        other.close()
    for number in (1, 2):
        tifffile.imwrite(arriving.path / f"f{number}.tif", frames[number])
    assert taken(arriving) == []
    time.sleep(1.5 * SETTLED_S)
    assert len(taken(arriving)) == 2
    tifffile.imwrite(arriving.path / "f3.tif", frames[3])
    assert len(taken(arriving)) == 1


@pytest.mark.slow
@linux
def test_a_large_folder_is_not_looked_through_for_each_frame(
    arriving, frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[float] = []
    scan = os.scandir

    def scandir(path: Path) -> object:
        looks.append(time.monotonic())
        return scan(path)

    monkeypatch.setattr(growing.os, "scandir", scandir)
    began = time.monotonic()
    for number in range(200):
        tifffile.imwrite(arriving.path / f"f{number:03}.tif", frames[0])
        assert len(taken(arriving)) == 1
    assert len(looks) <= 5 + (time.monotonic() - began) / growing.SCAN_S


@linux
@pytest.mark.usefixtures("only_what_is_told")
def test_what_comes_just_after_a_look_is_not_missed(
    arriving, frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(2):
        tifffile.imwrite(arriving.path / f"f{number}.tif", frames[number])
        assert len(taken(arriving)) == 1
    scan = os.scandir

    @contextmanager
    def scandir(path: Path) -> Iterator[list[os.DirEntry[str]]]:
        with scan(path) as entries:
            found = list(entries)
        if not (path / "f3.tif").exists():
            tifffile.imwrite(path / "f3.tif", frames[3])
        yield found

    monkeypatch.setattr(growing.os, "scandir", scandir)
    tifffile.imwrite(arriving.path / "f2.tif", frames[2])
    arriving._next_scan = 0.0
    arriving.poll()
    arriving.poll()
    assert len(taken(arriving)) == 2


@pytest.mark.slow
@linux
def test_what_was_not_told_is_looked_for_before_it_is_given_up(frames, tmp_path: Path) -> None:
    arriving = arriving_at(tmp_path, 0.5)
    arriving.poll()
    for number in range(2):
        tifffile.imwrite(tmp_path / f"f{number}.tif", frames[number])
        assert len(taken(arriving)) == 1
    tifffile.imwrite(tmp_path / "f2.tif", frames[2])
    arriving._events.news()  # as if it were never told
    arriving._next_scan = math.inf
    tifffile.imwrite(tmp_path / "f3.tif", frames[3])
    arriving.poll()
    time.sleep(0.6)  # a long piece of work: it is due to be given up
    found = [arrival.frame for arrival in arriving.take(2)]
    time.sleep(1.5 * SETTLED_S)
    found += taken(arriving)
    np.testing.assert_array_equal(found, frames[2:4])
    assert not arriving.lost
    arriving.close()


@pytest.mark.slow
def test_where_nothing_is_told_all_is_found(
    frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(folder: Path) -> object:
        raise OSError(folder)

    monkeypatch.setattr(growing, "FolderEvents", nothing)
    arriving = arriving_at(tmp_path, 60.0)
    for number, frame in enumerate(frames):
        tifffile.imwrite(tmp_path / f"f{number}.tif", frame)
        assert taken(arriving) == []
        time.sleep(1.5 * SETTLED_S)
        (found,) = taken(arriving)
        np.testing.assert_array_equal(found, frame)


@pytest.mark.slow
def test_what_is_not_told_is_found_all_the_same(
    frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where another machine writes into a folder of a server, beside this one."""
    monkeypatch.setattr(growing, "SCAN_S", 0.2)
    arriving = arriving_at(tmp_path, 60.0)
    for number in (0, 1):
        tifffile.imwrite(tmp_path / f"f{number}.tif", frames[number])
        arriving.poll()
        time.sleep(1.5 * SETTLED_S)
        assert len(taken(arriving)) == 1
    if arriving._events is not None:
        monkeypatch.setattr(arriving._events, "_events", lambda: iter(()))
    for number in (2, 3):
        tifffile.imwrite(tmp_path / f"f{number}.tif", frames[number])
        time.sleep(0.25)
        arriving.poll()
        time.sleep(1.5 * SETTLED_S)
        assert len(taken(arriving)) == 1
    arriving.close()
