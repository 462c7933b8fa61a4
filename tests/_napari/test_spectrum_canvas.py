"""The circles of the spectrum canvas under a real mouse and real keys, to the pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from canvas_driving import EMPTY, LEFT, LOBES, NO_KEY, drag, mouse, point_of, scale_of
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QKeySequence
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QShortcut

from napari_phase4d._napari.widgets.spectrum_canvas import SpectrumCanvas
from napari_phase4d.holography import Lobe

pytestmark = pytest.mark.gui

SIGNALS = ("lobes_edited", "edit_started", "selected", "removal_wanted", "place_wanted")


@pytest.fixture
def heard(canvas: SpectrumCanvas) -> list[tuple[Any, ...]]:
    """What the canvas said: the name of the signal and what it carried."""
    said: list[tuple[Any, ...]] = []

    def listener(name: str) -> Callable[..., None]:
        return lambda *values: said.append((name, *values))

    for name in SIGNALS:
        getattr(canvas, name).connect(listener(name))
    return said


def names(heard: list[tuple[Any, ...]]) -> list[str]:
    return [each[0] for each in heard]


def test_drag_moves_a_circle_by_the_way_of_the_mouse(canvas, heard) -> None:
    start = point_of(canvas, 0.19, 0.21) + QPoint(5, -4)  # beside the middle: it must not jump
    drag(canvas, start, (3, 2), (20, -30), (-17, 12))
    scale = scale_of(canvas)
    expected = (0.19 + 12 / scale, 0.21 - 17 / scale)
    np.testing.assert_allclose(canvas.lobes[0].carrier, expected, atol=1e-9)
    assert (canvas.lobes[0].radius, canvas.lobes[0].angle_deg) == (0.09, -7)
    assert canvas.lobes[1] == LOBES[1]
    assert names(heard) == ["selected", "edit_started", *["lobes_edited"] * 3]
    np.testing.assert_allclose(heard[3][1][0].carrier, (0.19 - 30 / scale, 0.21 + 20 / scale))
    assert heard[-1][1] == canvas.lobes


@pytest.mark.parametrize("beside", [-3, 0, 4])
def test_drag_of_the_line_resizes_by_the_way_of_the_mouse(canvas, heard, beside: int) -> None:
    scale = scale_of(canvas)
    kx = 0.19 - 0.08 + beside / scale
    start = point_of(canvas, -0.21, kx)
    drag(canvas, start, (-4, 0), (-9, 0))
    assert canvas.lobes[1].carrier == LOBES[1].carrier
    # The mouse stands on whole pixels, not quite on the height of the carrier.
    assert canvas.lobes[1].radius == pytest.approx(0.08 + 9 / scale, abs=0.05 / scale)
    assert canvas.lobes[0] == LOBES[0]
    assert names(heard)[1:] == ["edit_started", "lobes_edited", "lobes_edited"]


def test_circles_stay_within_the_spectrum_and_do_not_vanish(canvas) -> None:
    drag(canvas, point_of(canvas, 0.19, 0.21), (5, 5), (500, -500))
    assert canvas.lobes[0].carrier == (-0.5, 0.5)
    line = point_of(canvas, -0.21, 0.19 + 0.08)
    drag(canvas, line, (round(-0.08 * scale_of(canvas)), 0))
    assert canvas.lobes[1].radius == pytest.approx(0.005, abs=0.5 / scale_of(canvas))
    drag(canvas, point_of(canvas, -0.21, 0.19), (1, 0))  # still there to be taken
    assert canvas.lobes[1].carrier != LOBES[1].carrier or canvas.lobes[1].radius > 0.005


def test_click_selects_without_changing_anything(canvas, heard) -> None:
    drag(canvas, point_of(canvas, -0.21, 0.19), (0, 0))
    assert canvas.chosen == 1
    assert [h for h in heard if h[0] == "selected"] == [("selected", 1)]
    np.testing.assert_allclose(canvas.lobes[1].carrier, LOBES[1].carrier, atol=1e-9)
    QTest.mouseClick(canvas.viewport(), LEFT, NO_KEY, point_of(canvas, *EMPTY))
    assert canvas.chosen == -1
    assert heard[-1] == ("selected", -1)


def test_select_tells_only_what_is_new(canvas, heard) -> None:
    for index in (1, 1, 0, 5, -1):
        canvas.select(index)
    assert heard == [("selected", 1), ("selected", 0), ("selected", -1)]
    canvas.select(1)
    canvas.set_lobes(LOBES[:1])
    assert heard[-1] == ("selected", -1)


def test_chosen_circle_is_the_one_that_is_dragged_where_two_overlap(canvas) -> None:
    canvas.set_lobes([Lobe((0.2, 0.2), 0.1), Lobe((0.2, 0.23), 0.1)])
    between = point_of(canvas, 0.2, 0.217)
    drag(canvas, between, (0, 20))
    assert canvas.lobes[1].carrier != (0.2, 0.23)  # the nearer one
    canvas.set_lobes([Lobe((0.2, 0.2), 0.1), Lobe((0.2, 0.23), 0.1)])
    canvas.select(0)
    drag(canvas, between, (0, 20))
    assert canvas.lobes[1].carrier == (0.2, 0.23)
    assert canvas.lobes[0].carrier[0] == pytest.approx(0.2 + 20 / scale_of(canvas))


@pytest.mark.parametrize(
    ("key", "modifier", "carrier", "radius"),
    [
        (Qt.Key.Key_Up, NO_KEY, (-0.001, 0), 1),
        (Qt.Key.Key_Down, NO_KEY, (0.001, 0), 1),
        (Qt.Key.Key_Left, NO_KEY, (0, -0.001), 1),
        (Qt.Key.Key_Right, Qt.KeyboardModifier.KeypadModifier, (0, 0.001), 1),
        (Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier, (-0.01, 0), 1),
        (Qt.Key.Key_Right, Qt.KeyboardModifier.ShiftModifier, (0, 0.01), 1),
        (Qt.Key.Key_Plus, Qt.KeyboardModifier.ShiftModifier, (0, 0), 1.02),
        (Qt.Key.Key_Equal, NO_KEY, (0, 0), 1.02),
        (Qt.Key.Key_Minus, NO_KEY, (0, 0), 1 / 1.02),
    ],
)
def test_keys_move_and_resize_the_chosen_circle(
    canvas, heard, key: Any, modifier: Any, carrier: tuple, radius: float
) -> None:
    QTest.keyClick(canvas, key, modifier)
    assert not heard  # none is chosen
    canvas.select(1)
    QTest.keyClick(canvas, key, modifier)
    expected = np.add(LOBES[1].carrier, carrier)
    np.testing.assert_allclose(canvas.lobes[1].carrier, expected, atol=1e-12)
    assert canvas.lobes[1].radius == pytest.approx(0.08 * radius, rel=1e-12)
    assert canvas.lobes[0] == LOBES[0]
    assert names(heard[1:]) == ["edit_started", "lobes_edited"]
    assert heard[2][1] == canvas.lobes


def test_keys_stop_at_the_edges(canvas) -> None:
    canvas.set_lobes([Lobe((0.495, 0.0), 0.495)])
    canvas.select(0)
    QTest.keyClick(canvas, Qt.Key.Key_Down, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClick(canvas, Qt.Key.Key_Plus)
    assert canvas.lobes == [Lobe((0.5, 0.0), 0.5)]


def test_delete_asks_for_removal(canvas, heard) -> None:
    QTest.keyClick(canvas, Qt.Key.Key_Delete)
    assert not heard
    canvas.select(1)
    QTest.keyClick(canvas, Qt.Key.Key_Delete)
    QTest.keyClick(canvas, Qt.Key.Key_Backspace)
    assert heard[1:] == [("removal_wanted", 1), ("removal_wanted", 1)]
    assert canvas.lobes == LOBES  # the owner removes


def test_number_keys_choose_circles(canvas, heard) -> None:
    for key in (Qt.Key.Key_2, Qt.Key.Key_1, Qt.Key.Key_3):
        QTest.keyClick(canvas, key)
    assert heard == [("selected", 1), ("selected", 0)]


def test_keys_are_not_taken_by_shortcuts_of_the_window(canvas, heard) -> None:
    fired: list[str] = []
    shortcuts = []
    for keys in ("Delete", "Left", "0", "Ctrl+Left"):
        shortcut = QShortcut(QKeySequence(keys), canvas.window())
        shortcut.activated.connect(lambda keys=keys: fired.append(keys))
        shortcuts.append(shortcut)
    canvas.select(0)
    window = canvas.window().windowHandle()
    for key in (Qt.Key.Key_Delete, Qt.Key.Key_Left, Qt.Key.Key_0):
        QTest.keyClick(window, key)
    assert fired == []
    assert names(heard)[1:] == ["removal_wanted", "edit_started", "lobes_edited"]
    QTest.keyClick(window, Qt.Key.Key_Left, Qt.KeyboardModifier.ControlModifier)
    assert fired == ["Ctrl+Left"]
    assert len(heard) == 4


def test_double_click_beside_the_circles_asks_for_one_more(canvas, heard) -> None:
    point = point_of(canvas, *EMPTY)
    mouse(canvas, "double", point)
    assert [h[0] for h in heard] == ["place_wanted"]
    np.testing.assert_allclose(heard[0][1:], EMPTY, atol=0.75 / scale_of(canvas))
    assert canvas.lobes == LOBES


@pytest.mark.parametrize(
    "where",
    [(0.19, 0.21), (-0.21, 0.27), (0.0, 0.58)],
    ids=["in a circle", "on a line", "outside the spectrum"],
)
def test_double_click_elsewhere_asks_for_nothing(canvas, heard, where: tuple) -> None:
    mouse(canvas, "double", point_of(canvas, *where))
    assert "place_wanted" not in names(heard)
    np.testing.assert_allclose([x.carrier for x in canvas.lobes], [x.carrier for x in LOBES])


@pytest.mark.parametrize("where", [(0.02, 0.03), (0.4, 0.02), (-0.39, -0.03), (-0.19, -0.21)])
def test_ghosts_are_not_in_the_way(canvas, heard, where: tuple[float, float]) -> None:
    """The zero order, both beats and a conjugate take neither clicks nor drags."""
    drag(canvas, point_of(canvas, *where), (8, 8), (20, 8))
    mouse(canvas, "double", point_of(canvas, *where))
    assert canvas.lobes == LOBES
    assert names(heard) == ["place_wanted"]


def test_click_gives_the_focus(qtbot, canvas) -> None:
    canvas.clearFocus()
    assert not canvas.hasFocus()
    QTest.mouseClick(
        canvas.window().windowHandle(), LEFT, NO_KEY,
        canvas.viewport().mapTo(canvas.window(), point_of(canvas, *EMPTY)),
    )  # fmt: skip
    qtbot.waitUntil(canvas.hasFocus)


def test_frequency_under_the_mouse_is_told(canvas) -> None:
    told: list[tuple[float, float]] = []
    canvas.frequency_shown.connect(lambda ky, kx: told.append((ky, kx)))
    mouse(canvas, "move", point_of(canvas, -0.31, 0.12), Qt.MouseButton.NoButton)
    np.testing.assert_allclose(told, [(-0.31, 0.12)], atol=0.75 / scale_of(canvas))


def test_circle_may_vanish_while_it_is_held(canvas, heard) -> None:
    """Such as by an undo, or a new recording: the drag ends, and so does the step of undo."""
    point = point_of(canvas, *LOBES[1].carrier)
    mouse(canvas, "press", point)
    mouse(canvas, "move", point + QPoint(5, 5))
    canvas.set_lobes([])
    mouse(canvas, "move", point + QPoint(9, 9))
    mouse(canvas, "release", point + QPoint(9, 9))
    assert canvas.lobes == []
    assert names(heard).count("edit_started") == names(heard).count("lobes_edited") == 1
    canvas.set_lobes(LOBES)
    drag(canvas, point, (5, 5))
    assert names(heard).count("edit_started") == 2


def test_other_buttons_leave_the_circles_alone(canvas, heard) -> None:
    point = point_of(canvas, *LOBES[0].carrier)
    for button in (Qt.MouseButton.RightButton, Qt.MouseButton.MiddleButton):
        mouse(canvas, "press", point, button)
        mouse(canvas, "move", point + QPoint(9, 9), button)
        mouse(canvas, "release", point + QPoint(9, 9), button)
    assert canvas.lobes == LOBES
    assert heard == []


def test_drag_beside_the_circles_pans(canvas, heard) -> None:
    canvas.select(0)
    canvas.zoom_about(canvas.view_position(0, 0), 4)
    start = QPoint(90, 60)
    assert max(np.abs(canvas.plane.frequency(QPointF(start)))) < 0.12  # beside all circles
    before = canvas.view_position(0, 0)
    drag(canvas, start, (11, -7), (25, -30))
    moved = canvas.view_position(0, 0) - before
    np.testing.assert_allclose((moved.x(), moved.y()), (25, -30), atol=1)
    assert canvas.lobes == LOBES
    assert names(heard) == ["selected"]  # a drag is no click: the view stays chosen
    drag(canvas, start, (4000, 4000))  # as far as the plane goes
    edge = canvas.view_position(-0.5, -0.5)
    assert -1 <= edge.x() <= 1
    assert -1 <= edge.y() <= 1
