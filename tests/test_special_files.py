"""Pipes and devices in the place of files: they may have no end, and are refused at once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import zarr

import napari_phase4d as p4d
from napari_phase4d.io import open_input, open_phase
from napari_phase4d.io.results import is_result
from napari_phase4d.pipeline import result_folder, run_batch
from test_parts_beside import ome_series, virtual

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders"),
    pytest.mark.timeout(20),
]
ZERO = Path("/dev/zero")


@pytest.mark.parametrize("opened", [p4d.open_recording, open_phase])
@pytest.mark.parametrize("name", ["video.tif", "video.npy", "video.avi", "video.zarr"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_neither_pipes_nor_devices_are_opened(
    kind: str, name: str, opened: object, tmp_path: Path
) -> None:
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(ZERO)
    with pytest.raises(OSError, match=r"neither a file nor a folder"):
        opened(path)


@pytest.mark.parametrize("place", ["zarr.json", "frames/zarr.json", "frames/c/1/0/0"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_no_part_of_a_zarr_store_may_be_one(kind: str, place: str, tmp_path: Path) -> None:
    store = tmp_path / "video.zarr"
    frames = np.random.default_rng(0).integers(1, 200, (3, 32, 32)).astype(np.uint8)
    group = zarr.open_group(str(store), mode="w", zarr_format=3)
    group.create_array("frames", data=frames, chunks=(1, 32, 32))
    (store / place).unlink()
    if kind == "pipe":
        os.mkfifo(store / place)
    else:
        (store / place).symlink_to(ZERO)
    with pytest.raises(OSError, match="a pipe or a device"):
        p4d.open_recording(store).raw_frame(1)


@pytest.mark.parametrize("place", ["zarr.json", ".zarray"])
def test_nor_is_one_read_to_see_whether_it_is_a_result(place: str, tmp_path: Path) -> None:
    store = tmp_path / "video.zarr"
    store.mkdir()
    (store / place).symlink_to(ZERO)
    assert not is_result(store)
    with pytest.raises(OSError, match="a pipe or a device"):
        open_input(store)
    os.mkfifo(tmp_path / "result.ome.tif")
    assert not is_result(tmp_path / "result.ome.tif")


@pytest.mark.parametrize("ending", ["tif", "png", "npy"])
@pytest.mark.parametrize("number", [1, 2])
def test_nor_is_a_frame_of_a_folder(ending: str, number: int, tmp_path: Path) -> None:
    frame = np.random.default_rng(0).integers(1, 200, (32, 32)).astype(np.uint8)
    for i in (1, 2, 3):
        path = tmp_path / f"{i}.{ending}"
        if i == number:
            os.mkfifo(path)
        elif ending == "npy":
            np.save(path, frame)
        else:
            iio.imwrite(path, frame)
    with pytest.raises(OSError, match="a pipe or a device"):
        p4d.open_recording(tmp_path).raw_frame(number - 1)


@pytest.mark.parametrize("write", [ome_series, virtual])
def test_nor_is_a_file_that_another_names(write: Callable[[Path], Path], tmp_path: Path) -> None:
    path = write(tmp_path)
    for name in ("two.ome.tif", "source.h5"):
        if (tmp_path / name).exists():
            (tmp_path / name).unlink()
            os.mkfifo(tmp_path / name)
    with pytest.raises(OSError, match="a pipe or a device"):
        p4d.open_recording(path)


@pytest.mark.parametrize("name", ["run.json", "table.csv", "spatial-2d.ome.tif"])
def test_nor_does_a_run_wait_for_one_among_its_results(name: str, tmp_path: Path) -> None:
    """Also where an earlier run was killed after it had noted the name."""
    out = tmp_path / "out"
    out.mkdir()
    note = {"program": "napari-phase4d", "input": {}, "asked": {}, "facts": {}}
    (out / "run.json").write_text(json.dumps({**note, "files": [{"name": name}]}))
    (out / name).unlink(missing_ok=True)
    os.mkfifo(out / name)
    recipe = p4d.Recipe(methods=("spatial-2d",))
    with pytest.raises(OSError, match="is there already and was"), result_folder(out, recipe):
        pass
    assert (out / name).is_fifo()


@pytest.mark.parametrize("name", ["summary.csv", "cells.csv", "batch.log"])
def test_nor_does_a_batch(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(OSError, match="is not a file"):
        run_batch(p4d.Recipe(methods=("spatial-2d",)), [tmp_path / "a.npy"], tmp_path)


def test_windows_beyond_the_frame_are_refused() -> None:
    phase = np.zeros((1, 1, 12, 20), np.float32)
    with pytest.raises(ValueError, match="max_window is 100000000, but must be at most 20"):
        p4d.unwrap(phase, "dilate-erode", max_window=100_000_000)
