"""Pipes and devices in the place of files: they may have no end, and are refused at once."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import zarr

import napari_phase4d as p4d
from napari_phase4d.io import open_phase

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


def test_windows_beyond_the_frame_are_refused() -> None:
    phase = np.zeros((1, 1, 12, 20), np.float32)
    with pytest.raises(ValueError, match="max_window is 100000000, but must be at most 20"):
        p4d.unwrap(phase, "dilate-erode", max_window=100_000_000)
