"""Results come up in steps, so that the window goes on; a script gets them at once."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from driving import let_settle
from qtpy.QtCore import QEvent, QTimer
from qtpy.QtOpenGLWidgets import QOpenGLWidget
from qtpy.QtWidgets import QApplication, QVBoxLayout, QWidget

import napari_phase4d as p4d
from napari_phase4d._napari import turns as turns_module
from napari_phase4d._napari.turns import (
    UNSEEN,
    Afterwards,
    Canvas,
    Collecting,
    Steps,
    Turns,
    WhenIdle,
)

NINE = (
    "spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal",
    "laplacian", "region-growing", "spatial-3d", "dilate-erode",
)  # fmt: skip


def noting(done: list[str], *words: str) -> Iterator[None]:
    """Note a word a step."""
    for word in words:
        done.append(word)
        yield


@pytest.mark.gui
def test_steps_are_done_a_turn_each_in_order(qtbot: Any) -> None:
    turns, done, turn = Turns(), [], []
    beat = QTimer()
    beat.timeout.connect(lambda: turn.append(len(done)))
    beat.start(0)
    with turns.unhurried():
        turns.run(noting(done, "a", "b"))
        turns.run(noting(done, "c"))
    assert done == []
    assert turns.pending
    assert not gc.isenabled()
    qtbot.waitUntil(lambda: not turns.pending)
    assert gc.isenabled()
    assert done == ["a", "b", "c"]
    assert {0, 1, 2} <= set(turn)  # others had their turn after each
    turns.run(noting(done, "d", "e"))  # as a script does
    assert done[3:] == ["d", "e"]


@pytest.mark.gui
def test_what_a_script_asks_for_comes_after_what_waits(qtbot: Any) -> None:
    turns, done = Turns(), []
    with turns.unhurried():
        turns.run(noting(done, "a", "b"))
    turns.run(noting(done, "c"))
    assert done == ["a", "b", "c"]
    assert not turns.pending
    with turns.unhurried():
        turns.run(noting(done, "d"))
    turns.stop()
    assert gc.isenabled()
    qtbot.wait(30)
    assert done == ["a", "b", "c"]


@pytest.mark.gui
def test_the_canvas_is_painted_between_steps_where_there_is_something_new(qtbot: Any) -> None:
    window, done = QWidget(), []
    column = QVBoxLayout(window)

    class Painted(QOpenGLWidget):
        def paintEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
            done.append("painted")

    canvas, dock = Painted(), QWidget()
    column.addWidget(canvas)
    column.addWidget(dock)
    window.resize(300, 300)
    qtbot.addWidget(window)
    window.show()
    qtbot.waitUntil(lambda: "painted" in done)
    qtbot.wait(50)
    done.clear()
    turns, beat = Turns(), QTimer()
    beat.timeout.connect(lambda: done.append("beat"))
    beat.start(0)

    def changing() -> Steps:
        for word, seen in (("a", None), ("b", UNSEEN), ("c", UNSEEN), ("d", None)):
            done.append(word)
            canvas.update()
            yield seen
        done.append("e")

    turns.canvas = Canvas(dock)
    with turns.unhurried():
        turns.run(changing())
    qtbot.waitUntil(lambda: not turns.pending)
    qtbot.wait(50)
    beat.stop()
    told = [word for word in done if word != "beat"]
    assert told == ["a", "painted", "b", "c", "d", "painted", "e", "painted"]
    assert all(
        "beat" in pair for pair in pairwise(done)
    )  # neither steps nor pictures follow at once
    assert canvas.updatesEnabled()
    turns.run(changing())  # as a script does: all at once
    assert canvas.updatesEnabled()


@pytest.mark.gui
def test_the_canvas_is_not_held_back_when_work_is_stopped(qtbot: Any) -> None:
    window = QWidget()
    canvas, dock = QOpenGLWidget(window), QWidget(window)
    qtbot.addWidget(window)
    window.show()
    turns = Turns()
    turns.canvas = Canvas(dock)
    with turns.unhurried():
        turns.run(iter([UNSEEN] * 1000))
    qtbot.waitUntil(lambda: not canvas.updatesEnabled())
    turns.stop()
    assert canvas.updatesEnabled()


@pytest.mark.gui
def test_a_step_that_fails_holds_nothing_up(qtbot: Any) -> None:
    turns, done = Turns(), []

    def failing() -> Iterator[None]:
        done.append("a")
        yield
        msg = "the layer is gone"
        raise ValueError(msg)

    with turns.unhurried():
        turns.run(failing())
        turns.run(noting(done, "b"))
    with qtbot.captureExceptions() as errors:
        qtbot.waitUntil(lambda: not turns.pending)
    assert [str(error[1]) for error in errors] == ["the layer is gone"]
    assert done == ["a", "b"]


@pytest.mark.gui
def test_followers_are_told_once_after_many_moves(qtbot: Any, qapp: Any) -> None:
    told: list[int] = []
    follow = Afterwards(lambda: told.append(1), qapp)
    for _ in range(20):
        follow()
    assert follow.pending
    assert told == []
    qtbot.waitUntil(lambda: not follow.pending)
    assert told == [1]


@pytest.mark.slow
def test_it_is_waited_until_nobody_touches_the_window(
    qtbot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns_module, "IDLE_MS", 100)
    parent, place, done = QWidget(), [0], []
    qtbot.addWidget(parent)
    slider = QTimer(parent)
    slider.timeout.connect(lambda: place.append(place[-1] + 1))
    slider.start(20)
    when_idle = WhenIdle(lambda: done.append(place[-1]), lambda: place[-1], parent)
    when_idle()
    qtbot.wait(400)
    assert not done
    slider.stop()
    qtbot.waitUntil(lambda: bool(done), timeout=60_000)
    qtbot.wait(200)
    assert done == [place[-1]]  # and not again and again
    when_idle()
    when_idle.stop()
    qtbot.wait(200)
    assert len(done) == 1


@pytest.mark.thorough
def test_garbage_is_looked_for_when_nobody_uses_the_window(
    dock: Any, qtbot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[bool] = []
    monkeypatch.setattr(dock._collecting, "in_quiet", lambda: looked.append(dock.jobs.busy))
    dock.session.set_phase(p4d.simulation.swimming_euglena((60, 70), 4)["wrapped"])
    qtbot.waitUntil(lambda: dock.session.quiet_plan() is None, timeout=60_000)
    assert not looked
    qtbot.waitUntil(lambda: bool(looked), timeout=60_000)
    assert looked == [False]


@pytest.mark.slow
def test_old_objects_are_looked_through_again_in_the_end() -> None:
    frozen = gc.get_freeze_count()
    gc.unfreeze()
    try:
        first = Collecting()
        second = Collecting()
        assert gc.get_freeze_count() > 1000
        first.end()
        first.end()
        assert gc.get_freeze_count() > 1000
        second.end()
        assert gc.get_freeze_count() == 0
        gc.freeze()
        Collecting().end()  # that of somebody else stays
        assert gc.get_freeze_count() > 1000
    finally:
        gc.unfreeze()
        if frozen:
            gc.freeze()


@pytest.mark.slow
def test_new_objects_are_looked_through_in_a_quiet_moment() -> None:
    looked: list[int] = []

    def note(phase: str, told: dict[str, int]) -> None:
        if phase == "start" and told["generation"] == 2:
            looked.append(1)

    before, thresholds = gc.get_freeze_count(), (50, 2, 2)
    kept, gc_before = [], gc.get_threshold()
    gc.unfreeze()
    gc.set_threshold(*thresholds)
    gc.callbacks.append(note)
    try:
        collecting = Collecting()
        gc.collect()
        looked.clear()
        while gc.get_count()[2] <= 3 * 2:
            kept.append([[] for _ in range(60)])
        assert not looked  # Python itself would have by now
        collecting.in_quiet()
        assert looked == [1]
        collecting.in_quiet()  # nothing is new
        assert looked == [1]
        collecting.end()
        assert gc.get_threshold() == thresholds
        kept.append([[] for _ in range(10_000)])
        assert len(looked) > 1
    finally:
        gc.callbacks.remove(note)
        gc.set_threshold(*gc_before)
        gc.unfreeze()
        if before:
            gc.freeze()


@pytest.mark.gui
@pytest.mark.thorough
def test_nine_results_come_up_one_a_turn(viewer: Any, dock: Any, qtbot: Any, click: Any) -> None:
    dock.session.set_phase(p4d.simulation.swimming_euglena((40, 56), 6)["wrapped"])
    dock.session.update(methods=NINE)
    shown: list[int] = []
    beat = QTimer()
    beat.timeout.connect(
        lambda: shown.append(sum(la.visible for la in viewer.layers)) if grid.enabled else None
    )
    grid = viewer.canvas.grid
    beat.start(0)
    click("run")
    beat.stop()
    assert {1, 2, 3, 4, 5, 6, 7, 8, 9} <= set(shown)
    layers = [la for la in viewer.layers if la.visible]
    assert len(layers) == 9
    assert all(la.name_overlay.visible for la in layers)
    assert [la.colorbar.visible for la in layers] == [True, *[False] * 8]
    assert grid.enabled
    assert tuple(grid.shape) == (-1, -1)  # as the user left it
    limits = {tuple(la.contrast_limits) for la in layers}
    assert len(limits) == 1
    layers[0].contrast_limits = (0.0, 1.0)
    assert all(tuple(la.contrast_limits) == (0.0, 1.0) for la in layers)


@pytest.mark.gui
@pytest.mark.thorough
def test_layers_that_go_while_results_come_up(viewer: Any, ready: Any, qtbot: Any) -> None:
    ready.session.unwrap(["spatial-2d", "temporal", "temporal-angular"])
    ready.compare.views["wrapped"].click()
    let_settle(qtbot, ready)
    ready.compare.views["results"].click()
    assert ready.presenter.turns.pending
    viewer.layers.remove(viewer.layers["Temporal"])
    let_settle(qtbot, ready)
    assert [la.name for la in viewer.layers if la.visible] == ["2-D", "T/A"]


@pytest.mark.gui
@pytest.mark.thorough
def test_a_dock_that_is_closed_while_results_come_up(viewer: Any, ready: Any, qtbot: Any) -> None:
    ready.session.update(methods=("spatial-2d", "temporal", "temporal-angular"))
    ready.unwrap.run()
    qtbot.waitUntil(lambda: ready.session.outcome is not None, timeout=60_000)
    assert ready.presenter.turns.pending
    ready.close_down()
    ready.deleteLater()
    viewer.window.remove_dock_widget(ready)
    _, again = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    let_settle(qtbot, again)
    names = [la.name for la in viewer.layers if la.visible]
    assert names == ["2-D", "Temporal", "T/A"]
    assert len({la.name for la in viewer.layers}) == len(viewer.layers)  # none came up twice
    results = again.session.results
    for name, method in (("2-D", "spatial-2d"), ("T/A", "temporal-angular")):
        np.testing.assert_array_equal(viewer.layers[name].data, results[method].values)
    again.jobs.cancel()


@pytest.mark.gui
def test_a_recording_comes_up_in_turns(
    viewer: Any, dock: Any, qtbot: Any, small_video: Any
) -> None:
    turns = dock.presenter.turns
    with turns.unhurried():
        dock.session.set_recording(small_video)
    assert turns.pending
    assert not viewer.layers
    let_settle(qtbot, dock)
    (layer,) = viewer.layers
    assert layer.visible
    assert viewer.canvas.overlays.scale_bar.visible
    assert viewer.dims.current_step[0] == 0


@pytest.mark.thorough
@pytest.mark.slow
def test_phase_is_opened_while_a_recording_comes_up(
    viewer: Any, dock: Any, qtbot: Any, small_video: Any
) -> None:
    turns, faults = dock.presenter.turns, []
    turns.failed = faults.append
    phase = p4d.simulation.swimming_euglena((60, 70), 4)["wrapped"]
    with turns.unhurried():
        dock.session.set_recording(small_video)
        dock.session.set_phase(phase)
    let_settle(qtbot, dock)
    assert not faults
    (shown,) = (layer for layer in viewer.layers if layer.visible)
    assert shown.data.shape == phase.shape


@pytest.mark.thorough
@pytest.mark.parametrize("n_steps", [0, 2, 4])
def test_a_dock_that_is_closed_while_a_recording_comes_up(
    viewer: Any, dock: Any, qtbot: Any, small_video: Any, n_steps: int
) -> None:
    turns = dock.presenter.turns
    with turns.unhurried():
        dock.session.set_recording(small_video)
    for _ in range(n_steps):
        turns._step()
    assert turns.pending
    dock.close_down()
    dock.deleteLater()
    viewer.window.remove_dock_widget(dock)
    _, again = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    let_settle(qtbot, again)
    (layer,) = viewer.layers  # and it did not come up twice
    assert layer.visible
    assert again.presenter.holograms == layer


@pytest.mark.gui
def test_a_step_may_stop_all_and_what_fails_in_a_turn_is_told(qtbot: Any) -> None:
    turns = Turns()

    def stopping() -> Any:
        yield
        turns.stop()

    def failing() -> Any:
        yield
        msg = "the disk is gone"
        raise OSError(msg)

    told: list[Exception] = []
    turns.failed = told.append
    with turns.unhurried():
        turns.run(stopping())
        qtbot.waitUntil(lambda: not turns.pending)
        assert not told
        turns.run(failing())
        qtbot.waitUntil(lambda: not turns.pending)
    assert [str(error) for error in told] == ["the disk is gone"]


@pytest.mark.slow
def test_what_still_comes_up_ends_with_its_dock(viewer, dock, qtbot) -> None:
    """Also where Qt deletes the dock before anybody has told it that its window closes."""
    done: list[None] = []

    def steps() -> Iterator[None]:
        while True:
            done.append(None)
            yield

    turns = dock.presenter.turns
    with turns.unhurried():
        turns.run(steps())
    qtbot.waitUntil(lambda: len(done) > 2, timeout=60_000)
    dock.deleteLater()
    QApplication.sendPostedEvents(dock, QEvent.Type.DeferredDelete.value)
    before = len(done)
    qtbot.wait(200)
    assert (len(done), turns.pending) == (before, False)


@pytest.mark.gui
def test_turns_that_go_with_work_left_let_python_look_for_garbage(qtbot: Any) -> None:
    turns = Turns()
    with turns.unhurried():
        turns.run(noting([], "a"))
    assert not gc.isenabled()
    del turns
    assert gc.isenabled()
