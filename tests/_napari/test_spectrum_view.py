"""What the spectrum canvas shows: peaks, circles, zoom, to the pixel."""

from __future__ import annotations

import numpy as np
import pytest
from canvas_driving import LOBES, drag, mouse, pixels, point_of, scale_of, spectrum, turn_wheel
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QColor
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QLabel, QLineEdit, QScrollArea, QVBoxLayout, QWidget

from napari_phase4d._napari.widgets.spectrum_canvas import VIEW_COLORS, SpectrumCanvas

pytestmark = pytest.mark.gui


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
