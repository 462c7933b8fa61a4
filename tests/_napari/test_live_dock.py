"""Phase on screen while a recording is written, by clicks."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from driving import LEFT
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QPushButton

import napari_phase4d as p4d
from napari_phase4d.io import read_results

pytestmark = pytest.mark.gui
N = 48


@pytest.fixture
def live(viewer: Any) -> Any:
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D live")
    return dock


@pytest.fixture
def frames() -> np.ndarray:
    exact = p4d.simulation.swimming_euglena((128, 128), N, pixel_um=0.35, peak_rad=6)
    return p4d.simulation.multiplexed_video(exact["phase"]).holograms.values


def press(live: Any) -> None:
    QTest.mouseClick(live.findChild(QPushButton, "live_go"), LEFT)


@pytest.mark.slow
def test_frames_are_shown_as_they_come_and_written(
    viewer: Any, live: Any, qtbot: Any, frames: np.ndarray, tmp_path: Path
) -> None:
    folder = tmp_path / "cell"
    folder.mkdir()
    seen: list[int] = []

    def camera() -> None:
        for number, frame in enumerate(frames):
            tifffile.imwrite(folder / f"frame_{number:04}.tif", frame)
            time.sleep(0.15)

    live.fields["source"].setText(str(folder))
    live.fields["angles"].setText("-7, 21")
    press(live)
    assert live.go.text() == "Stop"
    player = threading.Thread(target=camera)
    player.start()

    def last_is_shown() -> bool:
        if live.shown >= 0 and live.shown not in seen:
            seen.append(live.shown)
            shown.append(np.asarray(live.layer.data).copy())
        return live.shown == N - 1

    shown: list[np.ndarray] = []
    qtbot.waitUntil(last_is_shown, timeout=60_000)
    player.join()
    assert len(seen) > 3
    assert seen == sorted(seen)
    press(live)
    qtbot.waitUntil(lambda: live.watching is None, timeout=60_000)
    assert "Results are in" in live.told.text()
    assert f"{N} frames seen, {N} done, 0 behind, 0 dropped" in live.status.text()
    written = read_results(tmp_path / "cell_phase" / "temporal-angular.ome.zarr")
    assert written.sizes["time"] == N
    assert written["angle"].values.tolist() == [-7, 21]
    for index, picture in zip(seen, shown, strict=True):
        np.testing.assert_array_equal(picture[0], written.values[index])
    layer = live.layer
    assert [str(unit) for unit in layer.units] == ["second", "degree", "micrometer", "micrometer"]
    assert layer.axis_labels == ("time", "angle", "y", "x")
    np.testing.assert_allclose(layer.scale[2:], float(written["y"][1] - written["y"][0]))
    low, high = layer.contrast_limits
    assert low <= shown[-1].min()
    assert high >= shown[-1].max()


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({}, "Name a folder or file to watch"),
        ({"source": "cell", "angles": "left"}, "Angles are numbers in degrees"),
        ({"source": "cell", "recipe": "missing.json"}, "missing.json"),
    ],
)
def test_what_can_not_be_is_said(live: Any, fields: dict[str, str], sentence: str) -> None:
    for name, text in fields.items():
        live.fields[name].setText(text)
    press(live)
    assert sentence in live.told.text()
    assert live.go.text() == "Watch"


def test_an_error_of_the_work_is_said(
    live: Any, qtbot: Any, frames: np.ndarray, tmp_path: Path
) -> None:
    """The results would be written over what somebody else has made."""
    (tmp_path / "cell_phase").mkdir()
    (tmp_path / "cell_phase" / "table.csv").write_text("mine")
    live.fields["source"].setText(str(tmp_path / "cell"))
    press(live)
    qtbot.waitUntil(lambda: live.watching is None, timeout=20_000)
    assert "was not made by a run" in live.told.text()


def test_a_dock_that_is_closed_ends_well(
    viewer: Any, live: Any, qtbot: Any, frames: np.ndarray, tmp_path: Path
) -> None:
    folder = tmp_path / "cell"
    folder.mkdir()
    for number, frame in enumerate(frames[:10]):
        tifffile.imwrite(folder / f"frame_{number:04}.tif", frame)
    live.fields["source"].setText(str(folder))
    press(live)
    qtbot.waitUntil(lambda: live.shown == 9, timeout=60_000)
    thread = live.watching.thread
    viewer.window.remove_dock_widget(live)
    live.deleteLater()
    qtbot.waitUntil(lambda: not thread.is_alive(), timeout=60_000)
    assert (tmp_path / "cell_phase" / "table.csv").exists()
