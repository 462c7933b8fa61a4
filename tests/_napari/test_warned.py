"""What work warns of is seen in the window: at its step, at the foot, or as napari's own."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driving import let_settle
from napari.utils.notifications import notification_manager
from qtpy.QtCore import QThreadPool

from napari_phase4d._napari.jobs import Latest
from napari_phase4d._napari.menus import unwrap_wl1
from napari_phase4d._napari.session import Plan, StepNumber
from napari_phase4d._napari.viewing.layers import stack_layer
from napari_phase4d.io import write_phase
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
    # It is of the other work still when something else was done, or came to nothing.
    ready.jobs.start(warning_plan([], title="Another"))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ON_SCREEN in ready.unwrap.heard.text()
    ready.jobs.start(warning_plan([]))
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert ready.unwrap.heard.isHidden()


def test_it_is_said_while_the_work_goes_on_and_after_it_was_stopped(
    ready: Any, qtbot: Any
) -> None:
    let_settle(qtbot, ready)

    def work(task: Task) -> None:
        watch = Watch(1000, "looking", task)
        watched(lambda: warn("<b> is no frame"), watch)  # by a thread of its own
        while True:
            watch.check()

    plan = Plan("Looking", work, lambda _: None, step=StepNumber.PHASE)
    ready.jobs.start(plan)
    qtbot.waitUntil(lambda: not ready.phase.heard.isHidden(), timeout=20_000)
    assert ready.jobs.running
    assert ready.phase.heard.text() == "⚠ &lt;b&gt; is no frame."
    ready.jobs.cancel()
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert not ready.phase.heard.isHidden()


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
    assert ready.session.heard.of(StepNumber.LOBES)
    assert ready.lobes.heard.isHidden()


def test_what_other_packages_warn_of_is_shown_once(ready: Any, qtbot: Any, notes: Any) -> None:
    let_settle(qtbot, ready)

    def work(task: Task) -> None:
        for _ in range(3):
            warnings.warn("a lens is missing", RuntimeWarning, stacklevel=1)
            warnings.warn("ask for lenses by name", DeprecationWarning, stacklevel=1)

    ready.jobs.start(Plan("Looking", work, lambda _: None))
    qtbot.waitUntil(lambda: bool(notes()), timeout=20_000)
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=20_000)
    assert notes() == ["a lens is missing"]


def test_pythons_hook_comes_back_after_workers_that_overlap(ready: Any, qtbot: Any) -> None:
    """The hook of the first of two stayed for good, and warnings of all else came to nothing."""
    let_settle(qtbot, ready)
    before, end, asked = warnings.showwarning, [threading.Event() for _ in range(2)], Latest(ready)
    begun = [threading.Event() for _ in range(2)]

    def waiting(number: int) -> Callable[[Task], None]:
        def work(task: Task) -> None:
            begun[number].set()
            end[number].wait(20)

        return work

    answers: list[object] = []
    ready.jobs.start(Plan("Looking", waiting(0), lambda _: None))
    assert begun[0].wait(20)
    asked.ask(waiting(1), answers.append, answers.append, "lamp")
    assert begun[1].wait(20)
    end[0].set()
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=20_000)
    end[1].set()
    qtbot.waitUntil(lambda: bool(answers), timeout=20_000)
    let_settle(qtbot, ready)
    QThreadPool.globalInstance().waitForDone(20_000)
    qtbot.waitUntil(lambda: warnings.showwarning is before, timeout=5_000)


def test_commands_of_the_menu_tell_it_too(viewer: Any, qtbot: Any, notes: Any) -> None:
    values = np.random.default_rng(4).uniform(-np.pi, np.pi, (2, 1, 64, 64)).astype(np.float32)
    data, keywords, _ = stack_layer(wrapped_stack(values), "noise", "wrapped")
    viewer.add_image(data, **keywords)
    unwrap_wl1(viewer)
    qtbot.waitUntil(lambda: len(viewer.layers) == 2, timeout=60_000)
    assert any("nothing but noise" in note for note in notes())


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
