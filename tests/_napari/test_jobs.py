"""Long work: cancelling, closing, and results that come too late."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from qtpy.QtCore import Qt, QThreadPool, QTimer

import napari_phase4d as p4d
from napari_phase4d._napari.jobs import NICENESS
from napari_phase4d._napari.session import Plan, plan_reconstruction, plan_unwrapping
from napari_phase4d.task import UNWATCHED, Task, Watch

pytestmark = pytest.mark.gui


@pytest.mark.thorough
def test_result_for_an_older_recording_is_dropped(viewer, ready, small_video) -> None:
    plan = plan_reconstruction(ready.session)
    result = plan.work(UNWATCHED)
    other = small_video.calibrated(p4d.Optics(magnification=20))
    ready.session.set_recording(other)
    count = len(viewer.layers)
    with pytest.raises(ValueError, match="has changed meanwhile"):
        plan.receive(result)
    assert ready.session.reconstruction is None
    assert len(viewer.layers) == count


@pytest.mark.thorough
def test_change_while_a_job_runs_is_said_and_nothing_mixed(viewer, ready, qtbot) -> None:
    count = len(viewer.layers)
    ready.phase.reconstruct()
    ready.session.recalibrate(ready.session.recording.calibrated(p4d.Optics(magnification=20)))
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=60_000)
    assert "has changed meanwhile" in ready.status.text()
    assert len(viewer.layers) == count


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells threads apart")
def test_work_gives_way_and_the_threads_of_others_do_not(dock, qtbot) -> None:
    """Qt's threads are lent to other plugins, which have nothing to do with our work."""
    pool, nice = QThreadPool.globalInstance(), {"work": [], "others": []}
    together = threading.Barrier(pool.maxThreadCount() + 1, timeout=10)

    def note(whose: str) -> None:
        nice[whose].append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    def other() -> None:
        note("others")
        together.wait()  # so that each has a thread

    dock.jobs.start(Plan("Noting", lambda _: note("work"), lambda _: None))
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=60_000)
    for _ in range(pool.maxThreadCount()):
        pool.start(other)
    together.wait()
    own = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    assert nice["work"] == [NICENESS]
    assert nice["others"] == [own] * pool.maxThreadCount()


def slow_plan(started: threading.Event, ended: list[str]) -> Plan:
    def work(task: Task) -> str:
        watch = Watch(10_000, "slow work", task)
        started.set()
        try:
            for _ in range(10_000):
                time.sleep(0.01)
                watch.step()
        except p4d.Cancelled:
            ended.append("cancelled")
            raise
        ended.append("to the end")
        return "done"

    return Plan("Slow work", work, lambda _: ended.append("received"))


@pytest.mark.thorough
def test_cancel_acts_within_a_second(dock, qtbot) -> None:
    started, ended = threading.Event(), []
    dock.jobs.start(slow_plan(started, ended))
    qtbot.waitUntil(lambda: "slow work" in dock.status.text(), timeout=60_000)
    assert dock.cancel.isVisible()
    began = time.monotonic()
    qtbot.mouseClick(dock.cancel, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert time.monotonic() - began < 1
    assert ended == ["cancelled"]
    assert "cancelled" in dock.status.text()
    assert not dock.cancel.isVisible()


@pytest.mark.thorough
def test_two_jobs_at_once_are_refused(ready, qtbot, click) -> None:
    started, ended = threading.Event(), []
    ready.jobs.start(slow_plan(started, ended))
    qtbot.mouseClick(ready.phase.go, Qt.MouseButton.LeftButton)
    assert "another job is still running" in ready.status.text()
    ready.jobs.cancel()
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=60_000)


@pytest.mark.thorough
def test_finished_results_stay_when_the_rest_is_cancelled(viewer, ready, qtbot) -> None:
    count = len(viewer.layers)
    ready.session.update(methods=("spatial-2d", "temporal", "directional-l1"))
    plan = plan_unwrapping(ready.session)
    real, waiting = plan.work, threading.Event()

    def work(task: Task) -> Any:
        def stop_after_two(done: int, total: int, message: str) -> None:
            task.progress(done, total, message)
            if message.startswith("WL1"):
                waiting.set()
                while not task.stopped:
                    time.sleep(0.01)

        return real(replace(task, progress=stop_after_two))

    ready.jobs.start(replace(plan, work=work))
    assert waiting.wait(60)
    qtbot.mouseClick(ready.cancel, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=60_000)
    assert "cancelled. The finished results are shown." in ready.status.text()
    assert list(ready.session.results) == ["spatial-2d", "temporal"]
    assert len(viewer.layers) == count + 2
    expected = p4d.unwrap(ready.session.reconstruction["phase"], "temporal", mask="auto")
    np.testing.assert_array_equal(viewer.layers["Temporal"].data, expected.values)


@pytest.mark.thorough
def test_closing_the_window_stops_the_work(viewer, dock, qtbot) -> None:
    started, ended = threading.Event(), []
    dock.jobs.start(slow_plan(started, ended))
    assert started.wait(60)
    viewer.close()
    qtbot.waitUntil(lambda: bool(ended), timeout=60_000)
    assert ended == ["cancelled"]


@pytest.mark.thorough
def test_taking_the_dock_away_stops_the_work(viewer, dock, qtbot) -> None:
    started, ended = threading.Event(), []
    dock.jobs.start(slow_plan(started, ended))
    assert started.wait(60)
    viewer.window.remove_dock_widget(dock)
    qtbot.waitUntil(lambda: bool(ended), timeout=60_000)
    assert ended == ["cancelled"]
    with qtbot.waitSignal(dock.destroyed):
        dock.deleteLater()  # napari lets go of what it did not make


@pytest.mark.thorough
def test_a_result_is_taken_in_steps_between_which_the_window_goes_on(dock, qtbot) -> None:
    told: list[str] = []
    timer = QTimer()
    timer.timeout.connect(lambda: told.append("window"))

    def showing(step: str) -> Iterator[None]:
        yield
        told.append(f"shown {step}")

    def receive(_: object) -> Iterator[None]:
        timer.start(0)
        for step in ("first", "second", "third"):
            told.append(step)
            dock.presenter.turns.run(showing(step))
            yield

    dock.jobs.start(Plan("Work", lambda _: None, receive), then=lambda: told.append("then"))
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    timer.stop()
    steps = ("first", "second", "third")
    ours = [word for step in steps for word in (step, f"shown {step}")]
    assert [word for word in told if word != "window"] == [*ours, "then"]
    for step, following in pairwise(steps):
        assert "window" in told[told.index(step) : told.index(following)]
    assert dock.status.text() == "Work: done."


@pytest.mark.thorough
def test_an_error_in_a_later_step_is_said_and_the_rest_left_out(dock, qtbot) -> None:
    told: list[str] = []

    def receive(_: object) -> Iterator[None]:
        told.append("first")
        yield
        msg = "the second step can't be"
        raise ValueError(msg)

    dock.jobs.start(Plan("Work", lambda _: None, receive), then=lambda: told.append("then"))
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert told == ["first"]
    assert dock.status.text() == "⚠ the second step can't be"


def test_work_is_done_where_the_system_has_no_more_threads(dock, qtbot, monkeypatch) -> None:
    start, got = threading.Thread.start, []

    def refusing(thread: threading.Thread) -> None:
        if thread.name == "Phase 4D":
            msg = "can't start new thread"
            raise RuntimeError(msg)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refusing)
    dock.jobs.start(Plan("Counting", lambda _: 3, got.append))
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=60_000)
    assert got == [3]


def test_work_that_ends_the_program_ends_as_a_job_that_failed(dock, qtbot) -> None:
    def leave(_: Task) -> None:
        sys.exit(3)

    dock.jobs.start(Plan("Leaving", leave, lambda _: None))
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=60_000)
    assert "SystemExit(3)" in dock.status.text()
