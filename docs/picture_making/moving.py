"""The moving picture of the README: the window in use, from a recording to a dry-mass curve."""

from __future__ import annotations

from typing import Any

from qtpy.QtCore import QPoint
from qtpy.QtWidgets import QScrollBar, QStyle, QStyleOptionSlider, QTabWidget, QWidget

from napari_phase4d._napari.demo import viewer_with_dock, wait_until
from picture_making.film import Film
from picture_making.hand import Hand
from picture_making.saving import PICTURES

#: Small enough for its words to be read in the film; the lists of layers are hidden.
WINDOW = (1020, 720)
CAPTIONS = (
    "1  Open a recording: holograms of two views at once",
    "2  Find the views in the spectrum, or drag the circles",
    "3  Reconstruct: wrapped phase of each view",
    "4  Choose a thin frame, and run the methods",
    "5  Compare: all results on the same sliders",
    "6  Measure: the dry mass of the cell over time",
)
#: How far circle 1 is dragged, as (ky, kx) in cycles per pixel.
DRAG = ((0, 0), (0.01, -0.01), (0.025, -0.02), (0.04, -0.03), (0.055, -0.04))
#: While something runs, it is filmed so often, and each picture is shown so long.
LOOK_EVERY_S, LOOK_MS = 0.25, 110
MOST_LOOKS, LONGEST_LOOK_MS = 12, 330
#: Round what is magnified, in pixels of the window.
MARGIN = 16


class Story:
    """A window, a hand and a film.

    Parameters
    ----------
    viewer, dock
        As `viewer_with_dock` gives them.
    """

    def __init__(self, viewer: Any, dock: Any) -> None:
        self.viewer, self.dock = viewer, dock
        self.film = Film(viewer, len(CAPTIONS))
        self.hand = Hand(self.film)
        self._captions = iter(CAPTIONS)

    def next_caption(self) -> None:
        """Say what comes next."""
        self.film.say(next(self._captions))

    def show(self, duration_ms: int) -> None:
        """Show the window as it is."""
        self.hand.wait(0.3)
        self.film.shoot(duration_ms)

    def click(self, name: str) -> None:
        """Click on a widget of the dock by its name, and wait for what it starts."""
        self.hand.click(self.widget(name))
        self.wait()

    def widget(self, name: str) -> QWidget:
        """Return a widget of the dock, in view."""
        widget = self.dock.findChild(QWidget, name)
        self.dock.scroll.ensureWidgetVisible(widget)
        self.hand.wait()
        return widget

    def wait(self) -> None:
        """Wait until nothing runs."""
        wait_until(lambda: not self.dock.jobs.running)
        if self.dock.status.property("wrong"):
            msg = f"the window says: {self.dock.status.text()}"
            raise RuntimeError(msg)

    def film_the_work(self) -> None:
        """Film what runs while it runs."""
        before = len(self.film.frames)
        while self.dock.jobs.running:
            self.hand.wait(LOOK_EVERY_S)
            if self.dock.jobs.running:
                self.film.shoot(LOOK_MS)
        self.wait()
        thin_out(self.film, before)

    def drag_time(self, first: int, last: int, steps: int, each_ms: int) -> None:
        """Drag the time slider from one frame to another."""
        sliders = self.viewer.window._qt_viewer.dims.slider_widgets
        slider = next(w.slider for w in sliders if w.axis_label.text() == "time")
        frames = [round(first + (last - first) * n / steps) for n in range(steps + 1)]
        self.hand.drag(slider, [handle_of(slider, frame) for frame in frames], each_ms)

    def magnify(self, widget: QWidget) -> None:
        """Show a widget larger, over the canvas."""
        corner = widget.mapTo(self.hand.window, QPoint(0, 0))
        part = (corner.x(), corner.y(), corner.x() + widget.width(), corner.y() + widget.height())
        right = self.dock.mapTo(self.hand.window, QPoint(0, 0)).x() - 2 * MARGIN
        height = round((right - MARGIN) * widget.height() / widget.width())
        middle = self.hand.window.height() // 2
        target = (MARGIN, middle - height // 2, right, middle - height // 2 + height)
        for share in (0.25, 0.5, 0.75, 1.0):
            left, top, right, bottom = (
                round(a + (b - a) * share) for a, b in zip(part, target, strict=True)
            )
            self.film.magnified = (part, (left, top, right, bottom))
            self.show(60)


def handle_of(bar: QScrollBar, value: int) -> QPoint:
    """Return where the middle of a slider's handle is at a value."""
    option = QStyleOptionSlider()
    bar.initStyleOption(option)
    groove, handle = (
        bar.style().subControlRect(QStyle.ComplexControl.CC_ScrollBar, option, part, bar)
        for part in (QStyle.SubControl.SC_ScrollBarGroove, QStyle.SubControl.SC_ScrollBarSlider)
    )
    room = groove.width() - handle.width()
    along = QStyle.sliderPositionFromValue(bar.minimum(), bar.maximum(), value, room)
    return QPoint(groove.left() + along + handle.width() // 2, groove.center().y())


def thin_out(film: Film, first: int) -> None:
    """Keep some pictures of work that took long, evenly spread, none of them for long."""
    lengths = film.durations_ms
    lengths[first:] = [min(length, LONGEST_LOOK_MS) for length in lengths[first:]]
    n = len(film.frames) - first
    kept = sorted({first + round(k * (n - 1) / (MOST_LOOKS - 1)) for k in range(MOST_LOOKS)})
    if n > MOST_LOOKS:
        film.frames[first:] = [film.frames[k] for k in kept]
        lengths[first:] = [lengths[k] for k in kept]


def moving_picture(wanted: set[str]) -> None:
    """Film the way from a recording to a dry-mass curve."""
    viewer, dock = viewer_with_dock(show=True)
    viewer.window.resize(*WINDOW)
    for side in (
        viewer.window._qt_viewer.dockLayerList,
        viewer.window._qt_viewer.dockLayerControls,
    ):
        side.hide()
    story = Story(viewer, dock)
    try:
        for part in (open_recording, find_lobes, make_phase, unwrap, compare, measure):
            story.next_caption()
            part(story)
        (name,) = wanted
        story.film.save(PICTURES / f"{name}.gif")
    finally:
        viewer.close()


def open_recording(story: Story) -> None:
    story.show(600)
    story.click("try_sample")
    wait_until(lambda: story.dock.session.spectrum is not None)
    story.show(300)
    story.drag_time(0, 12, 3, 110)


def find_lobes(story: Story) -> None:
    story.click("find_lobes")
    story.show(600)
    canvas, (ky, kx) = story.dock.lobes.canvas, story.dock.session.lobes[0].carrier
    way = [canvas.view_position(ky + y, kx + x).toPoint() for y, x in DRAG]
    story.hand.drag(canvas.viewport(), way, 140)
    story.show(300)
    story.click("undo_lobes")
    story.show(400)


def make_phase(story: Story) -> None:
    story.hand.click(story.widget("heading_phase"))
    story.show(200)
    story.click("reconstruct")
    wait_until(lambda: story.dock.session.scores is not None)
    story.show(700)


def unwrap(story: Story) -> None:
    boundary_map = story.dock.unwrap.boundary.map
    story.show(200)
    for frame in ((30, 1), (0, 0)):
        story.hand.click(boundary_map, boundary_map.cell_position(*frame).toPoint())
        story.show(500)
    story.hand.click(story.widget("run"))
    story.film_the_work()


def compare(story: Story) -> None:
    wait_until(lambda: bool(story.dock.session.verdict))
    story.show(1500)  # the sliders have gone to where the methods disagree most
    time, _ = story.dock.presenter.current_frame()
    story.drag_time(time, 0, 12, 100)
    story.show(600)


def measure(story: Story) -> None:
    tabs: QTabWidget = story.dock.compare.tabs
    story.hand.click(tabs.tabBar(), tabs.tabBar().tabRect(2).center())
    story.show(150)
    story.click("measure")
    story.show(500)
    story.magnify(story.dock.compare.measuring.plot)
    story.show(2000)
