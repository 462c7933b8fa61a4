"""A real viewer with the dock, and real clicks."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from canvas_driving import LOBES
from driving import let_settle
from npe2 import PluginManager
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QWidget

from napari_phase4d._napari.widgets.spectrum_canvas import SpectrumCanvas


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the window tests where there is no display to open a window on."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        reason = "needs a display; 'python3 dev.py test' brings one"
        for item in items:
            if item.get_closest_marker("gui"):
                item.add_marker(pytest.mark.skip(reason=reason))


def pytest_collection_finish() -> None:
    """Let garbage collection pass over what was imported: napari collects after every window."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def only_this_plugin() -> None:
    """Leave out the plugin that bioio brings along: it can't be told twice of a viewer."""
    PluginManager.instance().disable("ome-types")


@pytest.fixture(scope="session", autouse=True)
def no_widget_is_left_over() -> Iterator[None]:
    """Let a test fail whose window leaves widgets behind."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NAPARI_STRICT_QT", "raise")
        yield


@pytest.fixture
def viewer(make_napari_viewer: Callable[..., Any]) -> Any:
    viewer = make_napari_viewer(show=True)
    viewer.window.resize(1280, 720)
    return viewer


@pytest.fixture(scope="session")
def libraries() -> None:
    """Load what a panel loads in a thread, before there is one.

    While a library is imported, Python's filters of warnings are changed for all threads, so that
    a warning of the worker of a test would end it.
    """
    from napari_phase4d._napari.beginning import start_loop
    from napari_phase4d.later import load_ahead

    load_ahead((start_loop,), lambda: False).join()


@pytest.fixture
def dock(viewer: Any, libraries: None) -> Iterator[Any]:
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    yield dock
    dock.jobs.cancel()


@pytest.fixture
def click(dock: Any, qtbot: Any) -> Callable[[str], None]:
    """Click on a widget of the dock by its name, as the mouse does, and wait for its job."""

    def click(name: str) -> None:
        widget = dock.findChild(QWidget, name)
        assert widget is not None, name
        section = next(s for s in dock.sections if s.isAncestorOf(widget))
        if not section.is_open:
            qtbot.mouseClick(section.heading, Qt.MouseButton.LeftButton)
        tabs = dock.compare.tabs
        for number in range(tabs.count()):
            if tabs.widget(number).isAncestorOf(widget) and tabs.currentIndex() != number:
                place = tabs.tabBar().tabRect(number).center()
                qtbot.mouseClick(tabs.tabBar(), Qt.MouseButton.LeftButton, pos=place)
        more = dock.unwrap.list.more
        if dock.unwrap.list.rest.isAncestorOf(widget) and not more.isChecked():
            dock.scroll.ensureWidgetVisible(more)
            qtbot.mouseClick(more, Qt.MouseButton.LeftButton)
        QApplication.processEvents()  # so that a section just opened has its size
        dock.scroll.ensureWidgetVisible(widget)
        assert widget.isVisible()
        # A check box takes clicks on its box, at the left.
        position = QPoint(10, widget.height() // 2)
        QTest.mouseClick(
            widget, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, position
        )
        let_settle(qtbot, dock)

    return click


@pytest.fixture
def tick_only(dock: Any) -> Callable[..., None]:
    """Tick some methods: six results, side by side, take seconds to show."""

    def tick_only(*methods: str) -> None:
        dock.session.update(methods=methods)

    return tick_only


@pytest.fixture
def ready(dock, small_video):
    """Return the dock with a small video, its lobes and phase."""
    dock.session.set_recording(small_video)
    dock.session.find_lobes()
    dock.session.reconstruct()
    return dock


@pytest.fixture
def compared(ready: Any, qtbot: Any) -> Any:
    """Return that dock with two results."""
    ready.session.unwrap(["spatial-2d", "temporal-angular"])
    let_settle(qtbot, ready)
    return ready


@pytest.fixture
def canvas(qtbot: Any) -> SpectrumCanvas:
    canvas = SpectrumCanvas()
    qtbot.addWidget(canvas)
    canvas.resize(280, 240)
    canvas.set_lobes(LOBES)
    with qtbot.waitExposed(canvas):
        canvas.show()
    canvas.activateWindow()
    canvas.setFocus()
    qtbot.waitUntil(canvas.hasFocus)
    return canvas
