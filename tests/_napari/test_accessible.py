"""Use by keyboard, by screen reader, with a large font; and the way to where methods disagree."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from napari.settings import get_settings
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QTableWidget,
    QWidget,
)

import napari_phase4d as p4d
from napari_phase4d._napari.widgets.curves import CurvePlot
from napari_phase4d._napari.widgets.spectrum_canvas import VIEW_COLORS, SpectrumCanvas
from napari_phase4d._napari.widgets.view_strip import ViewStrip

pytestmark = pytest.mark.gui

#: Of the line round what has the keyboard.
FOCUS_COLOUR = "#3d8fe0"
FIELDS = (QAbstractButton, QAbstractSpinBox, QComboBox, QTableWidget)


def fields_of(dock) -> list[QWidget]:
    """Return what can be used, without the parts that Qt makes of it."""
    found = [w for kind in FIELDS for w in dock.findChildren(kind)]
    return [w for w in found if w.objectName() and not w.objectName().startswith("qt_")]


@pytest.mark.thorough
def test_every_field_says_what_it_is(ready) -> None:
    fields = fields_of(ready)
    assert len(fields) > 60
    for field in fields:
        words = field.text() if isinstance(field, QAbstractButton) else ""
        assert words or field.accessibleName(), field.objectName()


@pytest.mark.thorough
def test_tab_leaves_every_table(ready, click, qtbot) -> None:
    ready.session.unwrap(["temporal"])
    click("measure")
    tables = {table.objectName(): table for table in ready.findChildren(QTableWidget)}
    assert set(tables) == {"lobe_table", "result_table", "measure_table", "cells_table"}
    for name, table in tables.items():
        assert not table.tabKeyNavigation(), name
    ready.show_step(1)
    table = tables["lobe_table"]
    QApplication.processEvents()
    ready.window().activateWindow()
    table.setFocus()
    table.setCurrentCell(0, 0)
    qtbot.waitUntil(table.hasFocus, timeout=60_000)
    for _ in range(3):
        QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Tab)
    assert not table.isAncestorOf(QApplication.focusWidget())
    assert QApplication.focusWidget() is not table


@pytest.mark.thorough
def test_the_dock_grows_with_the_font(dock, qtbot) -> None:
    settings = get_settings().appearance
    before, size = dock.minimumWidth(), settings.font_size
    heading = dock.sections[0].heading
    low = heading.fontMetrics().height()
    settings.font_size = int(1.5 * size)
    try:
        qtbot.waitUntil(lambda: dock.minimumWidth() > before, timeout=60_000)
        assert heading.fontMetrics().height() > low
        assert heading.height() >= heading.fontMetrics().height()
    finally:
        settings.font_size = size
    qtbot.waitUntil(lambda: dock.minimumWidth() == before, timeout=60_000)


LOBES = [p4d.Lobe((0.1, 0.05), 0.05), p4d.Lobe((-0.2, 0.25), 0.05)]


def letters_in(plot: CurvePlot, spectrum: SpectrumCanvas, strip: ViewStrip) -> dict[str, float]:
    """Return how large the letters of plot, spectrum and captions are, by what is drawn."""
    axes, legend = plot.figure.axes[0], plot.figure.legends[0]
    canvas = spectrum.grab().toImage()
    places = [(x, y) for x in range(canvas.width()) for y in range(canvas.height())]
    colours = Counter(canvas.pixelColor(x, y).name() for x, y in places)
    grey = sum(count for name, count in colours.items() if name[1:3] == name[3:5] == name[5:])
    return {
        "label": axes.xaxis.label.get_window_extent().height,
        "ticks": axes.get_xticklabels()[0].get_window_extent().height,
        "legend": legend.get_texts()[0].get_window_extent().height,
        "number of a circle": colours[VIEW_COLORS[0]],
        "name of a beat": grey - colours["#000000"],
        "caption": strip.height() - strip.places()[0].height(),
    }


@pytest.mark.thorough
def test_pictures_and_plots_grow_with_the_font(dock, qtbot) -> None:
    plot, spectrum, strip = made = CurvePlot(dock), SpectrumCanvas(dock), ViewStrip(dock)
    for picture, side in zip(made, (300, 230, 160), strict=True):
        picture.setFixedSize(side, side)  # so that it is the letters that grow
        picture.show()
    spectrum.set_lobes(LOBES)
    strip.set_views([np.zeros((90, 90), np.float32)], ["view 1"])
    plot.show_curves([0, 1, 2], {"region 1": [1, 2, 3]}, "time (s)", "dry mass (pg)")
    QApplication.processEvents()
    frames = dock.unwrap.boundary.map
    before, high = letters_in(*made), frames.sizeHint().height()
    settings = get_settings().appearance
    width, size = dock.minimumWidth(), settings.font_size
    settings.font_size = round(1.5 * size)
    try:
        qtbot.waitUntil(lambda: dock.minimumWidth() > width, timeout=60_000)
        QApplication.processEvents()
        after = letters_in(*made)
        for name in ("label", "ticks", "legend"):
            assert after[name] > 1.25 * before[name], name
        assert all(after[name] > before[name] for name in before), (before, after)
        assert frames.sizeHint().height() > high
    finally:
        settings.font_size = size
    qtbot.waitUntil(lambda: dock.minimumWidth() == width, timeout=60_000)
    QApplication.processEvents()
    assert letters_in(*made) == before


@pytest.mark.thorough
def test_the_window_is_no_larger_than_the_screen(viewer, qtbot) -> None:
    viewer.window.resize(3000, 2000)
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    room = dock.screen().availableGeometry()
    window = dock.window()
    qtbot.waitUntil(lambda: window.width() <= room.width(), timeout=60_000)
    assert window.height() <= room.height()
    dock.jobs.cancel()


@pytest.mark.thorough
def test_the_way_to_where_methods_disagree(viewer, ready, click, qtbot) -> None:
    ready.session.unwrap(["spatial-2d", "temporal", "directional-l1"])
    qtbot.waitUntil(lambda: bool(ready.session.confidence), timeout=60_000)
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=60_000)
    verdict = ready.session.verdict
    ready.show_step(4)
    table = ready.compare.figures.table
    bold = [
        table.item(row, 0).text()
        for row in range(table.rowCount())
        if table.item(row, 0).font().bold()
    ]
    label = ready.session.outcome.comparison.table["method"][verdict.method]
    assert bold == [label]
    if verdict.frame is None:
        assert not ready.compare.worst.isVisible()
    else:
        click("leave_grid")
        click("show_worst")
        assert ready.presenter.current_frame() == verdict.frame
        assert viewer.canvas.grid.enabled


def blue(widget: QWidget) -> int:
    """Count the pixels of the colour that says where the keyboard is."""
    image = widget.grab().toImage()
    places = ((x, y) for x in range(image.width()) for y in range(image.height()))
    return sum(image.pixelColor(x, y).name() == FOCUS_COLOUR for x, y in places)


@pytest.mark.thorough
def test_the_focus_is_seen(viewer, ready, qtbot) -> None:
    ready.window().activateWindow()
    for step, name in ((0, "open_file"), (1, "n_views"), (2, "reconstruct"), (3, "mask"),
                       (4, "show_difference")):  # fmt: skip
        ready.show_step(step)
        qtbot.wait(30)
        widget = ready.findChild(QWidget, name)
        ready.sections[step].heading.setFocus()
        without = blue(widget)
        widget.setFocus(Qt.FocusReason.TabFocusReason)
        qtbot.waitUntil(widget.hasFocus, timeout=60_000)
        qtbot.wait(30)
        assert blue(widget) > without + 10, name


SHARP = """
import sys
sys.path[:0] = {paths!r}
from qtpy.QtWidgets import QApplication
from test_stories import cut_off
import napari_phase4d as p4d
from napari_phase4d._napari.demo import viewer_with_dock

viewer, dock = viewer_with_dock(show=True)
viewer.window.resize(1280, 720)
assert dock.devicePixelRatioF() == 2
dock.session.set_phase(p4d.simulation.swimming_euglena((60, 72), 4)["wrapped"])
dock.session.unwrap(["spatial-2d", "temporal-angular"])
for number in range(len(dock.sections)):
    dock.show_step(number)
    for _ in range(20):
        QApplication.processEvents()
    assert cut_off(dock) == [], number
dock.jobs.cancel()
viewer.close()
print("sharp")
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_nothing_is_cut_where_a_pixel_is_four() -> None:
    here = Path(__file__).parent
    code = SHARP.format(paths=[str(here), str(here.parent)])
    # In a program of its own: Qt takes the scale of the screen when it starts.
    environment = {**os.environ, "QT_SCALE_FACTOR": "2"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env=environment, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    assert done.stdout.split()[-1:] == ["sharp"], done.stderr[-3000:]
