"""Use by keyboard, by screen reader, with a large font; and the way to where methods disagree."""

from __future__ import annotations

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

pytestmark = pytest.mark.gui

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
    for name in ("lobe_table", "results_table", "measure_table", "cells_table"):
        for table in ready.findChildren(QTableWidget):
            if table.objectName() == name:
                assert not table.tabKeyNavigation(), name
    ready.show_step(1)
    table = ready.findChild(QTableWidget, "lobe_table")
    QApplication.processEvents()
    ready.window().activateWindow()
    table.setFocus()
    table.setCurrentCell(0, 0)
    qtbot.waitUntil(table.hasFocus, timeout=3000)
    for _ in range(3):
        QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Tab)
    assert not table.isAncestorOf(QApplication.focusWidget())
    assert QApplication.focusWidget() is not table


def test_the_dock_grows_with_the_font(dock, qtbot) -> None:
    settings = get_settings().appearance
    before, size = dock.minimumWidth(), settings.font_size
    settings.font_size = int(1.5 * size)
    try:
        qtbot.waitUntil(lambda: dock.minimumWidth() > before, timeout=3000)
        heading = dock.sections[0].heading
        assert heading.height() >= heading.fontMetrics().height()
    finally:
        settings.font_size = size
    qtbot.waitUntil(lambda: dock.minimumWidth() == before, timeout=3000)


def test_the_window_is_no_larger_than_the_screen(viewer, qtbot) -> None:
    viewer.window.resize(3000, 2000)
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    room = dock.screen().availableGeometry()
    window = dock.window()
    qtbot.waitUntil(lambda: window.width() <= room.width(), timeout=3000)
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
