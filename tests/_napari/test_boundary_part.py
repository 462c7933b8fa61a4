"""Step 4's map: clicks move the sliders, the path follows, hovering says why."""

from __future__ import annotations

import numpy as np
import pytest
from driving import click_cell
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest

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


def test_hovering_shows_the_frame_and_its_score(viewer, ready, qtbot) -> None:
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    part = ready.unwrap.boundary
    part.map.frame_hovered.emit(4, 1)
    words = part.thumbnail.words.text()
    assert "time 4 (0.667 s), angle 1°" in words
    score = float(ready.session.scores.values[4, 1])
    assert f"Score {score:.3f}" in words
    assert "agree on about" in words
    assert part.thumbnail.picture.pixmap().width() > 10
    part.map.left.emit()
    assert part.thumbnail.words.text().startswith("<b>Start: time 0")


def test_suggest_takes_the_best_frame(viewer, ready, click, qtbot) -> None:
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    click_cell(ready.unwrap.boundary.map, 2, 1)
    click("suggest")
    best = np.unravel_index(int(ready.session.scores.values.argmax()), (6, 2))
    assert ready.session.recipe.boundary == (tuple(int(i) for i in best),)
    assert ready.presenter.current_frame() == tuple(best)
    assert "agree on" in ready.status.text()


def test_use_current_view(viewer, ready, click) -> None:
    ready.presenter.go_to(4, 1)
    click("use_view")
    assert ready.session.recipe.boundary == ((4, 1),)


def test_frames_are_chosen_by_key(viewer, ready) -> None:
    part = ready.unwrap.boundary
    part.map.setFocus()
    for key in (Qt.Key.Key_Home, Qt.Key.Key_Right, Qt.Key.Key_Right, Qt.Key.Key_Return):
        QTest.keyClick(part.map, key)
    assert ready.session.recipe.boundary[0][0] == 2
    assert ready.presenter.current_frame()[0] == 2


def test_ticking_a_method_shows_its_path(viewer, ready, click) -> None:
    part = ready.unwrap.boundary
    assert part.path.native.currentText() == "T/A"
    for _ in range(2):  # off and on again
        click("method_angular-temporal")
    assert part.path.native.currentText() == "A/T"
    assert "A/T: angle, then time" in part.path.native.toolTip()
    drawn = part.map.grab().toImage()
    part.path.native.setCurrentText("Temporal")
    assert part.map.grab().toImage() != drawn
