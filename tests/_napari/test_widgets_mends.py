"""Faults of single widgets that a reading found: options, order of rows, long recordings."""

from __future__ import annotations

import textwrap
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from driving import let_settle
from napari._qt.widgets.qt_progress_bar import QtLabeledProgressBar
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d._napari.menus import is_phase_layer, on_selected
from napari_phase4d._napari.viewing.layers import LayerTuple, stack_layer
from napari_phase4d._napari.widgets.curves import CurvePlot, Panel
from napari_phase4d._napari.widgets.result_table import ResultTable
from napari_phase4d.analysis import Cells
from napari_phase4d.task import Cancelled, Task

#: Options as a package may bring them.
OPTIONS = {
    "offset": -1,
    "most": 5_000_000,
    "huge": 10**12,
    "tolerance": 1e-8,
    "scale": 1e30,
    "odd": 0.1 + 0.2,
    "name": "abc",
}


@pytest.fixture
def own_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Install a method whose options are of all kinds."""
    (tmp_path / "mine.py").write_text(
        textwrap.dedent(
            f"""
            import numpy as np
            from napari_phase4d.unwrapping import Method, Option

            def unwrap(problem, progress, cancelled, **options):
                return np.zeros(problem.phase.shape, np.float32)

            options = tuple(Option(n, d, "Some.") for n, d in {OPTIONS!r}.items())
            METHOD = Method("Mine", "Nowhere", "Nothing.", unwrap, options)
            """
        )
    )
    facts = tmp_path / "mine-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[napari_phase4d.methods]\nmine = mine:METHOD\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    vars(p4d.METHODS).pop("_all", None)
    yield "mine"
    vars(p4d.METHODS).pop("_all", None)


@pytest.mark.gui
def test_every_option_has_a_field_that_holds_its_default(own_method: str, dock: Any) -> None:
    row = dock.unwrap.methods[own_method]
    assert row.changed() == {}
    dock.session.update(options={own_method: {"tolerance": 2e-8, "huge": 7, "name": "x"}})
    assert row.changed() == {"tolerance": 2e-8, "huge": 7, "name": "x"}
    row.fields["offset"].value = -3
    row.fields["huge"].value = "nothing"  # which is no number
    dock.session.update(methods=(own_method,))
    assert dock.session.recipe.options[own_method] == {
        "offset": -3,
        "tolerance": 2e-8,
        "name": "x",
    }
    row.fields["huge"].value = "8"
    assert dock.session.recipe.options[own_method]["huge"] == 8


def test_what_is_not_known_comes_last_whichever_way_a_table_is_sorted(qtbot: Any) -> None:
    table = ResultTable("parents")
    qtbot.addWidget(table)
    parents = [3.0, np.nan, 1.0, np.nan, 2.0, np.nan, 0.5]
    table.show_frame(pd.DataFrame({"parent": parents}), {"parent": ("parent", "", ".1f")})
    table.show()
    for order, wanted in (
        (Qt.SortOrder.AscendingOrder, ["0.5", "1.0", "2.0", "3.0"]),
        (Qt.SortOrder.DescendingOrder, ["3.0", "2.0", "1.0", "0.5"]),
    ):
        table.horizontalHeader().setSortIndicator(0, order)  # as a click on the heading does
        assert [table.item(row, 0).text() for row in range(7)] == [*wanted, "–", "–", "–"]


N_CELLS, N_TIMES = 30, 400


def many_cells(phase: xr.DataArray) -> Cells:
    """Return made-up cells over many times, at the views of some phase."""
    times, views = np.arange(N_TIMES) * 0.1, phase["angle"].values
    rows = N_TIMES * len(views) * N_CELLS
    numbers = np.tile(np.arange(1, N_CELLS + 1), N_TIMES * len(views))
    table = pd.DataFrame(
        {
            "cell": numbers,
            "parent": 0,
            "time (s)": np.repeat(times, len(views) * N_CELLS),
            "angle (deg)": np.tile(np.repeat(views, N_CELLS), N_TIMES),
            "wholly in view": True,
            "dry mass (pg)": numbers + np.linspace(0, 1, rows),
            "dry mass error (pg)": 0.1,
            "area (um^2)": 1.0,
            "mass density (pg/um^2)": 1.0,
            "speed (um/s)": 1.0,
            "y (um)": 1.0,
            "x (um)": 1.0,
            "largest phase (rad)": 3.0,
        }
    )
    grid = {"time": times, "angle": views, "y": np.arange(12) * 0.3, "x": np.arange(12) * 0.3}
    labels = xr.DataArray(
        np.zeros((N_TIMES, len(views), 12, 12), np.int32),
        coords=grid,
        attrs={"method": "spatial-2d"},
    )
    return Cells(labels, table, "spatial-2d")


@pytest.mark.gui
def test_a_step_of_the_slider_moves_a_line_and_makes_nothing_anew(
    ready: Any, viewer: Any, qtbot: Any
) -> None:
    ready.session.unwrap(["spatial-2d"])
    let_settle(qtbot, ready)
    part, layers = ready.compare.cells, ready.presenter.cells
    ready.show_step(4)
    ready.compare.tabs.setCurrentWidget(part)
    ready.session.cells = many_cells(ready.session.reconstruction["phase"])
    ready.session.cells_changed.emit()
    let_settle(qtbot, ready)

    def ways() -> Any:
        (layer,) = (la for la in viewer.layers if la.name.startswith("ways"))
        return layer

    def step_to(time: int, angle: int) -> None:
        ready.presenter.go_to(time, angle)
        part.frame_changed()
        layers.turn_to(angle)

    def shown() -> list[Any]:
        (axes,) = part.plot.figure.axes
        return [line.get_ydata(orig=True) for line in axes.get_lines()[:N_CELLS]]

    step_to(0, 0)
    let_settle(qtbot, ready)
    first, before = ways(), shown()
    step_to(3, 0)
    assert all(now is then for now, then in zip(shown(), before, strict=True))
    step_to(4, 1)
    assert ways() is not first
    assert not np.array_equal(shown()[0], before[0])
    step_to(4, 0)
    assert ways() is first
    np.testing.assert_array_equal(shown()[0], before[0])


@pytest.mark.gui
def test_curves_that_stay_are_not_drawn_again_when_the_time_moves(qtbot: Any) -> None:
    plot = CurvePlot()
    qtbot.addWidget(plot)
    plot.resize(360, 300)
    plot.show()
    x = np.arange(2000.0)
    wild = np.random.default_rng(0).random((N_CELLS, x.size))
    curves = {f"cell {n}": y for n, y in enumerate(wild)}

    def show(at: float) -> float:
        began = time.perf_counter()
        plot.show_traces([Panel(x, curves, "time (s)", "pg", at)])
        QApplication.processEvents()
        return time.perf_counter() - began

    whole = show(0.0)
    qtbot.wait(50)
    assert sum(show(float(at)) for at in range(100, 600, 100)) < whole
    moved = plot.grab().toImage()
    plot.hide()
    plot.show()  # draws all of it
    qtbot.waitExposed(plot)
    QApplication.processEvents()
    assert plot.grab().toImage() == moved


def test_the_legend_of_many_is_the_widest_that_fits(qtbot: Any) -> None:
    plot = CurvePlot()
    qtbot.addWidget(plot)
    plot.resize(360, 300)
    plot.show()
    plot.show_traces([Panel([0, 1], {f"cell {n}": [0, n] for n in range(12)}, "s")])
    QApplication.processEvents()
    (legend,) = plot.figure.legends
    width = plot.figure.bbox.width
    assert legend.get_window_extent().width <= width < legend.get_window_extent().width * 1.5


def with_phase_selected(viewer: Any) -> LayerTuple:
    """Add wrapped phase, selected, and return it as a layer that work may give back."""
    phase = p4d.simulation.swimming_euglena((60, 72), 2, peak_rad=9)["wrapped"]
    layer = stack_layer(phase, "phase", "wrapped")
    data, keywords, _ = layer
    viewer.layers.selection.active = viewer.add_image(data, **keywords)
    return layer


@pytest.mark.gui
def test_what_comes_late_is_not_added_to_a_viewer_that_was_closed(
    viewer: Any, make_napari_viewer: Any, qtbot: Any
) -> None:
    make_napari_viewer(show=False)  # with the last window napari ends all work itself
    layer, go_on = with_phase_selected(viewer), threading.Event()

    def work(*_: Any) -> Any:
        go_on.wait(60)
        return layer

    worker = on_selected(viewer, is_phase_layer, "wrapped phase", "Waiting", work)
    viewer.close()
    came: list[Any] = []
    worker.returned.connect(came.append)
    with qtbot.capture_exceptions() as raised:
        go_on.set()
        qtbot.waitUntil(lambda: bool(came), timeout=20_000)
    assert not raised
    assert len(viewer.layers) == 0


@pytest.mark.gui
def test_work_of_the_menu_ends_with_the_viewer_that_waits_for_it(
    viewer: Any, make_napari_viewer: Any, qtbot: Any
) -> None:
    make_napari_viewer(show=False)
    with_phase_selected(viewer)
    stopped = threading.Event()

    def work(_: Any, task: Task) -> Any:
        until = time.monotonic() + 60
        while time.monotonic() < until and not task.stopped:
            time.sleep(0.05)
        if task.stopped:
            stopped.set()
        msg = "Waiting: cancelled"
        raise Cancelled(msg)

    on_selected(viewer, is_phase_layer, "wrapped phase", "Waiting", work)
    qtbot.wait(200)
    assert not stopped.is_set()
    viewer.close()
    qtbot.waitUntil(stopped.is_set, timeout=20_000)


@pytest.mark.gui
def test_what_is_cancelled_at_its_end_is_not_added(viewer: Any, qtbot: Any) -> None:
    layer, go_on = with_phase_selected(viewer), threading.Event()

    def work(*_: Any) -> Any:
        go_on.wait(60)
        return layer

    worker = on_selected(viewer, is_phase_layer, "wrapped phase", "Waiting", work)
    (bar,) = viewer.window._qt_window.findChildren(QtLabeledProgressBar)
    bar.cancel_button.click()
    with qtbot.waitSignal(worker.finished, timeout=20_000):
        go_on.set()
    qtbot.wait(100)
    assert len(viewer.layers) == 1
