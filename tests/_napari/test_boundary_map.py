"""The map of frames: its clicks and keys, and what is painted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from qtpy.QtCore import QEvent, QPoint, QPointF, Qt
from qtpy.QtGui import QColor, QFontMetricsF, QHelpEvent, QImage, QKeySequence, QPalette, QShortcut
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QDockWidget, QLineEdit, QToolTip, QVBoxLayout, QWidget

from napari_phase4d._napari.widgets.boundary_map import BoundaryMap

NO_KEY, SHIFT = Qt.KeyboardModifier.NoModifier, Qt.KeyboardModifier.ShiftModifier
LEFT_BUTTON = Qt.MouseButton.LeftButton
WHITE, BLACK = "#ffffff", "#000000"


@pytest.fixture
def shown(qtbot: Any) -> Any:
    """Make a map of so many times and angles and show it."""

    def make(n_times: int = 40, angles: tuple[float, ...] = (-7, 21)) -> BoundaryMap:
        widget = BoundaryMap()
        qtbot.addWidget(widget)
        widget.setAutoFillBackground(True)
        widget.set_frames(np.arange(n_times) / 6, angles)
        widget.resize(widget.sizeHint())
        widget.show()
        qtbot.waitExposed(widget)
        # A pointer that an earlier test left on the very spot would not move.
        QTest.mouseMove(widget, QPoint(1, 1))
        return widget

    return make


def point_at(qtbot: Any, widget: BoundaryMap, t: int, a: int) -> None:
    """Move the mouse to a frame and wait until the map knows: the screen tells it later."""
    QTest.mouseMove(widget, spot(widget, t, a))
    qtbot.waitUntil(lambda: widget.pointed == (t, a))


def spot(widget: BoundaryMap, t: int, a: int) -> QPoint:
    place = widget.cell_position(t, a)
    return QPoint(int(place.x()), int(place.y()))


def picture(widget: BoundaryMap) -> QImage:
    return widget.grab().toImage()


def colour(widget: BoundaryMap, t: int, a: int, dx: float = 0, dy: float = 0) -> str:
    """Colour of a pixel beside the middle of a frame."""
    place = widget.cell_position(t, a) + QPointF(dx, dy)
    return picture(widget).pixelColor(int(place.x()), int(place.y())).name()


def hue(widget: BoundaryMap, t: int, a: int, dx: float = 0, dy: float = 0) -> str:
    """Whether a pixel is blue, red or neither."""
    red, _, blue, _ = QColor(colour(widget, t, a, dx, dy)).getRgb()
    return "blue" if blue - red > 80 else "red" if red - blue > 80 else ""


def pixels(image: QImage) -> np.ndarray:
    """RGB of every pixel."""
    image = image.convertToFormat(QImage.Format.Format_RGB32)
    rows = [
        [QColor(image.pixel(x, y)).getRgb()[:3] for x in range(image.width())]
        for y in range(image.height())
    ]
    return np.array(rows)


@pytest.mark.gui
def test_a_click_tells_the_frame_and_shift(qtbot: Any, shown: Any) -> None:
    widget = shown()
    with qtbot.waitSignal(widget.frame_clicked) as got:
        QTest.mouseClick(widget, LEFT_BUTTON, NO_KEY, spot(widget, 12, 0))
    assert got.args == [12, 0, False]
    with qtbot.waitSignal(widget.frame_clicked) as got:
        QTest.mouseClick(widget, LEFT_BUTTON, SHIFT, spot(widget, 39, 1))
    assert got.args == [39, 1, True]


@pytest.mark.gui
def test_only_the_left_button_on_the_frames_clicks(qtbot: Any, shown: Any) -> None:
    widget = shown()
    with qtbot.assertNotEmitted(widget.frame_clicked):
        QTest.mouseClick(widget, Qt.MouseButton.RightButton, NO_KEY, spot(widget, 3, 0))
        QTest.mouseClick(widget, LEFT_BUTTON, NO_KEY, QPoint(1, 1))


@pytest.mark.gui
@pytest.mark.parametrize("n_times", [1, 19, 600, 5000])
@pytest.mark.parametrize("angles", [(0,), (-7, 21), tuple(range(0, 30, 5))])
def test_a_click_takes_the_nearest_of_any_number_of_frames(
    qtbot: Any, shown: Any, n_times: int, angles: tuple[float, ...]
) -> None:
    widget = shown(n_times, angles)
    clicked: list[tuple[int, int, bool]] = []
    widget.frame_clicked.connect(lambda *frame: clicked.append(frame))
    one_pixel = n_times / (
        widget.cell_position(n_times - 1, 0).x() - widget.cell_position(0, 0).x() + 1
    )
    for t in {0, n_times // 3, n_times - 1}:
        for a in range(len(angles)):
            QTest.mouseClick(widget, LEFT_BUTTON, NO_KEY, spot(widget, t, a))
            assert abs(clicked[-1][0] - t) <= one_pixel + 0.5
            assert clicked[-1][1] == a


@pytest.mark.gui
def test_the_mouse_points_and_leaves(qtbot: Any, shown: Any) -> None:
    widget = shown()
    with qtbot.waitSignal(widget.frame_hovered) as got:
        QTest.mouseMove(widget, spot(widget, 5, 1))
    assert got.args == [5, 1]
    with qtbot.assertNotEmitted(widget.frame_hovered):
        QTest.mouseMove(widget, spot(widget, 5, 1) + QPoint(1, 2))  # the same frame
    with qtbot.waitSignal(widget.left):
        QTest.mouseMove(widget, QPoint(2, 40))  # where the angles are written
    assert widget.pointed is None
    point_at(qtbot, widget, 5, 1)
    with qtbot.waitSignal(widget.left):
        QApplication.sendEvent(widget, QEvent(QEvent.Type.Leave))
    assert widget.pointed is None


@pytest.mark.gui
def test_the_keyboard_moves_a_cursor_and_clicks(qtbot: Any, shown: Any) -> None:
    widget = shown()
    widget.set_current((10, 0))
    hovered: list[tuple[int, int]] = []
    clicked: list[tuple[int, int, bool]] = []
    widget.frame_hovered.connect(lambda *frame: hovered.append(frame))
    widget.frame_clicked.connect(lambda *frame: clicked.append(frame))
    for key in (Qt.Key.Key_Right, Qt.Key.Key_Up, Qt.Key.Key_Up, Qt.Key.Key_Left, Qt.Key.Key_Down):
        QTest.keyClick(widget, key)
    assert hovered == [(11, 0), (11, 1), (10, 1), (10, 0)]  # it stops at the upper edge
    QTest.keyClick(widget, Qt.Key.Key_End)
    QTest.keyClick(widget, Qt.Key.Key_Right)
    QTest.keyClick(widget, Qt.Key.Key_Left, Qt.KeyboardModifier.ControlModifier)
    assert hovered[4:] == [(39, 0), (35, 0)]
    for key, held in (
        (Qt.Key.Key_Return, NO_KEY),
        (Qt.Key.Key_Space, NO_KEY),
        (Qt.Key.Key_Enter, SHIFT),
    ):
        QTest.keyClick(widget, key, held)
    assert clicked == [(35, 0, False), (35, 0, False), (35, 0, True)]
    QTest.keyClick(widget, Qt.Key.Key_Home)
    assert widget.pointed == (0, 0)


@pytest.mark.gui
def test_enter_shows_the_cursor_before_it_clicks(qtbot: Any, shown: Any) -> None:
    widget = shown()
    widget.set_boundaries([(7, 1)])
    with qtbot.assertNotEmitted(widget.frame_clicked):
        QTest.keyClick(widget, Qt.Key.Key_Return)
    assert widget.pointed == (7, 1)
    with qtbot.waitSignal(widget.frame_clicked) as got:
        QTest.keyClick(widget, Qt.Key.Key_Return)
    assert got.args == [7, 1, False]


@pytest.mark.gui
def test_tab_brings_the_cursor_and_takes_it_away(qtbot: Any) -> None:
    window = QWidget()
    qtbot.addWidget(window)
    column = QVBoxLayout(window)
    field, widget = QLineEdit(), BoundaryMap()
    column.addWidget(field)
    column.addWidget(widget)
    widget.set_frames(np.arange(9), [0, 10])
    widget.set_current((4, 1))
    taken: list[bool] = []
    shortcut = QShortcut(QKeySequence(Qt.Key.Key_Right), window)
    shortcut.activated.connect(lambda: taken.append(True))
    window.show()
    window.activateWindow()
    field.setFocus()
    qtbot.waitUntil(field.hasFocus)
    QTest.keyClick(field, Qt.Key.Key_Tab)
    qtbot.waitUntil(widget.hasFocus)
    assert widget.pointed == (4, 1)
    QTest.keyClick(widget, Qt.Key.Key_Right)
    assert widget.pointed == (5, 1)
    assert not taken  # a shortcut of the window does not take the key
    with qtbot.waitSignal(widget.left):
        QTest.keyClick(widget, Qt.Key.Key_Backtab)
    assert field.hasFocus()
    assert widget.pointed is None


@pytest.mark.gui
def test_scores_have_the_colours_of_the_scale(shown: Any) -> None:
    widget = shown(19, (0, 5, 10, 15, 20, 25))
    scores = np.linspace(0, 1, 19 * 6).reshape(19, 6)
    scores[4, 2] = np.nan
    widget.set_scores(scores)
    image = picture(widget)
    for t, a in np.ndindex(19, 6):
        found = image.pixelColor(spot(widget, int(t), int(a))).getRgb()[:3]
        if (t, a) == (4, 2):
            # Grey, perhaps with a stripe.
            assert max(found) - min(found) < 3
            continue
        wanted = colormaps["viridis"](float(scores[t, a]) ** 3, bytes=True)[:3]
        assert np.abs(np.subtract(found, [int(v) for v in wanted])).max() <= 3
    widget.set_scores(None)
    assert colour(widget, 0, 0) == colour(widget, 18, 5) == "#8a8a8a"


@pytest.mark.gui
@pytest.mark.parametrize("n_times", [1, 40, 600, 5000])
def test_the_star_is_at_the_best_frame(shown: Any, n_times: int) -> None:
    widget = shown(n_times)
    best = (n_times * 2 // 3, 1)
    scores = np.full((n_times, 2), 0.2)
    scores[best] = 1.0
    widget.set_scores(scores)
    # Even without the star, one safe frame of thousands is seen.
    assert QColor(colour(widget, *best)).getRgb()[:3] == pytest.approx((253, 231, 37), abs=3)
    widget.set_best(best)
    assert colour(widget, *best) == WHITE
    edge = [QColor(colour(widget, *best, dy=-d)).lightness() for d in range(5, 9)]
    assert min(edge) < 40
    widget.set_best(None)
    assert colour(widget, *best) != WHITE


@pytest.mark.gui
def test_starts_are_dark_squares_and_the_best_of_them_has_its_star(shown: Any) -> None:
    widget = shown()
    widget.set_boundaries([(5, 0), (20, 1)])
    assert colour(widget, 5, 0) == colour(widget, 20, 1) == BLACK
    assert colour(widget, 30, 1) == "#8a8a8a"
    widget.set_best((5, 0))
    assert colour(widget, 5, 0) == WHITE
    assert colour(widget, 5, 0, dx=-6, dy=-6) == BLACK
    widget.set_boundaries([])
    assert colour(widget, 20, 1) == "#8a8a8a"


@pytest.mark.gui
@pytest.mark.parametrize("n_times", [19, 600])
def test_the_current_frame_is_outlined(shown: Any, n_times: int) -> None:
    widget = shown(n_times)
    current = (n_times // 2, 0)
    widget.set_scores(np.full((n_times, 2), 0.5))
    before = pixels(picture(widget))
    widget.set_current(current)
    changed = np.argwhere((pixels(picture(widget)) != before).any(axis=2))
    top, left = changed.min(axis=0)
    bottom, right = changed.max(axis=0)
    middle = widget.cell_position(*current)
    assert (left + right) / 2 == pytest.approx(middle.x(), abs=1.5)
    assert (top + bottom) / 2 == pytest.approx(middle.y(), abs=1.5)
    assert right - left >= 7
    # It is an outline: the score in it is still there.
    assert colour(widget, *current) != WHITE
    half_height = widget.cell_position(0, 0).y() - widget.cell_position(0, 1).y()
    assert WHITE in {colour(widget, *current, dy=half_height / 2 - d) for d in range(4)}


@pytest.mark.gui
def test_the_cursor_is_drawn(qtbot: Any, shown: Any) -> None:
    widget = shown(19)
    before = pixels(picture(widget))
    point_at(qtbot, widget, 8, 1)
    changed = np.argwhere((pixels(picture(widget)) != before).any(axis=2))
    middle = widget.cell_position(8, 1)
    assert changed.mean(axis=0)[::-1] == pytest.approx([middle.x(), middle.y()], abs=1.5)


@pytest.mark.gui
def test_the_way_is_blue_first_and_then_red(shown: Any) -> None:
    widget = shown(9, (0, 10, 20))
    widget.set_boundaries([(4, 1)])
    across = widget.cell_position(1, 0).x() - widget.cell_position(0, 0).x()
    down = widget.cell_position(0, 1).y() - widget.cell_position(0, 2).y()
    x, y = across / 3, down / 2

    widget.set_path("temporal-angular")
    assert hue(widget, 2, 1, dx=x) == hue(widget, 6, 1, dx=x) == "blue"
    assert hue(widget, 2, 0, dx=x) == ""
    for t in (0, 3, 8):
        assert hue(widget, t, 1, dy=-y) == hue(widget, t, 1, dy=y) == "red"
    widget.set_path("angular-temporal")
    assert hue(widget, 4, 1, dy=-y) == hue(widget, 4, 1, dy=y) == "blue"
    assert hue(widget, 3, 1, dy=y) == ""
    for a in range(3):
        assert hue(widget, 2, a, dx=x) == hue(widget, 6, a, dx=x) == "red"
    widget.set_path("temporal")
    assert [hue(widget, 2, a, dx=x) for a in range(3)] == ["blue"] * 3
    widget.set_path("angular")
    assert [hue(widget, t, 1, dy=y) for t in range(9)] == ["blue"] * 9
    widget.set_path(None)
    assert {hue(widget, t, 1, dy=y) for t in range(9)} == {""}
    widget.set_path("temporal-angular")
    widget.set_boundaries([(4, 0), (2, 2)])  # the way leaves each of them
    assert [hue(widget, 6, a, dx=x) for a in range(3)] == ["blue", "", "blue"]
    widget.set_path("temporal")
    widget.set_boundaries([])
    assert hue(widget, 2, 0, dx=x) == ""  # nowhere to start from


@pytest.mark.gui
@pytest.mark.parametrize(("ink", "ground"), [("#f0f1f2", "#23242b"), ("#1e1e21", "#ebe7e6")])
def test_words_have_the_colour_of_the_theme(shown: Any, ink: str, ground: str) -> None:
    widget = shown()
    palette = QPalette()
    palette.setColor(QPalette.ColorRole.WindowText, QColor(ink))
    palette.setColor(QPalette.ColorRole.Window, QColor(ground))
    widget.setPalette(palette)
    seen = pixels(picture(widget))
    left = seen[:, : int(widget.cell_position(0, 0).x()) - 8]
    luminance = left.mean(axis=2)
    assert tuple(seen[0, 0]) == QColor(ground).getRgb()[:3]
    far = np.abs(luminance - luminance[0, 0]).max()
    wanted = abs(QColor(ink).lightness() - QColor(ground).lightness())
    assert far == pytest.approx(wanted, rel=0.25)


@pytest.mark.gui
def test_the_tooltip_speaks_of_the_frame(shown: Any) -> None:
    widget = shown()
    scores = np.full((40, 2), np.nan)
    scores[12, 0] = 0.987
    widget.set_scores(scores)
    widget.set_best((12, 0))
    widget.set_boundaries([(12, 0)])
    place = spot(widget, 12, 0)
    help_event = QHelpEvent(QEvent.Type.ToolTip, place, widget.mapToGlobal(place))
    QApplication.sendEvent(widget, help_event)
    assert QToolTip.text().splitlines() == [
        "Time 2 s (frame 12), viewing angle -7°.",
        "Safety as a start: 0.99 (0 unsafe, 1 safe).",
        "Safest frame.",
        "Unwrapping starts here.",
        "Click to start here, Shift+click to start here as well.",
    ]
    QToolTip.hideText()


@pytest.mark.gui
def test_other_frames_bring_no_old_marks(qtbot: Any, shown: Any) -> None:
    widget = shown()
    widget.set_scores(np.ones((40, 2)))
    widget.set_best((39, 1))
    widget.set_boundaries([(39, 1)])
    point_at(qtbot, widget, 39, 1)
    with qtbot.waitSignal(widget.left):
        widget.set_frames(np.arange(3), [0.0])
    seen = {colour(widget, t, 0) for t in range(3)}
    assert seen == {"#8a8a8a"}


@pytest.mark.gui
def test_without_frames_it_says_so_and_takes_no_clicks(qtbot: Any, shown: Any) -> None:
    widget = shown()
    widget.set_frames([], [])
    assert len(np.unique(pixels(picture(widget)).reshape(-1, 3), axis=0)) > 1  # words
    with qtbot.assertNotEmitted(widget.frame_clicked):
        QTest.mouseClick(widget, LEFT_BUTTON, NO_KEY, widget.rect().center())
        QTest.keyClick(widget, Qt.Key.Key_Return)
    assert widget.pointed is None


@pytest.mark.gui
def test_it_fits_the_dock_and_its_rows(shown: Any) -> None:
    for angles in (1, 2, 6):
        widget = shown(19, tuple(range(angles)))
        size, screen = widget.sizeHint(), widget.screen().availableGeometry()
        assert 340 <= size.width() <= 380
        # On a high screen it is higher.
        assert 80 <= size.height() <= (130 if screen.height() < 1000 else 180)


@pytest.mark.gui
def test_what_does_not_fit_is_refused(shown: Any) -> None:
    widget = shown()
    with pytest.raises(ValueError, match=r"scores are \(2, 40\), but there are \(40, 2\) frames"):
        widget.set_scores(np.ones((2, 40)))
    for act in (widget.set_best, widget.set_current, lambda frame: widget.set_boundaries([frame])):
        with pytest.raises(ValueError, match=r"frame is \(40, 0\), but there are 40 times and 2"):
            act((40, 0))
    with pytest.raises(ValueError, match="path is 'A/T'"):
        widget.set_path("A/T")
    with pytest.raises(ValueError, match="there are 3 times and 0 angles"):
        widget.set_frames([0, 1, 2], [])


@pytest.mark.thorough
@pytest.mark.gui
def test_the_legend_keeps_its_last_word_beside_a_scroll_bar(
    ready: Any, click: Any, qtbot: Any
) -> None:
    click("more_methods")
    click("options_region-growing")  # so that the panel has more than fits
    qtbot.waitUntil(ready.scroll.verticalScrollBar().isVisible, timeout=60_000)
    narrowest = ready.minimumWidth()
    panel = next(d for d in ready.window().findChildren(QDockWidget) if d.isAncestorOf(ready))
    ready.window().resizeDocks([panel], [narrowest], Qt.Orientation.Horizontal)
    qtbot.waitUntil(lambda: ready.width() == narrowest, timeout=60_000)
    widget = ready.unwrap.boundary.map
    shape = ready.session.reconstruction["phase"].shape[:2]
    widget.set_scores(np.full(shape, 0.9))
    widget.set_best((0, 0))
    widget.set_boundaries([(0, 0)])
    widget.set_path("temporal-angular")
    QApplication.processEvents()
    seen = pixels(picture(widget)).astype(int)
    legend = seen[: int(widget._grid().top)]
    red = np.flatnonzero((legend[..., 0] - legend[..., 2] > 80).any(axis=0))
    blue = np.flatnonzero((legend[..., 2] - legend[..., 0] > 80).any(axis=0))
    assert blue.size
    assert red.size
    assert red.max() > blue.max()
    # Right of the red arrow stands its word, whole.
    written = np.abs(legend - legend[0, 0]).max(axis=(0, 2)) > 60
    word = np.flatnonzero(written[red.max() + 2 :]) + red.max() + 2
    wide = QFontMetricsF(widget._font()).horizontalAdvance("then")
    assert word.size
    assert np.ptp(word) == pytest.approx(wide, abs=4)
    assert word.max() < widget.width() - 1
