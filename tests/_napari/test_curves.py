"""Curves that are renewed in place: their numbers, limits, colours, files and end."""

from __future__ import annotations

import gc
import sys
import weakref
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from qtpy.QtCore import QEvent, QPoint, QPointF, Qt
from qtpy.QtGui import QColor, QImage, QPalette, QWheelEvent
from qtpy.QtWidgets import QApplication, QLabel, QScrollArea, QVBoxLayout, QWidget

from napari_phase4d._napari.widgets.curves import CurvePlot, Panel, curve_styles, steady_limits

TIMES = np.arange(60) / 6
ANGLES = np.array([-7.0, 21.0])
NAMES = ("2-D", "Angular", "Temporal", "T/A", "A/T", "LBE", "RG", "DE", "Directional L1")


def traces(factor: float = 1.0, at: float = 2.0) -> list[Panel]:
    """Nine methods over time and angle."""
    over_time = {n: factor * (np.sin(TIMES) + k) for k, n in enumerate(NAMES)}
    over_angle = {n: factor * (ANGLES / 10 + k) for k, n in enumerate(NAMES)}
    return [
        Panel(TIMES, over_time, "Time (s)", "Phase (rad)", at),
        Panel(ANGLES, over_angle, "Viewing angle (°)", at=-7.0),
    ]


@pytest.fixture
def plot(qtbot: Any) -> CurvePlot:
    widget = CurvePlot()
    qtbot.addWidget(widget)
    widget.resize(360, 200)
    widget.show()
    qtbot.waitExposed(widget)
    return widget


def lines(plot: CurvePlot, panel: int) -> dict[str, Any]:
    """The curves of a panel by name."""
    assert plot.figure is not None
    every = plot.figure.axes[panel].get_lines()
    return {line.get_label(): line for line in every if not line.get_label().startswith("_")}


def drawn(plot: CurvePlot) -> QImage:
    """What is on screen once everything that is pending is done."""
    QApplication.processEvents()
    QApplication.processEvents()
    return plot.grab().toImage()


def colours_in(image: QImage) -> set[str]:
    every = [(x, y) for x in range(image.width()) for y in range(image.height())]
    return {image.pixelColor(x, y).name() for x, y in every}


def palette_of(ink: str, ground: str) -> QPalette:
    palette = QPalette()
    palette.setColor(QPalette.ColorRole.WindowText, QColor(ink))
    palette.setColor(QPalette.ColorRole.Window, QColor(ground))
    return palette


def test_limits_stay_while_the_curves_fill_them() -> None:
    first = steady_limits((0.0, 10.0), None)
    assert first == pytest.approx((-1.2, 11.2))
    assert steady_limits((-1.0, 9.0), first) == first
    assert steady_limits((0.0, 7.0), first) == first
    assert steady_limits((0.0, 12.0), first) == pytest.approx((-1.44, 13.44))
    assert steady_limits((4.0, 5.0), first) == pytest.approx((3.88, 5.12))
    assert steady_limits(None, first) == first
    low, high = steady_limits((3.0, 3.0), None)
    assert low < 3 < high


def test_styles_differ_and_coinciding_curves_are_all_seen() -> None:
    styles = curve_styles(NAMES)
    looks = {(s["color"], str(s["linestyle"])) for s in styles.values()}
    assert len(looks) == len(NAMES)
    widths = [s["linewidth"] for s in styles.values()]
    assert all(before > after for before, after in pairwise(widths))


@pytest.mark.gui
def test_the_truth_takes_no_colour_of_a_method(plot: CurvePlot) -> None:
    names = ("exact", "2-D", "Angular", "Temporal", "T/A", "A/T", "WL1")
    plot.show_traces([Panel(TIMES, {n: np.sin(TIMES) for n in names}, "Time (s)")])
    lines = {line.get_label(): to_hex(line.get_color()) for line in plot.figure.axes[0].lines[:7]}
    assert lines.keys() == set(names)
    assert len(set(lines.values())) == len(names)
    (legend,) = plot.figure.legends
    drawn = zip(legend.get_texts(), legend.get_lines(), strict=True)
    assert {text.get_text(): to_hex(line.get_color()) for text, line in drawn} == lines


@pytest.mark.gui
def test_it_says_what_to_do_until_there_are_curves(plot: CurvePlot) -> None:
    words = plot.findChild(QLabel)
    assert words.isVisible()
    assert words.text() == "Move the mouse over a result."
    assert plot.figure is None
    plot.show_traces(traces())
    assert not words.isVisible()
    plot.message("No region is drawn yet.")
    assert words.isVisible()
    assert words.text() == "No region is drawn yet."
    plot.show_traces([Panel(TIMES, {}, "Time (s)")])
    assert words.text() == "Move the mouse over a result."
    assert not plot.has_curves


@pytest.mark.gui
def test_traces_have_their_values_colours_and_lines(plot: CurvePlot) -> None:
    plot.show_traces(traces())
    over_time, over_angle = lines(plot, 0), lines(plot, 1)
    assert list(over_time) == list(over_angle) == list(NAMES)
    for k, name in enumerate(NAMES):
        np.testing.assert_array_equal(over_time[name].get_xdata(), TIMES)
        np.testing.assert_array_equal(over_time[name].get_ydata(), np.sin(TIMES) + k)
        np.testing.assert_array_equal(over_angle[name].get_ydata(), ANGLES / 10 + k)
        assert over_time[name].get_color() == over_angle[name].get_color()
    axes = plot.figure.axes
    assert [a.get_xlabel() for a in axes] == ["Time (s)", "Viewing angle (°)"]
    assert list(axes[1].get_xticks()) == [-7, 21]
    for panel, position in ((0, 2.0), (1, -7.0)):
        marks = [m for m in axes[panel].get_lines() if m.get_label().startswith("_")]
        assert [list(m.get_xdata()) for m in marks] == [[position, position]]
        assert marks[0].get_visible()


@pytest.mark.gui
def test_new_values_change_the_same_curves(plot: CurvePlot) -> None:
    plot.show_traces(traces())
    before = lines(plot, 0)
    drawn(plot)
    for factor in (1.1, 1.2, 50.0, 0.01):
        plot.show_traces(traces(factor, at=factor))
        after = lines(plot, 0)
        assert all(after[name] is before[name] for name in NAMES)
        np.testing.assert_array_equal(after["RG"].get_ydata(), factor * (np.sin(TIMES) + 6))
        for panel in (0, 1):
            values = np.concatenate([line.get_ydata() for line in lines(plot, panel).values()])
            low, high = plot.figure.axes[panel].get_ylim()
            assert low < values.min()
            assert values.max() < high
            assert np.ptp(values) > 0.4 * (high - low)


@pytest.mark.gui
def test_quick_changes_look_as_if_all_were_drawn_anew(qtbot: Any, plot: CurvePlot) -> None:
    plot.show_traces(traces())
    drawn(plot)
    axes = plot.figure.axes
    for factor, kept in ((0.9, True), (4.0, False), (3.6, True)):
        limits = [a.get_ylim() for a in axes]
        plot.show_traces(traces(factor, at=3.0))
        assert ([a.get_ylim() for a in axes] == limits) is kept
        quick = drawn(plot)
        plot.hide()
        plot.show()  # draws all of it
        qtbot.waitExposed(plot)
        assert quick == drawn(plot)


@pytest.mark.gui
def test_other_curves_or_positions_are_taken(plot: CurvePlot) -> None:
    plot.show_traces(traces())
    shorter = Panel(TIMES[:5], {"T/A": np.arange(5.0)}, "Time (s)", "Phase (rad)")
    plot.show_traces([shorter])
    assert len(plot.figure.axes) == 1
    assert list(lines(plot, 0)) == ["T/A"]
    np.testing.assert_array_equal(lines(plot, 0)["T/A"].get_xdata(), TIMES[:5])
    assert lines(plot, 0)["T/A"].get_marker() == "o"  # so few points are shown one by one
    marks = [m for m in plot.figure.axes[0].get_lines() if m.get_label().startswith("_")]
    assert not marks[0].get_visible()
    plot.show_traces(traces())
    first, second = (a.get_position() for a in plot.figure.axes)
    assert (first.y0, first.y1) == (second.y0, second.y1)
    assert first.x1 < second.x0


@pytest.mark.gui
@pytest.mark.parametrize("size", [(360, 200), (340, 160), (700, 300), (280, 140)])
def test_nothing_is_cut_off_and_the_legend_is_outside(
    plot: CurvePlot, size: tuple[int, int]
) -> None:
    plot.resize(*size)
    plot.show_traces(traces(1000.0))
    drawn(plot)
    figure = plot.figure
    whole = figure.bbox.padded(1)
    for axes in figure.axes:
        for label in (axes.xaxis.label, axes.yaxis.label):
            box = label.get_window_extent()
            assert whole.x0 <= box.x0
            assert whole.y0 <= box.y0
            assert box.x1 <= whole.x1
        for legend in figure.legends:
            assert not legend.get_window_extent().overlaps(axes.get_window_extent())
    if size == (360, 200):
        shown = [text.get_text() for text in figure.legends[0].get_texts()]
        assert shown == list(NAMES)
        assert figure.legends[0].get_window_extent().width <= figure.bbox.width


@pytest.mark.gui
def test_gaps_and_single_points(plot: CurvePlot) -> None:
    nothing = np.full(60, np.nan)
    plot.show_traces([Panel(TIMES, {"T/A": nothing}, "Time (s)", at=1.0)])
    drawn(plot)
    partly = np.where(TIMES < 5, 3 * TIMES, np.nan)
    plot.show_traces([Panel(TIMES, {"T/A": partly}, "Time (s)", at=1.0)])
    low, high = plot.figure.axes[0].get_ylim()
    assert low < 0
    assert 3 * TIMES[29] < high < 20
    plot.show_traces([Panel([4.0], {"T/A": [12.0]}, "Time (s)", at=4.0)])
    drawn(plot)
    left, right = plot.figure.axes[0].get_xlim()
    assert left < 4 < right
    assert list(plot.figure.axes[0].get_xticks()) == [4]


@pytest.mark.gui
def test_dry_mass_per_region(plot: CurvePlot) -> None:
    masses = {"Region 1": 100 + TIMES, "Region 2": 80 - TIMES}
    plot.show_curves(TIMES, masses, "Time (s)", "Dry mass (pg)")
    (axes,) = plot.figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Time (s)", "Dry mass (pg)")
    for name, mass in masses.items():
        np.testing.assert_array_equal(lines(plot, 0)[name].get_ydata(), mass)
    shown = colours_in(drawn(plot))
    assert {line.get_color() for line in lines(plot, 0).values()} <= shown


@pytest.mark.gui
def test_it_follows_the_theme(plot: CurvePlot) -> None:
    plot.show_traces(traces())
    for ink, ground in (("#f0f1f2", "#23242b"), ("#1e1e21", "#ebe7e6")):
        plot.setPalette(palette_of(ink, ground))
        image = drawn(plot)
        assert image.pixelColor(1, image.height() - 2).name() == ground
        assert ink in colours_in(image)
        names = colours_in(image.copy(0, 0, image.width(), 24))
        assert names.isdisjoint({"#23242b", "#ebe7e6"} - {ground})  # nothing of the other theme


@pytest.mark.gui
@pytest.mark.parametrize("ending", [".png", ".svg", ".PNG"])
def test_saved_curves_are_black_on_white(plot: CurvePlot, tmp_path: Path, ending: str) -> None:
    plot.setPalette(palette_of("#f0f1f2", "#23242b"))
    plot.show_traces(traces())
    before = drawn(plot)
    path = tmp_path / f"traces{ending}"
    plot.save(path)
    assert drawn(plot) == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if ending == ".svg":
        text = path.read_text(encoding="utf-8")
        assert "<svg" in text
        assert "#f0f1f2" not in text
        assert all(line.get_color() in text for line in lines(plot, 0).values())
        return
    image = QImage(str(path))
    assert image.width() == pytest.approx(360 * 200 / plot.logicalDpiX(), abs=2)
    assert image.pixelColor(1, 1).name() == "#ffffff"
    saved = colours_in(image)
    assert "#000000" in saved
    assert "#000000" in colours_in(image.copy(0, 0, image.width(), image.height() // 8))  # names
    assert lines(plot, 0)["Angular"].get_color() in saved


@pytest.mark.gui
def test_what_does_not_fit_is_refused(plot: CurvePlot, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no curves to save"):
        plot.save(tmp_path / "traces.png")
    with pytest.raises(ValueError, match="curve 'RG' has 3 points, but there are 60 positions"):
        plot.show_traces([Panel(TIMES, {"RG": [1, 2, 3]}, "Time (s)")])
    assert not plot.has_curves
    plot.show_traces(traces())
    with pytest.raises(ValueError, match="saved as .png or .svg, but the file is 'traces.doc'"):
        plot.save(tmp_path / "traces.doc")
    plot.message()
    with pytest.raises(ValueError, match="no curves to save"):
        plot.save(tmp_path / "traces.png")
    (tmp_path / "file").write_text("in the way")
    plot.show_traces(traces())
    with pytest.raises(OSError, match="could not be written"):
        plot.save(tmp_path / "file" / "traces.png")


@pytest.mark.gui
def test_the_wheel_scrolls_the_window_under_it(qtbot: Any) -> None:
    area, inner = QScrollArea(), QWidget()
    qtbot.addWidget(area)
    column = QVBoxLayout(inner)
    plot = CurvePlot()
    column.addWidget(plot)
    inner.setMinimumHeight(900)
    area.setWidget(inner)
    area.setWidgetResizable(True)
    area.resize(380, 300)
    area.show()
    qtbot.waitExposed(area)
    plot.show_traces(traces())
    drawn(plot)
    place = plot.mapTo(area.window(), QPoint(100, 100))
    wheel = QWheelEvent(
        QPointF(place),
        QPointF(area.window().mapToGlobal(place)),
        QPoint(),
        QPoint(0, -240),
        Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )
    # What is under the mouse gets it first, then whoever is round that, until one takes it.
    target = area.window().childAt(place)
    assert plot.isAncestorOf(target) or target is plot
    taken = False
    while target is not None and not taken:
        taken = QApplication.sendEvent(target, wheel) and wheel.isAccepted()
        target = target.parentWidget()
    assert area.verticalScrollBar().value() > 0


@pytest.mark.gui
def test_canvas_and_figure_end_with_the_widget(qtbot: Any) -> None:
    plot = CurvePlot()
    plot.show()
    plot.show_traces(traces())
    QApplication.processEvents()
    plot.show_traces(traces(9.0))  # a drawing is still pending
    figure = weakref.ref(plot.figure)
    gone: list[bool] = []
    plot.destroyed.connect(lambda: gone.append(True))
    plot.deleteLater()
    del plot
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    QApplication.processEvents()
    gc.collect()
    assert gone
    assert figure() is None
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []
