"""The spectrum canvas under a real mouse and real keys, to the pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from qtpy.QtCore import QEvent, QPoint, QPointF, Qt
from qtpy.QtGui import QColor, QKeySequence, QMouseEvent, QWheelEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QApplication,
    QLabel,
    QLineEdit,
    QScrollArea,
    QShortcut,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.widgets.spectrum_canvas import VIEW_COLORS, SpectrumCanvas
from napari_phase4d.holography import Lobe

pytestmark = pytest.mark.gui

LEFT, NO_KEY = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
LOBES = [Lobe((0.19, 0.21), 0.09, -7.0), Lobe((-0.21, 0.19), 0.08, 21.0)]
EMPTY = (0.05, -0.42)
SIGNALS = (
    "lobes_edited", "edit_started", "edit_finished", "selected", "removal_wanted", "place_wanted",
)  # fmt: skip


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


def scale_of(canvas: SpectrumCanvas) -> float:
    """Pixels for one cycle per pixel: the plane fills the shorter side, less a pixel each way."""
    size = canvas.viewport().size()
    return (min(size.width(), size.height()) - 2) * canvas.zoom


def point_of(canvas: SpectrumCanvas, ky: float, kx: float) -> QPoint:
    """Where a frequency is on the whole plane, worked out from the size of the viewport."""
    assert canvas.zoom == 1
    size, scale = canvas.viewport().size(), scale_of(canvas)
    return QPoint(round(size.width() / 2 + kx * scale), round(size.height() / 2 + ky * scale))


def mouse(canvas: SpectrumCanvas, kind: str, point: QPoint, button: Any = LEFT) -> None:
    """Press, move, release or double click on the viewport."""
    viewport = canvas.viewport()
    if kind == "move":  # QTest moves the pointer of the machine, which some displays do not have
        place = QPointF(point)
        event = QMouseEvent(
            QEvent.Type.MouseMove, place, QPointF(viewport.mapToGlobal(point)),
            Qt.MouseButton.NoButton, button, NO_KEY,
        )  # fmt: skip
        QApplication.sendEvent(viewport, event)
        return
    does = {"press": QTest.mousePress, "release": QTest.mouseRelease, "double": QTest.mouseDClick}
    does[kind](viewport, button, NO_KEY, point)


def drag(canvas: SpectrumCanvas, start: QPoint, *way: tuple[int, int]) -> None:
    """Drag over some points, given in pixels from the start."""
    mouse(canvas, "press", start)
    for dx, dy in way:
        mouse(canvas, "move", start + QPoint(dx, dy))
    mouse(canvas, "release", start + QPoint(*way[-1]))


def turn_wheel(canvas: SpectrumCanvas, point: QPoint, notches: float) -> bool:
    """Turn the wheel over a point; say whether the canvas took it."""
    viewport = canvas.viewport()
    event = QWheelEvent(
        QPointF(point), QPointF(viewport.mapToGlobal(point)), QPoint(),
        QPoint(0, int(120 * notches)), Qt.MouseButton.NoButton, NO_KEY,
        Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(viewport, event)
    return bool(event.isAccepted())


def pixels(canvas: SpectrumCanvas) -> np.ndarray:
    """What the viewport shows, (y, x, RGB)."""
    image = canvas.viewport().grab().toImage()
    image = image.convertToFormat(image.Format.Format_RGB888)
    bits = image.constBits()
    data = bits.asstring(image.sizeInBytes()) if hasattr(bits, "asstring") else bytes(bits)
    rows = np.frombuffer(data, np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def spectrum(shape: tuple[int, int], *peaks: tuple[float, float]) -> xr.DataArray:
    """Noise with bright spots, more than single pixels where there are many."""
    power = np.random.default_rng(0).exponential(1, shape)
    half = min(shape) // 128
    for ky, kx in peaks:
        y, x = round(ky * shape[0]) + shape[0] // 2, round(kx * shape[1]) + shape[1] // 2
        power[y - half : y + half + 1, x - half : x + half + 1] = 1e8
    return xr.DataArray(power.astype(np.float32), dims=("ky", "kx"))


@pytest.mark.parametrize("size", [(240, 240), (300, 230), (220, 290)])
def test_plane_is_a_square_in_the_middle(canvas, qtbot, size: tuple[int, int]) -> None:
    canvas.resize(*size)
    qtbot.waitUntil(lambda: (canvas.width(), canvas.height()) == size)
    for ky, kx in [(0, 0), (0.5, 0.5), (-0.5, 0.3), (0.19, -0.21)]:
        away = canvas.view_position(ky, kx) - QPointF(point_of(canvas, ky, kx))
        assert abs(away.x()) <= 1
        assert abs(away.y()) <= 1


@pytest.mark.parametrize("shape", [(64, 64), (65, 77), (500, 640), (1024, 1281)])
@pytest.mark.parametrize("zoom", [1, 3, 8])
def test_peaks_are_drawn_where_they_are(canvas, shape: tuple[int, int], zoom: int) -> None:
    """The brightest spot of the screen, however many pixels of the spectrum it holds."""
    ky, kx = round(0.2 * shape[0]) / shape[0], round(-0.3 * shape[1]) / shape[1]
    canvas.set_lobes([])
    canvas.set_spectrum(spectrum(shape, (ky, kx)))
    canvas.clearFocus()  # its frame is bright too
    canvas.zoom_about(canvas.view_position(ky, kx), zoom)
    grey = pixels(canvas).sum(axis=2)
    zero = canvas.view_position(0, 0)
    y, x = np.indices(grey.shape)
    grey[(abs(y - zero.y()) < 12) & (abs(x - zero.x()) < 12)] = 0  # the cross
    shown = grey > 0.8 * grey.max()
    expected = canvas.view_position(ky, kx)
    assert abs((x[shown] + 0.5).mean() - expected.x()) <= 1
    assert abs((y[shown] + 0.5).mean() - expected.y()) <= 1
    side = (2 * (min(shape) // 128) + 1) * canvas.plane.scale / min(shape)
    assert shown.sum() < 9 + 2 * side**2


def test_drag_moves_a_circle_by_the_way_of_the_mouse(canvas, heard) -> None:
    start = point_of(canvas, 0.19, 0.21) + QPoint(5, -4)  # beside the middle: it must not jump
    drag(canvas, start, (3, 2), (20, -30), (-17, 12))
    scale = scale_of(canvas)
    expected = (0.19 + 12 / scale, 0.21 - 17 / scale)
    np.testing.assert_allclose(canvas.lobes[0].carrier, expected, atol=1e-9)
    assert (canvas.lobes[0].radius, canvas.lobes[0].angle_deg) == (0.09, -7)
    assert canvas.lobes[1] == LOBES[1]
    assert names(heard) == ["selected", "edit_started", *["lobes_edited"] * 3, "edit_finished"]
    np.testing.assert_allclose(heard[3][1][0].carrier, (0.19 - 30 / scale, 0.21 + 20 / scale))
    assert heard[-2][1] == canvas.lobes


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
    assert names(heard)[1:] == ["edit_started", "lobes_edited", "lobes_edited", "edit_finished"]


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
    assert names(heard[1:]) == ["edit_started", "lobes_edited", "edit_finished"]
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
    assert names(heard)[1:] == ["removal_wanted", "edit_started", "lobes_edited", "edit_finished"]
    QTest.keyClick(window, Qt.Key.Key_Left, Qt.KeyboardModifier.ControlModifier)
    assert fired == ["Ctrl+Left"]
    assert len(heard) == 5


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


def share_drawn(
    canvas: SpectrumCanvas, centre: tuple[float, float], radius: float, beside: int = 1
) -> float:
    """Share of a circle within the plane that is drawn, or has something so near, in pixels."""
    shown = pixels(canvas).sum(axis=2) > 60
    turns = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ky, kx = centre[0] + radius * np.sin(turns), centre[1] + radius * np.cos(turns)
    inside = (abs(ky) < 0.49) & (abs(kx) < 0.49)
    points = [canvas.view_position(*k) for k in zip(ky[inside], kx[inside], strict=True)]
    drawn = []
    for x, y in ((int(p.x()), int(p.y())) for p in points):
        near = shown[y - beside : y + beside + 1, x - beside : x + beside + 1]
        drawn.append(near.any())
    return float(np.mean(drawn))


def test_zero_order_and_beats_are_drawn_as_far_as_they_reach(canvas) -> None:
    """Twice the larger radius round zero; both radii together round +-(k1 - k2)."""
    canvas.clearFocus()
    for centre, radius in [((0, 0), 0.18), ((0.4, 0.02), 0.17), ((-0.4, -0.02), 0.17)]:
        assert share_drawn(canvas, centre, radius) > 0.9
        assert share_drawn(canvas, centre, radius, beside=0) < 0.7  # dotted
        assert share_drawn(canvas, centre, radius - 0.03) < 0.35
    for lobe in LOBES:
        assert share_drawn(canvas, lobe.carrier, lobe.radius, beside=0) > 0.99
        conjugate = (-lobe.carrier[0], -lobe.carrier[1])
        assert share_drawn(canvas, conjugate, lobe.radius) > 0.9
        assert share_drawn(canvas, conjugate, lobe.radius, beside=0) < 0.9  # dashed
    canvas.set_lobes([])
    assert share_drawn(canvas, (0, 0), 0.18) < 0.1  # but for the sentence


def coloured(canvas: SpectrumCanvas, index: int) -> int:
    color = QColor(VIEW_COLORS[index])
    away = pixels(canvas) - np.array([color.red(), color.green(), color.blue()])
    return int((np.abs(away).max(axis=2) < 12).sum())


def test_chosen_circle_is_thicker(canvas) -> None:
    before = [coloured(canvas, i) for i in (0, 1)]
    canvas.select(1)
    after = [coloured(canvas, i) for i in (0, 1)]
    assert after[0] == before[0]
    assert after[1] > 1.5 * before[1]


def test_wheel_zooms_about_the_mouse(canvas, qtbot) -> None:
    canvas.resize(240, 240)
    qtbot.waitUntil(lambda: canvas.width() == 240)
    point = point_of(canvas, 0.19, 0.21)
    before = canvas.plane.frequency(QPointF(point))
    for _ in range(4):
        assert turn_wheel(canvas, point, 1)
        after = canvas.plane.frequency(QPointF(point))
        np.testing.assert_allclose(after, before, atol=1 / canvas.plane.scale)
    assert canvas.zoom == pytest.approx(1.25**4)
    assert canvas.plane.scale == pytest.approx(scale_of(canvas))
    for _ in range(9):
        turn_wheel(canvas, point, 2)
    assert canvas.zoom == 8
    for _ in range(20):
        turn_wheel(canvas, point, -1)
    assert canvas.zoom == 1
    away = canvas.view_position(0, 0) - QPointF(point_of(canvas, 0, 0))
    assert max(abs(away.x()), abs(away.y())) <= 1


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


@pytest.mark.parametrize("how", ["key 0", "double click in the middle"])
def test_zoom_is_taken_back(canvas, how: str) -> None:
    turn_wheel(canvas, QPoint(30, 50), 5)
    assert canvas.zoom > 3
    if how == "key 0":
        QTest.keyClick(canvas, Qt.Key.Key_0)
    else:
        mouse(canvas, "double", QPoint(50, 60), Qt.MouseButton.MiddleButton)
    assert canvas.zoom == 1
    away = canvas.view_position(0.3, -0.2) - QPointF(point_of(canvas, 0.3, -0.2))
    assert max(abs(away.x()), abs(away.y())) <= 1


def test_zoom_makes_drags_finer(canvas) -> None:
    canvas.zoom_about(canvas.view_position(0.19, 0.21), 5)
    start = canvas.view_position(0.19, 0.21).toPoint()
    drag(canvas, start, (10, 0))
    scale = 5 * (min(canvas.viewport().width(), canvas.viewport().height()) - 2)
    np.testing.assert_allclose(canvas.lobes[0].carrier, (0.19, 0.21 + 10 / scale), atol=1e-9)


def test_zoom_and_middle_outlive_a_new_size(canvas, qtbot) -> None:
    canvas.zoom_about(canvas.view_position(0.2, 0.2), 4)
    rect = canvas.viewport().rect()
    before = canvas.plane.frequency(QPointF(rect.width() / 2, rect.height() / 2))
    canvas.resize(320, 300)
    qtbot.waitUntil(lambda: canvas.width() == 320)
    rect = canvas.viewport().rect()
    after = canvas.plane.frequency(QPointF(rect.width() / 2, rect.height() / 2))
    np.testing.assert_allclose(after, before, atol=1.5 / scale_of(canvas))
    assert canvas.zoom == 4


def test_wheel_belongs_to_the_dock_without_the_focus(qtbot) -> None:
    area, inside = QScrollArea(), QWidget()
    column = QVBoxLayout(inside)
    canvas, field, below = SpectrumCanvas(), QLineEdit(), QLabel("much more")
    below.setFixedHeight(900)
    for widget in (canvas, field, below):
        column.addWidget(widget)
    area.setWidget(inside)
    area.setWidgetResizable(True)
    qtbot.addWidget(area)
    area.resize(330, 300)
    with qtbot.waitExposed(area):
        area.show()
    area.activateWindow()
    field.setFocus()
    qtbot.waitUntil(field.hasFocus)
    # Qt hands on what is not accepted, though only events that come from a machine's wheel.
    assert not turn_wheel(canvas, QPoint(100, 100), -1)
    assert canvas.zoom == 1
    QTest.keyClick(field, Qt.Key.Key_Backtab, Qt.KeyboardModifier.ShiftModifier)
    assert canvas.hasFocus()  # by the Tab key
    assert turn_wheel(canvas, QPoint(100, 100), 1)
    assert canvas.zoom == 1.25
    assert area.verticalScrollBar().value() == 0
    QTest.keyClick(canvas, Qt.Key.Key_Tab)
    assert field.hasFocus()


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
    assert names(heard).count("edit_started") == names(heard).count("edit_finished") == 1
    assert names(heard).count("lobes_edited") == 1


def test_other_buttons_leave_the_circles_alone(canvas, heard) -> None:
    point = point_of(canvas, *LOBES[0].carrier)
    for button in (Qt.MouseButton.RightButton, Qt.MouseButton.MiddleButton):
        mouse(canvas, "press", point, button)
        mouse(canvas, "move", point + QPoint(9, 9), button)
        mouse(canvas, "release", point + QPoint(9, 9), button)
    assert canvas.lobes == LOBES
    assert heard == []


def test_size_is_a_square_that_fits_a_dock() -> None:
    canvas = SpectrumCanvas()
    hint, least = canvas.sizeHint(), canvas.minimumSize()
    assert hint.width() == hint.height()
    assert (least.width(), least.height()) == (200, 200)
    assert [canvas.heightForWidth(w) for w in (150, 231, 900)] == [200, 231, 300]


@pytest.mark.parametrize("with_spectrum", [False, True])
def test_nothing_to_show_is_no_trouble(canvas, with_spectrum: bool) -> None:
    canvas.set_lobes([])
    canvas.set_spectrum(spectrum((32, 32)) if with_spectrum else None)
    assert pixels(canvas).max() > 60  # noise, or a sentence
    canvas.set_spectrum(None)
    canvas.clearFocus()
    grey = pixels(canvas).sum(axis=2)
    assert 0 < (grey > 60).mean() < 0.1
