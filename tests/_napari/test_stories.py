"""Stories by mouse and keyboard alone, each of a recording that has gone wrong in a window once.

The story of the sample itself is in `test_story.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driving import let_settle, open_by_click, saved
from napari.settings import get_settings
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QLabel,
    QLineEdit,
    QStyle,
    QStyleOptionComboBox,
    QTabBar,
    QTableWidget,
    QWidget,
)

import napari_phase4d as p4d
from napari_phase4d.recording import Recording
from napari_phase4d.sample import Sample

pytestmark = [pytest.mark.gui, pytest.mark.story]

#: More presses of Tab than this lead nowhere.
MOST_TABS = 150


@pytest.mark.thorough
def test_the_thin_moment_comes_at_the_end(
    dock, click, qtbot, tmp_path: Path, sample: Sample
) -> None:
    backwards = sample.recording.holograms.values[::-1]
    open_by_click(click, dock, saved(tmp_path, "reversed", backwards))
    click("find_lobes")
    click("reconstruct")
    qtbot.waitUntil(lambda: dock.session.scores is not None, timeout=60_000)
    # Nobody has chosen a frame to start from: it is the star, and not the first.
    time, angle = dock.session.start_frames[0]
    assert time > 30
    for method in ("spatial-2d", "angular", "temporal", "angular-temporal"):
        click(f"method_{method}")
    click("run")
    found = dock.session.results["temporal-angular"]
    assert found.attrs["boundary"][0] == [time, angle]
    # From the first frame, in which the cell is thickest, more of it would be wrong.
    phase = dock.session.reconstruction["phase"]
    first = p4d.unwrap(phase, "temporal-angular", (0, 0), mask="auto")
    best = dock.session.results["directional-l1"].values
    wrong, wrong_from_first = (float((np.abs(u.values - best) > 3).mean()) for u in (found, first))
    assert wrong < wrong_from_first / 2
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    assert dock.session.verdict.startswith("Use WL1")


@pytest.mark.thorough
def test_one_view_and_then_two(
    viewer, dock, click, tmp_path: Path, small_video: Recording
) -> None:
    exact = p4d.simulation.swimming_euglena((96, 112), 3, pixel_um=0.35, peak_rad=6)
    single = p4d.simulation.multiplexed_video(
        exact["phase"].isel(angle=[0]), carriers=[(0.19, 0.21)]
    )
    open_by_click(click, dock, saved(tmp_path, "single", single.holograms.values))
    click("find_lobes")
    assert len(dock.session.lobes) == 1
    click("reconstruct")
    assert dock.session.reconstruction["phase"].sizes["angle"] == 1
    open_by_click(click, dock, saved(tmp_path, "two", small_video.holograms.values))
    click("find_lobes")
    assert len(dock.session.lobes) == 2
    click("reconstruct")
    assert dock.session.reconstruction["phase"].sizes["angle"] == 2
    # The sliders go over the present recording alone: six frames, two views.
    assert viewer.dims.nsteps[:2] == (6, 2)


class ByKeyboard:
    """Goes through the dock with the Tab key and presses keys there."""

    def __init__(self, dock: Any, qtbot: Any) -> None:
        self.dock, self.qtbot = dock, qtbot
        dock.window().activateWindow()
        dock.sections[0].heading.setFocus()
        qtbot.waitUntil(dock.sections[0].heading.hasFocus, timeout=60_000)

    def go_to(self, name: str) -> QWidget:
        """Press Tab until the widget of this name has the focus."""
        for _ in range(MOST_TABS):
            focused = QApplication.focusWidget()
            assert focused is not None
            if focused.objectName() == name or (name == "tabs" and isinstance(focused, QTabBar)):
                return focused
            QTest.keyClick(focused, Qt.Key.Key_Tab)
        pytest.fail(f"no way to {name} by the Tab key")

    def press(self, name: str, *keys: Qt.Key) -> None:
        """Go to something and press keys there, by default the space bar; wait for what that does.

        Names are those of the widgets; "tabs" are those of step 5.
        """
        focused = self.go_to(name)
        for key in keys or (Qt.Key.Key_Space,):
            QTest.keyClick(focused, key)
        let_settle(self.qtbot, self.dock)
        QApplication.processEvents()


@pytest.mark.thorough
def test_by_keyboard_alone(viewer, dock, qtbot) -> None:
    press = ByKeyboard(dock, qtbot).press
    press("try_yeast")
    assert dock.session.reconstruction is not None
    for method in ("angular", "temporal", "angular-temporal"):
        press(f"method_{method}")
    press("run")
    assert list(dock.session.results) == ["spatial-2d", "temporal-angular", "directional-l1"]
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    press("show_difference")
    assert dock.presenter.showing == "difference"
    press("show_worst")
    assert dock.presenter.showing == "results"
    press("tabs", Qt.Key.Key_Right, Qt.Key.Key_Right)
    press("measure")
    assert len(dock.session.measured)


@pytest.mark.thorough
def test_lobes_and_start_by_keyboard_alone(viewer, dock, qtbot) -> None:
    press = ByKeyboard(dock, qtbot).press
    press("try_sample")
    press("find_lobes")
    before = dock.session.lobes
    assert len(before) == 2
    press("heading_lobes")  # which was folded once the views were found
    press("spectrum_canvas", Qt.Key.Key_2, Qt.Key.Key_Right)  # the second circle, by a step
    moved = dock.session.lobes
    assert sum(a.carrier != b.carrier for a, b in zip(before, moved, strict=True)) == 1
    press("find_lobes")
    press("reconstruct")
    qtbot.waitUntil(lambda: dock.session.scores is not None, timeout=60_000)
    press("boundary_map", Qt.Key.Key_Home, Qt.Key.Key_Right, Qt.Key.Key_Right, Qt.Key.Key_Return)
    assert dock.session.recipe.boundary == ((2, 0),)
    press("automatic")
    assert dock.session.recipe.boundary == "auto"
    for method in ("spatial-2d", "angular", "temporal", "angular-temporal"):
        press(f"method_{method}")
    press("run")
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    assert dock.session.verdict.startswith("Use WL1")


@pytest.mark.thorough
def test_a_file_whose_stacks_lie_on_disk(
    viewer, dock, click, qtbot, tick_only, tmp_path: Path, small_video: Recording
) -> None:
    open_by_click(click, dock, saved(tmp_path, "long", small_video.holograms.values))
    dock.session.update(storage="disk")  # else memory decides, and this one is small
    click("find_lobes")
    click("reconstruct")
    assert dock.session.reconstruction["phase"].chunks is not None
    tick_only("spatial-2d", "temporal-angular", "directional-l1")
    click("run")
    assert all(result.chunks is not None for result in dock.session.results.values())
    click("show_confidence")  # on disk nothing is weighed unasked
    assert dock.presenter.showing == "confidence"
    assert dock.session.verdict
    click("side_by_side")
    click("find_cells")
    assert dock.session.cells is not None
    for step in range(6):
        viewer.dims.set_current_step(0, step)
        QApplication.processEvents()
        assert dock.presenter.current_frame()[0] == step


@pytest.mark.thorough
def test_nothing_is_cut_in_a_large_font(viewer, dock, ready, qtbot) -> None:
    def nothing_cut() -> None:
        assert cut_off(dock) == []

    settings = get_settings().appearance
    size, width = settings.font_size, dock.minimumWidth()
    settings.font_size = round(1.5 * size)
    try:
        ready.session.unwrap(("spatial-2d", "temporal-angular"))
        qtbot.waitUntil(lambda: dock.minimumWidth() > width, timeout=60_000)
        for number in range(len(dock.sections)):
            dock.show_step(number)
            qtbot.wait(120)
            # What a worker has said meanwhile is given its room in the next turn of the window.
            qtbot.waitUntil(nothing_cut, timeout=5_000)
        for tab in range(dock.compare.tabs.count()):
            dock.compare.tabs.setCurrentIndex(tab)
            qtbot.wait(120)
            # What a worker has said meanwhile is given its room in the next turn of the window.
            qtbot.waitUntil(nothing_cut, timeout=5_000)
    finally:
        settings.font_size = size
    qtbot.waitUntil(lambda: dock.minimumWidth() == width, timeout=60_000)


@pytest.mark.thorough
def test_nothing_is_cut_on_a_small_screen(viewer, ready, click, qtbot) -> None:
    ready.session.unwrap(("angular", "directional-l1"))
    ready.session.measure()
    ready.session.find_cells()
    click("show_difference")
    assert (viewer.window.geometry()[2:]) == (1280, 720)
    cut = {}
    for number in range(len(ready.sections)):
        ready.show_step(number)
        qtbot.wait(60)
        cut[number] = cut_off(ready)
    for tab in range(ready.compare.tabs.count()):
        ready.compare.tabs.setCurrentIndex(tab)
        qtbot.wait(60)
        cut[ready.compare.tabs.tabText(tab)] = cut_off(ready)
    assert not any(cut.values()), cut


def cut_off(dock: Any) -> list[str]:
    """Return the names of what is narrower than its words, or beyond the panel's right edge."""
    port = dock.scroll.viewport()
    found = []
    kinds = (QAbstractButton, QLabel, QAbstractSpinBox, QComboBox, QTableWidget)
    for widget in (w for kind in kinds for w in port.findChildren(kind) if w.isVisible()):
        if not widget.objectName() or widget.objectName().startswith("qt_"):
            continue
        right = widget.mapTo(port, widget.rect().topRight()).x()
        words, room = words_and_room(widget)
        if right > port.width() or widget.fontMetrics().horizontalAdvance(words) > room:
            found.append(f"{widget.objectName()}: {words!r}")
        if isinstance(widget, QTableWidget) and widget.horizontalScrollBar().maximum():
            found.append(f"{widget.objectName()}: columns")
    return found


#: Free pixels that a field leaves at both sides of its text.
BESIDE_TEXT = 4


def words_and_room(widget: QWidget) -> tuple[str, float]:
    """Return what a widget says in one line, and how many pixels it has for that."""
    if isinstance(widget, QAbstractSpinBox):
        return widget.text(), widget.findChild(QLineEdit).width() - BESIDE_TEXT
    if isinstance(widget, QComboBox):
        option = QStyleOptionComboBox()
        option.initFrom(widget)
        part = QStyle.SubControl.SC_ComboBoxEditField
        box = widget.style().subControlRect(
            QStyle.ComplexControl.CC_ComboBox, option, part, widget
        )
        return widget.currentText(), box.width()
    if isinstance(widget, QTableWidget):
        return "", widget.width()
    words = widget.text()
    wraps = isinstance(widget, QLabel) and widget.wordWrap()
    return "" if wraps or "<" in words else words, widget.width()
