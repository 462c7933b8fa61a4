"""The whole story of a newcomer, with real mouse and key events, under both Qt bindings."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest
from driving import LEFT, PLAIN, answer_dialog, canvas_of, click_cell, drag, place_of
from qtpy.QtCore import QPoint, Qt
from qtpy.QtGui import QGuiApplication
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d.io import read_results
from napari_phase4d.simulation import swimming_cells

pytestmark = [pytest.mark.gui, pytest.mark.story]


def states(dock: Any) -> list[str]:
    """What stands at the headings, without the sign before it."""
    return [section.badge.text().lstrip("●✓↻ ") for section in dock.sections]


def test_from_an_empty_window_to_a_movie(viewer, dock, click, qtbot, tmp_path: Path) -> None:
    assert "try the sample" in dock.recording.explanation.text()
    assert states(dock) == ["ready", "to do", "to do", "to do", "to do"]
    click("try_sample")
    assert states(dock) == ["done", "ready", "to do", "to do", "to do"]
    assert dock.sections[1].is_open

    # By keyboard alone: the button that is next, with the space bar.
    dock.lobes.find.setFocus()
    QTest.keyClick(dock.lobes.find, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    found = dock.session.lobes
    assert [lobe.angle_deg for lobe in found] == [-7, 21]
    qtbot.mouseClick(dock.sections[1].heading, Qt.MouseButton.LeftButton)  # step 3 has opened
    qtbot.waitUntil(lambda: dock.lobes.strip.captions == ["1: -7°", "2: 21°"], timeout=60_000)

    # A circle dragged away, and back with Undo.
    ky, kx = found[0].carrier
    drag(dock.lobes.canvas, (ky, kx), (ky + 0.05, kx))
    assert dock.session.lobes[0].carrier[0] == pytest.approx(ky + 0.05, abs=0.006)
    click("undo_lobes")
    assert dock.session.lobes == found

    click("reconstruct")
    assert states(dock) == ["done", "done", "done", "ready", "to do"]
    qtbot.waitUntil(lambda: dock.session.scores is not None, timeout=60_000)
    boundary_map = dock.unwrap.boundary.map
    click_cell(boundary_map, 12, 1)
    assert dock.session.recipe.boundary == ((12, 1),)
    assert viewer.dims.current_step[:2] == (12, 1)
    click("automatic")
    assert dock.session.recipe.boundary == "auto"
    assert dock.session.start_frames == (tuple(dock.session.scores.attrs["best"]),)

    for method in ("angular", "angular-temporal"):
        click(f"method_{method}")
    click("run")
    assert states(dock) == ["done"] * 5
    shown = [layer.name for layer in viewer.layers if layer.visible]
    assert shown == ["exact", "2-D", "Temporal", "T/A", "WL1"]
    assert viewer.canvas.grid.enabled

    # The time slider by key, on the canvas.
    before = viewer.dims.current_step[0]
    viewer.dims.last_used = 0
    QTest.keyClick(canvas_of(viewer), Qt.Key.Key_Right)
    qtbot.waitUntil(lambda: viewer.dims.current_step[0] == before + 1, timeout=60_000)

    look_at_a_pixel(viewer, dock, click, qtbot)
    measure_a_drawn_region(viewer, dock, click, qtbot)
    save_a_movie(dock, click, qtbot, tmp_path)
    run_the_copied_script(viewer, dock, click, tmp_path)


@pytest.mark.thorough
def test_from_holograms_to_a_table_of_cells(viewer, dock, click, qtbot, tmp_path: Path) -> None:
    for name in ("try_cells", "find_lobes", "reconstruct"):
        click(name)
    dock.session.update(methods=("directional-l1",))
    click("run")
    click("find_cells")
    summary = dock.session.cells.summary
    assert len(summary) == 8
    assert summary["parent"].tolist().count(summary["parent"].max()) == 2  # one has divided
    true = swimming_cells((512, 640), 40, 5, pixel_um=p4d.Optics().pixel_um)["dry_mass_pg"]
    masses = np.nanmedian(true.values[:, :5], axis=0)
    for mass in masses:
        nearest = float(np.abs(summary["dry mass (pg)"] / mass - 1).min())
        assert nearest < 0.02
    # A cell, clicked in the picture.
    table, cells = dock.session.cells.table, dock.compare.cells
    dock.presenter.go_to(3, 0)
    now = table[(table["angle (deg)"] == -7) & np.isclose(table["time (s)"], 0.5)]
    row = now[now["cell"] == 4].iloc[0]
    place = place_of(viewer, row["y (um)"], row["x (um)"])
    QTest.mouseMove(canvas_of(viewer), place)
    qtbot.wait(50)
    QTest.mouseClick(canvas_of(viewer), LEFT, PLAIN, place)
    qtbot.waitUntil(lambda: cells.chosen == [4], timeout=60_000)
    path = tmp_path / "cells.csv"
    answered = answer_dialog(path)
    click("save_cells")
    assert answered()
    pd.testing.assert_frame_equal(pd.read_csv(path), table)


def look_at_a_pixel(viewer: Any, dock: Any, click: Any, qtbot: Any) -> None:
    """The trace of the pixel under the mouse, by every method."""
    click("leave_grid")
    click("follow_mouse")
    phase = dock.session.reconstruction["phase"]
    y, x = (float(phase[axis][n]) for axis, n in (("y", 44), ("x", 41)))
    canvas = canvas_of(viewer)
    for away in (9, 0):
        QTest.mouseMove(canvas, place_of(viewer, y, x) + QPoint(away, away))
        qtbot.wait(50)  # napari passes over moves that follow each other at once
    qtbot.waitUntil(lambda: dock.presenter.current_pixel() == (44, 41), timeout=60_000)
    plot = dock.compare.trace.plot
    qtbot.waitUntil(lambda: plot.has_curves, timeout=60_000)
    _, angle = dock.presenter.current_frame()

    def shown(name: str, method: str) -> bool:  # the curves of the pixel before come up first
        lines = {line.get_label(): line for line in plot.figure.axes[0].get_lines()}
        expected = dock.session.results[method].values[:, angle, 44, 41]
        return np.array_equal(lines[name].get_ydata(), expected)

    for name, method in (("2-D", "spatial-2d"), ("T/A", "temporal-angular")):
        qtbot.waitUntil(partial(shown, name, method), timeout=60_000)


def measure_a_drawn_region(viewer: Any, dock: Any, click: Any, qtbot: Any) -> None:
    """A rectangle drawn with the mouse, and its dry mass over time."""
    click("draw_region")
    layer = viewer.layers["regions"]
    layer.mode = "add_rectangle"
    phase = dock.session.reconstruction["phase"]
    low, high = ([float(phase[axis][n]) for axis in ("y", "x")] for n in (30, 60))
    canvas = canvas_of(viewer)
    start, end = place_of(viewer, *low), place_of(viewer, *high)
    QTest.mousePress(canvas, LEFT, PLAIN, start)
    for step in range(1, 6):
        QTest.mouseMove(canvas, start + (end - start) * step / 5)
        QApplication.processEvents()
    QTest.mouseRelease(canvas, LEFT, PLAIN, end)
    qtbot.waitUntil(lambda: len(layer.data) == 1, timeout=60_000)
    assert dock.compare.measuring.regions.value == layer
    click("regions_follow")
    click("measure")
    table = dock.compare.measuring.measured
    assert set(table["region"]) == {"region 1"}
    corners = np.array([layer.data_to_world(corner) for corner in layer.data[0]])
    pixel = float(phase["y"][1] - phase["y"][0])
    np.testing.assert_allclose(corners.min(0), low, atol=1.5 * pixel)
    np.testing.assert_allclose(corners.max(0), high, atol=1.5 * pixel)
    inside = [
        (phase[axis].values > corners[:, i].min()) & (phase[axis].values < corners[:, i].max())
        for i, axis in enumerate(("y", "x"))
    ]
    result = dock.session.results["directional-l1"].values[:, :, *np.ix_(*inside)]
    mass = result.sum((2, 3), dtype=np.float64) * 0.6328 / (2 * np.pi) * pixel**2 / 0.18
    np.testing.assert_allclose(table["dry mass (pg)"], mass.ravel(), rtol=1e-6)


def save_a_movie(dock: Any, click: Any, qtbot: Any, folder: Path) -> None:
    """The comparison as a movie, through the file dialog."""
    path = folder / "movie.gif"
    answered = answer_dialog(path)
    click("save_movie")
    assert answered()
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=120_000)
    assert str(path) in dock.status.text()
    frames = iio.imread(path)
    assert len(frames) == 40
    assert (frames[0] != frames[-1]).any()


def run_the_copied_script(viewer: Any, dock: Any, click: Any, folder: Path) -> None:
    """The script on the clipboard, run in another Python, gives the arrays on screen."""
    click("copy_script")
    script = folder / "again.py"
    script.write_text(QGuiApplication.clipboard().text(), encoding="utf-8")
    subprocess.run([sys.executable, str(script)], cwd=folder, check=True, capture_output=True)
    results = folder / "phase4d_results"
    for method in dock.session.results:
        again = read_results(results / f"{method}.ome.tif")
        name = p4d.METHODS[method].label
        np.testing.assert_array_equal(again.values, viewer.layers[name].data)
    wrapped = read_results(results / "wrapped.ome.tif")
    np.testing.assert_array_equal(wrapped.values, dock.session.reconstruction["phase"].values)
