"""Step 5: the grid and the way back, differences, truth, table, traces, measuring, saving."""

from __future__ import annotations

import json
import re
import threading
from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
import pandas as pd
import pytest
from driving import answer_dialog, let_settle
from napari.components import ViewerModel
from qtpy.QtCore import Qt
from qtpy.QtGui import QGuiApplication

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.grid import ViewState, font_of_names
from napari_phase4d.analysis import measure, polygon_mask
from napari_phase4d.unwrapping import METHODS

pytestmark = pytest.mark.gui


@pytest.fixture
def compared(ready) -> Any:
    """Return the dock with results of three methods of the small video."""
    ready.session.unwrap(["spatial-2d", "temporal-angular", "directional-l1"])
    return ready


def shown(viewer: Any) -> list[str]:
    return [layer.name for layer in viewer.layers if layer.visible]


@pytest.mark.parametrize(("width", "size"), [(512, 7.0), (900, 8.0), (300, 6.0)])
def test_long_names_get_letters_that_fit_their_cells(qapp: Any, width: int, size: float) -> None:
    viewer = ViewerModel()
    viewer.canvas.size = (600, width)
    names = [METHODS[m].label for m in list(METHODS)[:9]]
    layers = [viewer.add_image(np.zeros((4, 4)), name=f"confidence in {n}") for n in names]
    assert "confidence in Temporal" in viewer.layers
    assert font_of_names(viewer, layers) == pytest.approx(size, abs=0.1)
    for layer in layers:
        layer.name = layer.name.removeprefix("confidence in ")
    assert font_of_names(viewer, layers) == pytest.approx(8, abs=0.1)
    assert font_of_names(viewer, layers[:4]) == pytest.approx(10, abs=0.1)


@pytest.mark.thorough
def test_nobody_is_sent_to_sliders_that_are_not_there(dock, small_video, click) -> None:
    exact = p4d.simulation.swimming_euglena((128, 128), 1, pixel_um=5.2 / 60 * 4, peak_rad=6)
    single = p4d.simulation.multiplexed_video(exact["phase"][:, :1], carriers=((0.19, 0.21),))
    for recording, views, words in ((small_video, 2, "Move the sliders"), (single, 1, "Zoom in")):
        dock.session.set_recording(recording)
        dock.session.find_lobes(views)
        dock.session.reconstruct()
        dock.session.unwrap(["spatial-2d"])
        click("side_by_side")
        assert dock.status.text() == f"{words}: all results follow."


@pytest.mark.thorough
def test_leaving_the_grid_restores_the_view(viewer, ready, click) -> None:
    wrapped = viewer.layers[-1]
    wrapped.contrast_limits = (-2, 2)
    viewer.scene.camera.zoom = 7.5
    ready.presenter.go_to(3, 1)
    before, visible = ViewState.of(viewer), shown(viewer)
    ready.session.unwrap(["spatial-2d", "temporal-angular"])
    assert viewer.canvas.grid.enabled
    click("show_confidence")
    ready.presenter.go_to(0, 0)
    assert shown(viewer) != visible
    click("leave_grid")
    assert shown(viewer) == visible
    after = ViewState.of(viewer)
    assert (after.grid, after.point, after.camera, after.overlays) == (
        before.grid,
        before.point,
        before.camera,
        before.overlays,
    )
    assert wrapped.contrast_limits == [-2, 2]
    click("leave_grid")
    assert "nothing is side by side" in ready.status.text()
    click("side_by_side")
    assert shown(viewer) == ["2-D", "T/A"]


@pytest.mark.thorough
def test_results_are_linked_and_named(viewer, compared) -> None:
    layers = [layer for layer in viewer.layers if layer.visible]
    assert [layer.name for layer in layers] == ["2-D", "T/A", "WL1"]
    for layer in layers:
        assert layer.name_overlay.visible
    # One scale for all is shown once, with its unit.
    assert [layer.colorbar.visible for layer in layers] == [True, False, False]
    text = viewer.canvas.overlays.text
    assert text.visible
    assert text.text == "colours: phase in rad"
    layers[0].contrast_limits = (1, 3)
    layers[1].colormap = "magma"
    assert all(layer.contrast_limits == [1, 3] for layer in layers)
    assert all(layer.colormap.name == "magma" for layer in layers)


#: Height of digits as a share of their font.
DIGIT = 0.73


def numbers_beside(viewer: Any, layer: Any) -> tuple[list[float], float]:
    """Return the numbers beside a layer's colour bar, and the least free space between two."""
    drawn = viewer.window._qt_viewer.canvas._layer_overlay_to_visual[layer]
    ticks = drawn[layer.colorbar].node.ticks
    places = ticks._text.pos[:, 1] * ticks.transform.scale[1]
    high = DIGIT * layer.colorbar.font_size * 96 / 72
    return [float(n) for n in ticks._text.text], np.abs(np.diff(places)).min() - high


@pytest.mark.thorough
@pytest.mark.parametrize("methods", [2, 9])
def test_the_colour_bar_has_numbers_to_read_colours_by(
    viewer: Any, dock: Any, click: Any, tick_only: Any, methods: int
) -> None:
    dock.session.set_phase(p4d.simulation.swimming_euglena((60, 72), 3, peak_rad=20)["wrapped"])
    tick_only(*list(METHODS)[:methods])
    click("run")
    for press in (None, "show_confidence", "show_difference"):
        if press:
            click(press)
        (bar,) = [la for la in viewer.layers if la.visible and la.colorbar.visible]
        viewer.screenshot(canvas_only=True, flash=False)  # so that it has been drawn
        numbers, free = numbers_beside(viewer, bar)
        assert len(set(numbers)) == len(numbers) >= 2, (press, numbers)
        assert free > 1, (press, numbers)


@pytest.mark.thorough
def test_difference_to_any_result(viewer, compared, qtbot) -> None:
    compared.compare.difference.value = "less T/A"
    let_settle(qtbot, compared)
    assert shown(viewer) == ["2-D − T/A", "WL1 − T/A"]
    results = compared.session.results
    expected = results["directional-l1"].values - results["temporal-angular"].values
    np.testing.assert_array_equal(viewer.layers["WL1 − T/A"].data, expected)
    count = len(viewer.layers)
    compared.compare.difference.value = "less T/A"
    let_settle(qtbot, compared)
    assert len(viewer.layers) == count  # what is shown already is not added again
    assert "in radians" in compared.status.text()


@pytest.mark.thorough
def test_truth_from_a_layer(viewer, compared, qtbot) -> None:
    phase = compared.session.reconstruction["phase"]
    exact = viewer.add_image(compared.session.results["directional-l1"].values + 0.5, name="mine")
    compared.compare.truth.value = exact
    qtbot.waitUntil(lambda: not compared.jobs.running, timeout=60_000)
    table = compared.session.outcome.comparison.table
    assert table["mse_rad2"]["directional-l1"] == pytest.approx(0.25, rel=1e-4)
    headings = [
        compared.compare.figures.table.horizontalHeaderItem(c).text()
        for c in range(compared.compare.figures.table.columnCount())
    ]
    assert "MSE rad²" in headings
    np.testing.assert_array_equal(compared.session.truth["time"], phase["time"])
    compared.compare.truth.value = "none"
    qtbot.waitUntil(lambda: not compared.jobs.running, timeout=60_000)
    assert "mse_rad2" not in compared.session.outcome.comparison.table


@pytest.mark.thorough
def test_truth_from_a_lazy_layer_is_read_outside_the_window(viewer, compared, qtbot) -> None:
    threads: list[str] = []

    def read(block: np.ndarray) -> np.ndarray:
        threads.append(threading.current_thread().name)
        return block

    values = compared.session.results["directional-l1"].values + 0.5
    lazy = da.from_array(values, chunks=(1, 1, -1, -1)).map_blocks(read, meta=values[:0])
    exact = viewer.add_image(lazy, name="mine", visible=False, contrast_limits=(0, 9))
    threads.clear()
    with dask.config.set(scheduler="synchronous"):  # blocks are read where they are asked for
        compared.compare.truth.value = exact
        qtbot.waitUntil(lambda: not compared.jobs.running, timeout=60_000)
    assert len(threads) == 12
    assert threading.main_thread().name not in threads
    table = compared.session.outcome.comparison.table
    assert table["mse_rad2"]["directional-l1"] == pytest.approx(0.25, rel=1e-4)
    np.testing.assert_array_equal(compared.session.truth, values)


@pytest.mark.thorough
def test_table_is_sorted_copied_and_saved(compared, click, tmp_path: Path) -> None:
    table = compared.compare.figures.table
    compared.session.set_truth(compared.session.results["directional-l1"])
    click("copy_table")
    copied = QGuiApplication.clipboard().text().splitlines()
    assert copied[0].split("\t")[:2] == ["method", "seconds"]
    assert len(copied) == 4
    column = [table.horizontalHeaderItem(c).text() for c in range(table.columnCount())].index(
        "MSE rad²"
    )
    table.sortItems(column, Qt.SortOrder.DescendingOrder)
    values = [float(table.item(row, column).text()) for row in range(3)]
    assert values == sorted(values, reverse=True)
    answered = answer_dialog(tmp_path / "table.csv")
    click("save_table")
    assert answered()
    saved = pd.read_csv(tmp_path / "table.csv", index_col="id")
    pd.testing.assert_frame_equal(saved, compared.session.outcome.comparison.table)


@pytest.mark.thorough
def test_trace_follows_sliders_and_regions(viewer, compared, click, qtbot) -> None:
    click("follow_mouse")
    trace = compared.compare.trace
    compared.presenter.go_to(2, 1)
    trace._pixel = (10, 12)  # as if the mouse were there, which may rest anywhere
    trace._show()
    assert_traces(compared, (slice(10, 11), slice(12, 13)), (2, 1))
    regions = compared.presenter.add_regions()
    assert not viewer.canvas.grid.enabled  # to draw over one result
    phase = compared.session.reconstruction["phase"]
    y, x = (phase[axis].values for axis in ("y", "x"))
    top, left, bottom, right = y[5] - 0.01, x[6] - 0.01, y[15] + 0.01, x[16] + 0.01
    corners = [[top, left], [top, right], [bottom, right], [bottom, left]]
    regions.add_polygons(np.array([regions.world_to_data(corner) for corner in corners]))
    qtbot.wait(200)
    assert_traces(compared, (slice(5, 16), slice(6, 17)), (2, 1))
    click("follow_mouse")
    trace._pixel = (10, 12)
    trace._show()
    assert_traces(compared, (slice(10, 11), slice(12, 13)), (2, 1))


def assert_traces(dock: Any, where: tuple[slice, slice], frame: tuple[int, int]) -> None:
    """Curves of all methods over time, and over angle, are means over a box of pixels."""
    over_time, over_angle = dock.compare.trace.plot.figure.axes[:2]
    t, a = frame
    for axes, part in ((over_time, (slice(None), a)), (over_angle, (t, slice(None)))):
        lines = {line.get_label(): line for line in axes.get_lines()}
        for name, method in (("2-D", "spatial-2d"), ("WL1", "directional-l1")):
            values = dock.session.results[method].values[*part, *where]
            np.testing.assert_allclose(
                lines[name].get_ydata(), values.mean((-2, -1)), rtol=1e-5, atol=1e-5
            )


@pytest.mark.thorough
def test_measuring_the_object_and_labels(viewer, compared, click, tmp_path: Path) -> None:
    click("measure")
    measuring = compared.compare.measuring
    result = compared.session.results["directional-l1"]
    optics = compared.session.recipe.optics
    inside = compared.session.outcome.comparison.object_mask().values.astype(bool)
    expected = measure(result, {"object": inside}, optics)
    columns = list(expected.columns)
    pd.testing.assert_frame_equal(measuring.measured[columns], expected)
    assert measuring.table.rowCount() == 12
    labels = np.zeros(result.shape[-2:], int)
    labels[4:9, 5:11] = 3
    layer = viewer.add_labels(labels, name="cells", scale=viewer.layers["WL1"].scale[-2:])
    measuring.regions.value = layer
    measuring.index.value = 1.4
    measuring.increment.value = 0.2
    click("measure")
    mask = polygon_mask([[4, 5], [4, 10], [8, 10], [8, 5]], labels.shape)
    expected = measure(
        result, {"label 3": mask}, optics, object_index=1.4, refraction_increment_ml_per_g=0.2
    )
    pd.testing.assert_frame_equal(measuring.measured[list(expected.columns)], expected)
    measuring.quantity.value = "mean height (um)"
    shown = measuring.quantity.native
    assert shown.currentText() == "mean height (µm)"
    words = {shown.itemText(i) for i in range(shown.count())}
    assert words >= {"area (µm²)", "volume (µm³)"}
    assert measuring.plot.figure.axes[0].get_ylabel() == "mean height (µm)"
    line = measuring.plot.figure.axes[0].get_lines()[0]
    angle = expected["angle (deg)"].unique()[compared.presenter.current_frame()[1]]
    rows = expected[expected["angle (deg)"] == angle]
    np.testing.assert_array_equal(line.get_ydata(), rows["mean height (um)"])
    answered = answer_dialog(tmp_path / "measured.csv")
    click("save_measured")
    assert answered()
    saved = pd.read_csv(tmp_path / "measured.csv")
    assert list(saved.columns)[:5] == [
        "region", "time (s)", "angle (deg)", "area (um^2)", "mean phase (rad)",
    ]  # fmt: skip
    assert set(saved["refraction increment (mL/g)"]) == {0.2}
    np.testing.assert_allclose(saved["dry mass (pg)"], expected["dry mass (pg)"])
    measuring.save_to(tmp_path / "plot.png")
    assert compared.status.text() == f"The plot is in {tmp_path / 'plot.png'}."
    measuring.save_to(tmp_path / "without ending")
    assert (tmp_path / "without ending.csv").exists()
    with pytest.raises(ValueError, match=r"a table is written as .csv, but the name is m.docx"):
        measuring.save_to(tmp_path / "m.docx")


@pytest.mark.thorough
def test_measuring_says_what_is_missing(viewer, compared, click) -> None:
    click("draw_region")
    assert "double-click to end" in compared.status.text()
    compared.compare.measuring.regions.value = viewer.layers["regions"]
    click("measure")
    assert "draw a polygon" in compared.status.text()
    click("save_measured")
    assert "nothing has been measured yet" in compared.status.text()


@pytest.mark.thorough
def test_figure_movie_and_recipe_are_saved(compared, click, qtbot, tmp_path: Path) -> None:
    pytest.importorskip("av")
    files = {"save_figure": "figure.svg", "save_movie": "movie.mp4", "save_recipe": "recipe.json"}
    for button, name in files.items():
        answered = answer_dialog(tmp_path / name)
        click(button)
        assert answered()
        qtbot.waitUntil(lambda: not compared.jobs.running, timeout=60_000)
        assert str(tmp_path / name) in compared.status.text()
    svg = (tmp_path / "figure.svg").read_text(encoding="utf-8")
    assert all(f">{name}</text>" in svg for name in ("2-D", "T/A", "WL1", "2 µm"))
    assert (tmp_path / "movie.mp4").stat().st_size > 1000
    assert p4d.Recipe.from_file(tmp_path / "recipe.json") == compared.session.recipe
    assert json.loads((tmp_path / "recipe.json").read_text())["methods"][0] == "spatial-2d"


@pytest.mark.thorough
def test_saving_where_nothing_can_be_written_is_said(compared, qtbot, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    share = compared.compare.share
    for save, name in (
        (share.save_to, "x"),
        (share.save_figure, "x.png"),
        (share.save_movie, "x.gif"),
    ):
        share.guarded(lambda save=save, name=name: save(tmp_path / "file" / name))
        qtbot.waitUntil(lambda: not compared.jobs.running, timeout=60_000)
        assert compared.status.property("wrong"), save
        assert re.search("could not be|can.t be", compared.status.text())


@pytest.mark.thorough
def test_script_of_frames_in_memory_says_to_save_them(compared, click) -> None:
    click("copy_script")
    assert compared.status.property("wrong")
    assert "save" in compared.status.text()
