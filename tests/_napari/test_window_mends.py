"""Faults of the window that a reading of it found: what it shows is what there is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driving import let_settle

import napari_phase4d as p4d
from napari_phase4d._napari.session import Plan, plan_margin
from napari_phase4d.recording import Recording
from napari_phase4d.task import UNWATCHED

pytestmark = pytest.mark.gui


@pytest.fixture
def waiting(dock: Any, qtbot: Any) -> Iterator[Callable[[], None]]:
    """Let a job run until what is returned is called."""
    go_on = threading.Event()

    def ends() -> None:
        go_on.set()
        let_settle(qtbot, dock)

    def start() -> Callable[[], None]:
        dock.jobs.start(Plan("Waiting", lambda task: go_on.wait(60), lambda _: None))
        return ends

    yield start
    go_on.set()


def shown(viewer: Any) -> list[str]:
    return [layer.name for layer in viewer.layers if layer.visible]


def test_differences_are_taken_in_a_thread(compared: Any, viewer: Any, qtbot: Any) -> None:
    compared.show_step(4)
    compared.compare.views["difference"].click()
    assert compared.jobs.running
    assert not [la for la in viewer.layers if "−" in la.name]
    let_settle(qtbot, compared)
    assert shown(viewer) == ["2-D − T/A"]
    compared.compare.views["results"].click()
    let_settle(qtbot, compared)
    before = viewer.layers["2-D − T/A"]
    compared.compare.views["difference"].click()
    let_settle(qtbot, compared)
    assert shown(viewer) == ["2-D − T/A"]
    assert viewer.layers["2-D − T/A"] is before  # it is not taken again


def test_a_difference_of_results_that_have_changed_is_dropped(compared: Any, viewer: Any) -> None:
    plan = compared.presenter.plan_difference("spatial-2d")
    made = plan.work(UNWATCHED)
    compared.session.unwrap(["spatial-2d"])
    with pytest.raises(ValueError, match="changed meanwhile"):
        plan.receive(made)
    assert "−" not in "".join(shown(viewer))


def test_what_the_steps_mean_is_found_out_in_the_thread_too(
    compared: Any, click: Callable[[str], None]
) -> None:
    _, words = plan_margin(compared.session, in_words=True).work(UNWATCHED)
    assert "can't be told yet: run" in words
    click("show_margin")
    assert compared.status.text() == compared.session.steps_words == words


def test_a_layer_that_was_refused_is_not_shown_as_chosen(
    compared: Any, viewer: Any, small_video: Recording, waiting: Any, qtbot: Any
) -> None:
    session, layers = compared.session, compared.recording.layer
    mine = viewer.add_image(np.asarray(small_video.holograms.data).copy(), name="mine")
    truth = np.zeros(session.reconstruction["phase"].shape, np.float32)
    exact = viewer.add_image(truth, name="my truth", visible=False)
    let_settle(qtbot, compared)
    before, ends = layers.value, waiting()
    layers.value = mine
    compared.compare.truth.value = exact
    assert "another job is still running" in compared.status.text()
    assert (layers.value, compared.compare.truth.value) == (before, "none")
    ends()
    compared.compare.truth.value = exact
    compared.jobs.cancel()
    let_settle(qtbot, compared)
    assert compared.compare.truth.value == "none"
    compared.compare.truth.value = exact
    let_settle(qtbot, compared)
    assert session.truth is not None
    assert compared.compare.truth.value is exact
    layers.value = mine  # chosen again, it is taken
    let_settle(qtbot, compared)
    assert session.recording.name == "mine"


def test_a_frame_that_a_recipe_names_is_the_reference_when_it_is_chosen_again(
    ready: Any, small_video: Recording
) -> None:
    session, field = ready.session, ready.phase.reference
    session.update(reference=2)
    assert field.value == "frame 2"
    field.value = "none"
    assert session.recipe.reference is None
    field.value = "frame 2"
    assert session.recipe.reference == 2
    session.set_recording(small_video)
    assert field.value == "none"
    assert "frame 2" not in field.choices
    session.update(reference=3)
    assert field.value == "frame 3"


def test_a_frame_that_was_not_scored_is_called_neither_safe_nor_unsafe(
    dock: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.unwrapping.boundaries.SCORED_TIMES", 2)
    monkeypatch.setattr("napari_phase4d.unwrapping.boundaries.SCORED_PIXELS", 10_000)
    phase = p4d.simulation.swimming_euglena((60, 72), 6, pixel_um=0.5, peak_rad=9)["wrapped"]
    session, part = dock.session, dock.unwrap.boundary
    session.set_phase(phase)
    session.suggest_boundary()
    unknown = [tuple(map(int, frame)) for frame in np.argwhere(np.isnan(session.scores.values))]
    assert unknown
    part.map.frame_hovered.emit(*unknown[0])
    words = part.thumbnail.words.text()
    session.update(boundary=(unknown[0],))
    for said in (words, part.start.text()):
        assert "nan" not in said
        assert "not safe" not in said
        assert "not known" in said


def test_a_cancelled_figure_is_not_written(compared: Any, tmp_path: Path, qtbot: Any) -> None:
    compared.compare.share.save_figure(tmp_path / "figure.png")
    compared.jobs.cancel()
    let_settle(qtbot, compared)
    qtbot.waitUntil(lambda: not compared.jobs.busy, timeout=60_000)
    assert list(tmp_path.iterdir()) == []


def test_a_truth_that_is_renamed_is_followed(compared: Any, viewer: Any, qtbot: Any) -> None:
    session, field = compared.session, compared.compare.truth
    truth = np.zeros(session.reconstruction["phase"].shape, np.float32)
    exact = viewer.add_image(truth, name="my truth", visible=False)
    field.value = exact
    let_settle(qtbot, compared)
    exact.name = "renamed"
    compared.reset_choices()
    assert field.value == exact
    assert field.current_choice == "renamed"
    assert session.truth is not None
    exact.name = "once more"
    viewer.layers.remove(exact)
    assert session.truth is None
    assert field.value == "none"


def test_a_difference_that_was_refused_is_not_shown_as_chosen(
    compared: Any, viewer: Any, waiting: Any, qtbot: Any
) -> None:
    field = compared.compare.difference
    before, other = field.choices[:2]
    assert field.value == before
    ends = waiting()
    field.value = other
    assert "another job is still running" in compared.status.text()
    assert field.value == before
    ends()
    field.value = other
    let_settle(qtbot, compared)
    assert field.value == other
    field.value = before
    compared.jobs.cancel()
    let_settle(qtbot, compared)
    assert field.value == other
