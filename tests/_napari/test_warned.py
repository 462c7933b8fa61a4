"""What work warns of is seen in the window: at its step, at the foot, or as napari's own."""

from __future__ import annotations

import gc
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from driving import let_settle
from napari._qt.widgets.qt_progress_bar import QtLabeledProgressBar
from napari.utils.notifications import notification_manager
from qtpy.QtCore import Qt, QThreadPool
from qtpy.QtGui import QTextDocument
from qtpy.QtWidgets import QPushButton

from napari_phase4d._napari.jobs import Latest
from napari_phase4d._napari.menus import unwrap_wl1
from napari_phase4d._napari.session import Plan, StepNumber
from napari_phase4d._napari.viewing.layers import stack_layer
from napari_phase4d.io import write_phase
from napari_phase4d.simulation import budding_yeast
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.task import Task, Watch, watched
from napari_phase4d.warned import warn
from test_wavelengths_trust import METHOD, cell_at_two, shifted_views

pytestmark = pytest.mark.gui

SENTENCE = "the lamp flickers by 3 um"
ON_SCREEN = "The lamp flickers by 3 µm."


def warning_plan(sentences: list[str], *, unasked: bool = False, title: str = "Looking") -> Plan:
    """Plan work that warns of something."""

    def work(task: Task) -> None:
        for sentence in sentences:
            warn(sentence)

    return Plan(title, work, lambda _: None, gives_way=unasked, step=StepNumber.UNWRAP)


@pytest.fixture
def notes() -> Iterator[Callable[[], list[str]]]:
    """Return what napari has shown since."""
    before = len(notification_manager.records)
    yield lambda: [note.message for note in notification_manager.records[before:]]
    del notification_manager.records[before:]


@pytest.mark.parametrize("unasked", [False, True])
def test_what_work_warns_of_stands_at_its_step(ready: Any, qtbot: Any, unasked: bool) -> None:
    let_settle(qtbot, ready)
    ready.jobs.start(warning_plan([SENTENCE, SENTENCE], unasked=unasked))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ready.unwrap.heard.text() == f"⚠ {ON_SCREEN}"
    assert not ready.unwrap.heard.isHidden()
    assert (ON_SCREEN in ready.status.text()) is not unasked
    # It is of the other work still when something else was done.
    ready.jobs.start(warning_plan([], title="Another"))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ON_SCREEN in ready.unwrap.heard.text()
    ready.jobs.start(warning_plan([]))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ready.unwrap.heard.isHidden()


def test_phase_that_is_probably_none_is_said_to_be_so_where_it_is_opened(
    dock: Any, qtbot: Any, tmp_path: Path
) -> None:
    exact = budding_yeast(n_times=2)["phase"].values
    tifffile.imwrite(tmp_path / "degrees.tif", np.rad2deg(np.angle(np.exp(1j * exact))))
    dock.recording.open_path(str(tmp_path / "degrees.tif"), content="phase")
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=20_000)
    assert "degrees" in dock.recording.heard.text()
    assert "degrees" in dock.status.text()
    # Another file is another matter.
    write_phase(tmp_path / "phase.zarr", budding_yeast(n_times=2)["wrapped"])
    dock.recording.open_path(str(tmp_path / "phase.zarr"))
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=20_000)
    assert dock.recording.heard.isHidden()


def test_it_is_said_while_the_work_goes_on_but_not_of_what_came_to_nothing(
    ready: Any, qtbot: Any
) -> None:
    let_settle(qtbot, ready)

    def work(task: Task) -> None:
        watch = Watch(1000, "looking", task)
        watched(lambda: warn('<b> is "no" frame & dark'), watch)  # by a thread of its own
        while True:
            watch.check()

    plan = Plan("Looking", work, lambda _: None, step=StepNumber.PHASE)
    ready.jobs.start(plan)
    qtbot.waitUntil(lambda: not ready.phase.heard.isHidden(), timeout=20_000)
    assert ready.jobs.running
    shown = QTextDocument()
    shown.setHtml(ready.phase.heard.text())
    assert shown.toPlainText() == '⚠ <b> is "no" frame & dark.'
    assert ready.phase.heard.textFormat() == Qt.TextFormat.RichText
    ready.jobs.cancel()
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ready.phase.heard.isHidden()


def test_the_foot_tells_what_the_last_work_warned_of(ready: Any, qtbot: Any) -> None:
    let_settle(qtbot, ready)
    for title, sentences, said in (
        ("First", [SENTENCE], f"⚠ {ON_SCREEN} First: done."),
        ("Second", [], "Second: done."),
        (
            "Third",
            ["it is dark", "it is cold"],
            "⚠ It is dark. (and 1 more in step 4) Third: done.",
        ),
    ):
        ready.jobs.start(warning_plan(sentences, title=title))
        qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
        assert ready.status.text() == said


def test_another_recording_has_no_part_in_it(ready: Any, qtbot: Any, small_video: Any) -> None:
    let_settle(qtbot, ready)
    ready.session.unwrap(["temporal-angular"])
    ready.jobs.start(warning_plan([SENTENCE]))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ready.sections[3].badge.text() == "⚠ look"
    assert not ready.unwrap.heard.isHidden()
    ready.session.set_recording(small_video)
    assert ready.unwrap.heard.isHidden()


def test_what_a_step_says_itself_is_not_said_twice(
    ready: Any, qtbot: Any, small_video: Any, click: Any
) -> None:
    ready.session.set_recording(small_video)
    ready.session.update(n_views=3)
    click("find_lobes")
    let_settle(qtbot, ready)
    assert "3 views asked for" in ready.lobes.warnings.text()
    assert ready.lobes.heard.isHidden()
    ready.session.set_lobes(ready.session.lobes[:-1])  # which mends it
    assert ready.lobes.heard.isHidden()


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Return what Python's own hook has shown since."""
    shown: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", message="a lens")
        monkeypatch.setattr(warnings, "showwarning", lambda words, *_: shown.append(str(words)))
        yield shown


def test_what_other_packages_warn_of_goes_where_it_always_goes(
    ready: Any, qtbot: Any, shown: list[str]
) -> None:
    """napari's worker took all of it, also what other threads warned of, and showed nothing."""
    let_settle(qtbot, ready)
    begun, end = threading.Event(), threading.Event()

    def work(task: Task) -> None:
        warnings.warn("a lamp is missing", RuntimeWarning, stacklevel=1)
        warnings.warn("a lens is missing", RuntimeWarning, stacklevel=1)
        begun.set()
        end.wait(20)

    ready.jobs.start(Plan("Looking", work, lambda _: None))
    assert begun.wait(20)
    warnings.warn("a mirror is missing", RuntimeWarning, stacklevel=1)
    end.set()
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert shown == ["a lamp is missing", "a mirror is missing"]


def test_the_hook_for_warnings_stays_while_workers_overlap(
    ready: Any, qtbot: Any, shown: list[str]
) -> None:
    """That of the first of two stayed for good, and warnings of all else came to nothing."""
    let_settle(qtbot, ready)
    before, filters = warnings.showwarning, list(warnings.filters)
    begun, end = ([threading.Event() for _ in range(2)] for _ in range(2))

    def waiting(number: int) -> Callable[[Task], None]:
        def work(task: Task) -> None:
            begun[number].set()
            end[number].wait(20)

        return work

    answers: list[object] = []
    ready.jobs.start(Plan("Looking", waiting(0), lambda _: None))
    assert begun[0].wait(20)
    asked = Latest(ready)
    asked.ask(waiting(1), answers.append, answers.append, "lamp")
    assert begun[1].wait(20)
    assert warnings.showwarning is before
    end[0].set()
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=20_000)
    end[1].set()
    qtbot.waitUntil(lambda: bool(answers), timeout=20_000)
    QThreadPool.globalInstance().waitForDone(20_000)
    assert warnings.showwarning is before
    assert list(warnings.filters) == filters


def test_a_hook_that_comes_while_work_goes_on_stays(
    ready: Any, qtbot: Any, shown: list[str]
) -> None:
    """As that of napari.run() does in a script that has opened a file before."""
    let_settle(qtbot, ready)
    begun, end = threading.Event(), threading.Event()

    def work(task: Task) -> None:
        begun.set()
        end.wait(20)

    ready.jobs.start(Plan("Looking", work, lambda _: None))
    assert begun.wait(20)
    warnings.showwarning = newer = lambda *_: None
    end.set()
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    QThreadPool.globalInstance().waitForDone(20_000)
    assert warnings.showwarning is newer


def test_work_that_has_ended_keeps_no_memory(ready: Any, viewer: Any, qtbot: Any) -> None:
    """napari keeps its workers for good, and with them went whole recordings."""
    let_settle(qtbot, ready)
    kept: list[weakref.ref[Any]] = []

    def made(_: Task) -> Any:
        array = np.zeros((100, 100))
        kept.append(weakref.ref(array))
        return array

    answers: list[object] = []
    asked = Latest(ready)
    asked.ask(made, lambda found: answers.append(found.shape), answers.append, "lamp")
    qtbot.waitUntil(lambda: answers == [(100, 100)], timeout=20_000)
    held = np.zeros((100, 100))
    kept.append(weakref.ref(held))

    def work(task: Task, held: Any = held) -> Any:
        return made(task)

    ready.jobs.start(Plan("Looking", work, lambda _: None))
    del held, work
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    QThreadPool.globalInstance().waitForDone(20_000)

    def kept_ones() -> int:
        gc.collect()
        return sum(ref() is not None for ref in kept)

    assert len(kept) == 3
    qtbot.waitUntil(lambda: not kept_ones(), timeout=20_000)


def test_commands_of_the_menu_tell_it_too(viewer: Any, qtbot: Any, notes: Any) -> None:
    values = np.random.default_rng(4).uniform(-np.pi, np.pi, (2, 1, 64, 64)).astype(np.float32)
    data, keywords, _ = stack_layer(wrapped_stack(values), "noise", "wrapped")
    viewer.add_image(data, **keywords)
    unwrap_wl1(viewer)
    qtbot.waitUntil(lambda: len(viewer.layers) == 2, timeout=60_000)
    assert any("nothing but noise" in note for note in notes())


def test_commands_of_the_menu_can_be_stopped(viewer: Any, qtbot: Any, notes: Any) -> None:
    values = np.random.default_rng(4).uniform(-np.pi, np.pi, (96, 2, 128, 128))
    data, keywords, _ = stack_layer(wrapped_stack(values.astype(np.float32)), "long", "wrapped")
    viewer.add_image(data, **keywords)
    unwrap_wl1(viewer)
    window = viewer.window._qt_window  # the list of what runs is napari's own

    def button() -> QPushButton | None:
        bars = window.findChildren(QtLabeledProgressBar)
        return bars[0].cancel_button if bars else None

    qtbot.waitUntil(lambda: button() is not None, timeout=20_000)
    qtbot.wait(300)
    assert not any("Unwrapping" in note for note in notes())
    since = time.perf_counter()
    button().click()
    qtbot.waitUntil(lambda: any("cancelled" in note for note in notes()), timeout=20_000)
    assert time.perf_counter() - since < 5  # about one where nothing else runs
    assert len(viewer.layers) == 1
    qtbot.waitUntil(lambda: button() is None, timeout=20_000)


@pytest.mark.thorough
def test_views_apart_are_said_before_results_are_weighed(
    dock: Any, click: Any, qtbot: Any, tick_only: Any, tmp_path: Path
) -> None:
    data = shifted_views(cell_at_two(), 2, 1, 0.15)
    dock.recording.open_path(write_phase(tmp_path / "apart.ome.tif", data["wrapped"]))
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    tick_only(METHOD)
    click("run")
    assert "Views of several wavelengths do not lie on each other" in dock.unwrap.heard.text()
    assert "µm" in dock.status.text()
