"""What the window does with the room it has, with the object before a run, and with a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from driving import answer_dialog
from napari.layers import Labels
from qtpy.QtCore import QPoint, Qt, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QSplitter, QWidget

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.pointing import table_of_regions
from napari_phase4d._napari.widgets.section import Turning
from napari_phase4d.plotting import OBJECT_COLOUR
from napari_phase4d.unwrapping import object_in

pytestmark = pytest.mark.gui

METHODS = ("spatial-2d", "temporal-angular")


def phase_of_a_cell(shape: tuple[int, int], n_times: int) -> xr.DataArray:
    """Return wrapped phase of one object in an empty field."""
    made = p4d.simulation.swimming_euglena(shape, n_times, peak_rad=9, pixel_um=0.4)
    return made["wrapped"]


@pytest.fixture
def cell(dock: Any) -> Any:
    """Return the dock with wrapped phase of one object."""
    dock.session.set_phase(phase_of_a_cell((90, 110), 5))
    dock.session.update(methods=METHODS)
    return dock


def test_the_spectrum_turns_where_there_is_room(qtbot: Any) -> None:
    square, narrow = QWidget(), QWidget()
    both = Turning(square, narrow, 120)
    qtbot.addWidget(both)
    both.resize(400, 240)
    both.show()
    qtbot.waitExposed(both)
    assert not both.is_upright
    assert (square.width(), narrow.width(), narrow.height()) == (400 - 120 - 4, 120, 240)
    both.resize(400, 600)
    qtbot.waitUntil(lambda: both.is_upright)
    qtbot.waitUntil(lambda: (square.width(), square.height(), narrow.width()) == (400, 400, 400))
    assert narrow.y() > square.y()
    both.resize(400, 240)
    qtbot.waitUntil(lambda: not both.is_upright and narrow.width() == 120)


@pytest.mark.thorough
def test_pictures_and_tables_take_the_height_there_is(
    viewer: Any, dock: Any, ready: Any, qtbot: Any
) -> None:
    dock.show_step(1)
    heights = []
    for height in (720, 950):
        viewer.window.resize(1280, height)
        qtbot.waitUntil(lambda h=height: abs(viewer.window._qt_window.height() - h) < 5)
        qtbot.wait(50)
        heights.append(dock.lobes.canvas.height())
    assert heights[1] > heights[0] + 80
    dock.show_step(4)
    qtbot.waitUntil(lambda: dock.compare.tabs.height() > 400)
    dock.show_step(2)  # nothing in it grows: it is as high as what it holds
    qtbot.waitUntil(lambda: dock.sections[2].height() < 620)


@pytest.mark.thorough
def test_the_object_is_seen_before_a_run(cell: Any, click: Any, viewer: Any) -> None:
    click("show_object")
    (layer,) = [la for la in viewer.layers if la.name.startswith("object in")]
    assert layer.visible
    assert layer.contour > 0
    assert cell.unwrap.outline.isChecked()
    click("run")
    assert not layer.visible  # results are on screen now
    assert not cell.unwrap.outline.isChecked()
    result = cell.session.results["temporal-angular"]
    wrapped = cell.session.reconstruction["phase"]
    for t, a in ((0, 0), (3, 1)):
        mask = np.asarray(layer.data[t, a]).astype(bool)
        assert 0.02 < mask.mean() < 0.9
        assert not result.values[t, a][~mask].any()
        turns = (result.values[t, a] - wrapped.values[t, a])[mask] / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-4)
    click("show_object")
    assert layer.visible
    assert cell.presenter.showing == "wrapped"
    click("show_object")
    assert not layer.visible
    # Of other phase it is another one.
    cell.session.set_phase(phase_of_a_cell((80, 100), 3))
    assert not cell.unwrap.outline.isChecked()
    click("show_object")
    newest = [la for la in viewer.layers if la.name.startswith("object in") and la.visible]
    assert [la.data.shape for la in newest] == [(3, 2, 80, 100)]


@pytest.mark.thorough
def test_the_outline_comes_up_in_turns(cell: Any, viewer: Any, qtbot: Any) -> None:
    shown: list[list[str]] = []
    beat = QTimer()
    beat.timeout.connect(
        lambda: shown.append([la.name for la in viewer.layers if isinstance(la, Labels)])
    )
    beat.start(0)
    cell.unwrap.outline.click()
    assert cell.presenter.turns.pending
    assert not any(isinstance(la, Labels) for la in viewer.layers)
    qtbot.waitUntil(lambda: not cell.presenter.turns.pending)
    beat.stop()
    assert [] in shown  # the window went on before there was a layer
    assert cell.presenter.shows_object
    assert cell.unwrap.outline.isChecked()
    (layer,) = [la for la in viewer.layers if isinstance(la, Labels)]
    colours = layer.colormap.map(np.array([0, 1], np.uint8))
    np.testing.assert_allclose(colours[0], 0)
    np.testing.assert_allclose(255 * colours[1], [0x2E, 0xE6, 0x6B, 255], atol=0.5)
    cell.unwrap.outline.click()
    assert not cell.presenter.shows_object
    assert not cell.unwrap.outline.isChecked()


@pytest.mark.thorough
def test_the_button_says_what_is_shown_however_fast_it_is_pressed(
    cell: Any, qtbot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    button, turns = cell.unwrap.outline, cell.presenter.turns
    button.click()
    button.click()  # while the first one is at work
    assert not button.isChecked()
    assert not cell.presenter.shows_object
    # Of phase that comes meanwhile there is none.
    button.click()
    cell.session.set_phase(phase_of_a_cell((80, 100), 3))
    assert cell.session.reconstruction["phase"].shape == (3, 2, 80, 100)
    qtbot.waitUntil(lambda: not turns.pending)
    assert button.isChecked() == cell.presenter.shows_object
    # Where a turn fails, there is none either, and the window says why.
    if cell.presenter.shows_object:
        button.click()
    told: list[Exception] = []
    monkeypatch.setattr(turns, "failed", told.append)

    def no_room(*given: object, **options: object) -> None:
        msg = "no room"
        raise RuntimeError(msg)

    monkeypatch.setattr("napari_phase4d._napari.viewing.presenter.Labels", no_room)
    button.click()
    qtbot.waitUntil(lambda: not turns.pending)
    assert [str(error) for error in told] == ["no room"]
    assert not button.isChecked()


@pytest.mark.thorough
def test_the_thumbnail_has_the_outline_where_only_the_object_counts(cell: Any, click: Any) -> None:
    def greens() -> int:
        image = cell.unwrap.boundary.thumbnail.picture.pixmap().toImage()
        names = [image.pixelColor(x, y).name() for x in range(64) for y in range(image.height())]
        return names.count(OBJECT_COLOUR)

    cell.show_step(3)
    assert cell.session.recipe.mask == "auto"
    assert greens() > 30
    click("mask")
    assert greens() == 0


def test_nothing_known_is_no_object() -> None:
    assert not object_in(np.full((12, 14), np.nan, np.float32)).any()


@pytest.mark.thorough
def test_every_method_in_one_plot(cell: Any, click: Any, tmp_path: Path) -> None:
    click("run")
    part = cell.compare.measuring
    part.result.value = "every"
    click("measure")
    assert list(part.measured["method"].unique()) == ["2-D", "T/A"]
    assert len(part.measured) == 2 * 5 * 2
    (axes,) = part.plot.figure.axes
    assert [line.get_label() for line in axes.get_lines()][:2] == ["2-D", "T/A"]
    alone = cell.session.measure("temporal-angular")
    both = cell.session.measure(["spatial-2d", "temporal-angular"])
    of_one = both[both["method"] == "T/A"].drop(columns="method").reset_index(drop=True)
    pd.testing.assert_frame_equal(of_one, alone)
    cell.session.measure(["spatial-2d", "temporal-angular"])
    part.save_to(tmp_path / "every.csv")
    assert list(pd.read_csv(tmp_path / "every.csv").columns[:2]) == ["method", "region"]


@pytest.mark.thorough
def test_the_plot_is_made_higher_by_its_handle(cell: Any, click: Any, qtbot: Any) -> None:
    click("run")
    click("measure")
    (splitter,) = cell.compare.measuring.findChildren(QSplitter)
    handle, before = splitter.handle(1), splitter.sizes()
    middle = handle.rect().center()
    QTest.mousePress(handle, Qt.MouseButton.LeftButton, pos=middle)
    QTest.mouseMove(handle, middle - QPoint(0, 12))
    QTest.mouseRelease(handle, Qt.MouseButton.LeftButton, pos=middle - QPoint(0, 12))
    qtbot.waitUntil(lambda: splitter.sizes() != before)
    assert all(size >= 52 for size in splitter.sizes())  # neither goes


@pytest.mark.thorough
def test_a_folder_of_results_is_opened_again(
    cell: Any, click: Any, viewer: Any, tmp_path: Path, qtbot: Any
) -> None:
    click("run")
    cell.session.measure()
    regions = cell.presenter.add_regions()
    regions.add_polygons([np.array([[5, 5], [5, 20], [20, 20]])])
    (tmp_path / "saved").mkdir()
    answered = answer_dialog(tmp_path / "saved")
    click("save_results")
    assert answered()
    qtbot.waitUntil(lambda: not cell.jobs.running, timeout=60_000)
    results = {m: r.values for m, r in cell.session.results.items()}
    measured = pd.read_csv(tmp_path / "saved" / "measured.csv")
    pd.testing.assert_frame_equal(measured, cell.session.measured, check_dtype=False)
    corners = pd.read_csv(tmp_path / "saved" / "regions.csv")
    steps = regions.scale
    np.testing.assert_allclose(corners["y (um)"], np.array([5, 5, 20]) * steps[0])
    np.testing.assert_allclose(corners["x (um)"], np.array([5, 20, 20]) * steps[1])
    assert table_of_regions([]).empty

    answered = answer_dialog(tmp_path / "saved")
    click("open_folder")
    assert answered()
    qtbot.waitUntil(lambda: not cell.jobs.running, timeout=60_000)
    assert cell.session.recipe.recording == str(tmp_path / "saved" / "wrapped.ome.tif")
    for method, values in results.items():
        np.testing.assert_array_equal(cell.session.results[method].values, values)
    assert cell.presenter.showing == "results"
    assert [cell.sections[n].badge.text() for n in (2, 3)] == ["✓ done"] * 2
    qtbot.waitUntil(lambda: bool(cell.session.scores is not None), timeout=60_000)
    click("measure")
    np.testing.assert_allclose(
        cell.session.measured["mean phase (rad)"], measured["mean phase (rad)"]
    )
