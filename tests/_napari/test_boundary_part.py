"""Step 4's map: clicks move the sliders, the path follows, hovering says why."""

from __future__ import annotations

import numpy as np
import pytest
from driving import click_cell
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QPushButton

import napari_phase4d as p4d
from napari_phase4d._napari.session import StepState, step_states
from napari_phase4d.words import frame_in_words

pytestmark = pytest.mark.gui


def test_click_sets_the_frame_and_shift_click_adds_one(viewer, ready) -> None:
    part = ready.unwrap.boundary
    click_cell(part.map, 3, 1)
    assert ready.session.recipe.boundary == ((3, 1),)
    assert ready.presenter.current_frame() == (3, 1)
    click_cell(part.map, 5, 0, Qt.KeyboardModifier.ShiftModifier)
    assert ready.session.recipe.boundary == ((3, 1), (5, 0))
    assert ready.presenter.current_frame() == (5, 0)
    click_cell(part.map, 3, 1, Qt.KeyboardModifier.ShiftModifier)
    assert ready.session.recipe.boundary == ((5, 0),)  # the second time takes it away
    click_cell(part.map, 5, 0, Qt.KeyboardModifier.ShiftModifier)
    assert ready.session.recipe.boundary == ((5, 0),)  # but one always stays
    click_cell(part.map, 0, 0)
    assert ready.session.recipe.boundary == ((0, 0),)


@pytest.mark.thorough
def test_hovering_shows_the_frame_and_its_score(viewer, ready, qtbot) -> None:
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    part = ready.unwrap.boundary
    part.map.frame_hovered.emit(4, 1)
    words = part.thumbnail.words.text()
    assert "time 4 (0.667 s), view 2" in words
    score = float(ready.session.scores.values[4, 1])
    assert f"Score {score:.3f}" in words
    assert "agree on about" in words
    assert part.thumbnail.picture.pixmap().width() > 10
    part.map.left.emit()
    time, _ = ready.session.scores.attrs["best"]
    assert part.thumbnail.words.text().startswith(f"<b>Start: time {time} ")


def test_start_is_the_star_until_the_user_clicks_and_again_by_a_button(
    viewer, ready, click, qtbot
) -> None:
    part, session = ready.unwrap.boundary, ready.session
    if session.scores is None:
        assert part.start.text() == "Start: the safest frame, which is being looked for …"
    qtbot.waitUntil(lambda: session.scores is not None, timeout=60_000)
    best = tuple(int(i) for i in np.unravel_index(int(session.scores.values.argmax()), (6, 2)))
    words = frame_in_words(session.reconstruction["phase"], *best)
    automatic = f"Start: {words} (found automatically)."
    assert part.start.text() == automatic
    assert session.start_frames == (best,)
    other = (2, 1) if best != (2, 1) else (3, 1)
    click_cell(part.map, *other)
    assert session.recipe.boundary == (other,)
    words = frame_in_words(session.reconstruction["phase"], *other)
    assert part.start.text() == f"Start: {words} (chosen)."
    click("automatic")
    assert session.recipe.boundary == "auto"
    assert session.start_frames == (best,)
    assert part.start.text() == automatic
    assert ready.presenter.current_frame() == best
    assert automatic in ready.status.text()
    assert "agree on" in ready.status.text()


@pytest.mark.thorough
def test_an_unsafe_start_of_ones_own_is_said_above_run(viewer, ready, qtbot) -> None:
    session, part = ready.session, ready.unwrap.boundary
    exact = p4d.simulation.moving_shape("dividing", (48, 48), 8, angles_deg=(0.0, 6.0))
    session.set_phase(exact["wrapped"])
    qtbot.waitUntil(lambda: session.scores is not None, timeout=60_000)
    worst = tuple(int(i) for i in np.unravel_index(int(session.scores.values.argmin()), (8, 2)))
    assert session.scores.values[worst] < 0.95
    click_cell(part.map, *worst)
    assert part.start.text().endswith("(chosen), not safe: ★ is safer.")
    assert part.start.mapToGlobal(part.start.rect().bottomLeft()).y() < run_of(ready)
    # It stays while other frames are looked at, and goes with its cause.
    part.map.frame_hovered.emit(0, 0)
    assert "not safe" in part.start.text()
    click_cell(part.map, *session.scores.attrs["best"])
    assert "not safe" not in part.start.text()


def run_of(dock) -> int:
    """Return where on the screen the button Run begins."""
    run = dock.findChild(QPushButton, "run")
    return run.mapToGlobal(run.rect().topLeft()).y()


@pytest.mark.thorough
def test_shift_click_adds_to_the_star(viewer, ready, qtbot) -> None:
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    (best,) = ready.session.start_frames
    other = (3, 1) if best != (3, 1) else (4, 1)
    click_cell(ready.unwrap.boundary.map, *other, Qt.KeyboardModifier.ShiftModifier)
    assert ready.session.recipe.boundary == (best, other)


@pytest.mark.thorough
def test_a_run_says_its_start_and_renews_the_star(viewer, ready, click, qtbot, tick_only) -> None:
    session = ready.session
    tick_only("temporal-angular", "directional-l1")
    qtbot.waitUntil(lambda: session.scores is not None, timeout=60_000)
    (started,) = session.start_frames
    click("run")
    frame = frame_in_words(session.reconstruction["phase"], *started)
    words = f"Start: {frame} (found automatically)."
    assert words in ready.status.text()
    assert session.outcome.recipe.boundary == (started,)
    for result in session.results.values():
        assert result.attrs["boundary"] == [list(started)]
        assert result.attrs["boundary_found_by"] == session.outcome.scores.attrs["basis"]
    qtbot.waitUntil(lambda: "the result of WL1" in session.scores.attrs["basis"], timeout=60_000)
    own = session.results["directional-l1"]
    expected = p4d.score_boundaries(session.reconstruction["phase"], own)
    np.testing.assert_array_equal(session.scores.values, expected.values)
    assert session.recipe.boundary == "auto"
    assert session.start_frames == (tuple(expected.attrs["best"]),)
    # Wherever the star is now, what was run is up to date, and named by where it started.
    assert step_states(session)[3] == StepState.DONE
    assert session.outcome.recipe.boundary == (started,)
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=60_000)
    before = session.scores
    qtbot.wait(300)  # longer than it takes to begin something unasked
    assert session.scores is before


@pytest.mark.thorough
def test_a_chosen_start_is_kept_and_noted_as_chosen(viewer, ready, click, tick_only) -> None:
    tick_only("directional-l1")
    click_cell(ready.unwrap.boundary.map, 4, 1)
    click("run")
    assert "Start: time 0.667 s, view 2 (chosen)." in ready.status.text()
    assert ready.session.outcome.scores is None
    assert "boundary_found_by" not in ready.session.results["directional-l1"].attrs
    assert ready.session.recipe.boundary == ((4, 1),)


def test_use_current_view(viewer, ready, click) -> None:
    ready.presenter.go_to(4, 1)
    click("use_view")
    assert ready.session.recipe.boundary == ((4, 1),)


@pytest.mark.thorough
def test_frames_are_chosen_by_key(viewer, ready) -> None:
    part = ready.unwrap.boundary
    part.map.setFocus()
    for key in (Qt.Key.Key_Home, Qt.Key.Key_Right, Qt.Key.Key_Right, Qt.Key.Key_Return):
        QTest.keyClick(part.map, key)
    assert ready.session.recipe.boundary[0][0] == 2
    assert ready.presenter.current_frame()[0] == 2


@pytest.mark.thorough
def test_ticking_a_method_shows_its_path(viewer, ready, click, qtbot) -> None:
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    part = ready.unwrap.boundary
    assert part.path.native.currentText() == "T/A"
    for _ in range(2):  # off and on again
        click("method_angular-temporal")
    assert part.path.native.currentText() == "A/T"
    assert "A/T: angle, then time" in part.path.native.toolTip()
    drawn = part.map.grab().toImage()
    part.path.native.setCurrentText("Temporal")
    assert part.map.grab().toImage() != drawn
