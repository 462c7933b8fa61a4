"""Step 2: circles by mouse, numbers in the table, finding."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from driving import drag, let_settle
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QApplication, QWidget

import napari_phase4d as p4d
from napari_phase4d._napari.session.phase_plans import with_known_views
from napari_phase4d._napari.widgets.spectrum_canvas import COLUMNS
from napari_phase4d.holography import Lobe, pair_distance

pytestmark = pytest.mark.gui


@pytest.mark.thorough
def test_changed_lobes_ask_for_a_new_reconstruction(ready, click, tick_only) -> None:
    tick_only("spatial-2d")
    ready.lobes.table.item(0, 2).setText("0.08")
    assert ready.session.lobes[0].radius == 0.08
    click("run")
    assert "press Reconstruct in step 3 again" in ready.status.text()
    click("reconstruct")
    click("run")
    assert ready.session.outcome is not None
    ready.phase.window.value = "disk"
    click("run")
    assert "press Reconstruct in step 3 again" in ready.status.text()


@pytest.mark.thorough
def test_failed_search_leaves_the_spectrum_to_place_lobes_by_hand(dock, click) -> None:
    noise = np.random.default_rng(0).normal(size=(8, 64, 64)).astype(np.float32)
    dock.session.open(noise)
    click("find_lobes")
    assert "place the lobes by hand" in dock.status.text()
    assert dock.session.spectrum is not None
    click("add_lobe")
    assert len(dock.lobes.canvas.lobes) == 1


@pytest.mark.thorough
def test_spectrum_shows_by_itself_and_gives_way(dock, qtbot, click, small_video) -> None:
    dock.session.set_recording(small_video)
    assert dock.session.spectrum is None
    assert not dock.jobs.running  # nothing that the user would have to wait for
    assert "find the lobes" in dock.status.text()
    qtbot.waitUntil(lambda: dock.session.spectrum is not None, timeout=60_000)
    assert "find the lobes" in dock.status.text()
    assert dock.session.lobes == []
    dock.session.set_recording(small_video.calibrated())
    dock.recording.numbers["magnification"].value = 30  # leaves the frames as they are
    qtbot.waitUntil(lambda: dock.session.spectrum is not None, timeout=60_000)
    dock.session.set_recording(small_video.calibrated())
    click("find_lobes")  # at once, while the spectrum is still being computed
    assert len(dock.session.lobes) == 2


@pytest.mark.thorough
def test_finding_again_keeps_what_the_user_typed(ready, click) -> None:
    ready.lobes.table.item(0, 3).setText("33")
    ready.lobes.table.item(0, 0).setText("0.18")
    click("find_lobes")
    assert ready.session.lobes[0].angle_deg == 33
    assert ready.session.lobes[0].carrier[0] == pytest.approx(0.19, abs=0.003)


@pytest.mark.thorough
def test_wrong_number_in_the_table_changes_nothing(ready) -> None:
    before = ready.session.lobes
    for column, words, sentence in (
        (0, "abc", "takes a number"),
        (1, "0.9", "outside the spectrum"),
        (2, "-1", "lobe radius must lie between"),
    ):
        ready.lobes.table.item(0, column).setText(words)
        assert sentence in ready.status.text()
        assert ready.session.lobes == before
        assert ready.lobes.table.item(0, column).text() != words


@pytest.mark.thorough
def test_flip_and_angle_are_set_in_the_table(ready) -> None:
    table = ready.lobes.table
    assert [table.item(row, 3).text() for row in (0, 1)] == ["?", "?"]  # nobody knows them yet
    flipped = not ready.session.lobes[1].flip
    state = Qt.CheckState.Checked if flipped else Qt.CheckState.Unchecked
    table.item(1, COLUMNS.index("flip")).setCheckState(state)
    table.item(1, 3).setText("33.5")
    assert ready.session.lobes[1].flip is flipped
    assert ready.session.lobes[1].angle_deg == 33.5


def test_circles_are_dragged_and_resized_with_the_mouse(ready) -> None:
    ready.show_step(1)
    QApplication.processEvents()
    canvas = ready.lobes.canvas
    lobe = ready.session.lobes[0]
    ky, kx = lobe.carrier
    drag(canvas, (ky, kx), (ky + 0.05, kx - 0.03))
    moved = ready.session.lobes[0]
    np.testing.assert_allclose(moved.carrier, (ky + 0.05, kx - 0.03), atol=0.006)
    assert moved.radius == lobe.radius
    ky, kx = moved.carrier
    drag(canvas, (ky, kx + moved.radius), (ky, kx + 0.05))
    np.testing.assert_allclose(ready.session.lobes[0].radius, 0.05, atol=0.006)
    assert float(ready.lobes.table.item(0, 0).text()) == pytest.approx(ky, abs=1e-4)
    assert "cycles/µm" in ready.lobes.frequency.text()


@pytest.mark.thorough
def test_lobes_are_added_and_removed(ready, click) -> None:
    click("add_lobe")
    assert len(ready.session.lobes) == 3
    assert ready.lobes.table.rowCount() == 3
    ready.lobes.table.setCurrentCell(0, 0)
    click("remove_lobe")
    assert len(ready.session.lobes) == 2
    assert ready.session.lobes[-1].angle_deg == 2


@pytest.mark.thorough
def test_views_are_counted_anew_for_each_recording(dock, small_video, click) -> None:
    exact = p4d.simulation.swimming_euglena((128, 128), 6, pixel_um=0.35, peak_rad=6)
    one = p4d.simulation.multiplexed_video(exact["phase"][:, :1], carriers=[(0.19, 0.21)])
    for recording, count in ((one, 1), (small_video, 2), (one, 1)):
        dock.session.set_recording(recording)
        click("find_lobes")
        assert len(dock.session.lobes) == count
        assert dock.lobes.n_views.native.currentText() == "auto"


@pytest.mark.thorough
def test_every_new_circle_has_a_place_of_its_own(ready, click) -> None:
    for _ in range(3):
        click("add_lobe")
    carriers = [lobe.carrier for lobe in ready.session.lobes]
    assert len(carriers) == 5
    apart = [pair_distance(a, b) for a, b in itertools.combinations(carriers, 2)]
    assert min(apart) > 0.05


def test_step_3_opens_once_the_views_are_found(dock, click, small_video, qtbot) -> None:
    dock.session.set_recording(small_video)
    click("find_lobes")
    assert len(dock.session.lobes) == 2
    assert dock.sections[2].is_open
    qtbot.wait(100)
    port, go = dock.scroll.viewport(), dock.phase.findChild(QWidget, "reconstruct")
    assert port.rect().contains(go.mapTo(port, go.rect().center()))


@pytest.mark.filterwarnings("ignore:.*3 views asked")
def test_views_in_doubt_are_looked_at_first(dock, click, small_video) -> None:
    dock.session.set_recording(small_video)
    dock.session.update(n_views=3)  # more than there are
    click("find_lobes")
    assert dock.lobes.doubts()
    assert not dock.sections[2].is_open
    assert dock.sections[1].is_open


@pytest.mark.thorough
def test_a_circle_on_the_zero_order_is_doubted_folded_or_not(ready, click, qtbot) -> None:
    section = ready.sections[1]
    if not section.is_open:
        qtbot.mouseClick(section.heading, Qt.MouseButton.LeftButton)
    QApplication.processEvents()
    assert section.badge.text() == "✓ done"
    drag(ready.lobes.canvas, ready.session.lobes[0].carrier, (0.02, 0.02))
    let_settle(qtbot, ready)
    assert section.badge.text() == "⚠ look"
    assert "zero order" in ready.lobes.warnings.text()
    qtbot.mouseClick(section.heading, Qt.MouseButton.LeftButton)  # folds it
    let_settle(qtbot, ready)
    assert not section.is_open
    assert section.badge.isVisible()
    assert section.badge.text() == "⚠ look"
    click("drift")  # what is said at the headings is worked out anew
    assert not section.is_open
    assert section.badge.text() == "⚠ look"
    assert "zero order" in section.badge.toolTip()


@pytest.mark.parametrize("flip", [False, True])
def test_the_sign_of_a_view_stays_where_its_other_lobe_is_found(flip: bool) -> None:
    known = Lobe((-0.2, -0.2), 0.08, 7, flip=flip)
    found = with_known_views([Lobe((0.2, 0.2), 0.08)], [known])
    assert found == [Lobe((0.2, 0.2), 0.08, 7, flip=not flip)]
    again = with_known_views([Lobe((-0.21, -0.2), 0.08)], [known])
    assert again == [Lobe((-0.21, -0.2), 0.08, 7, flip=flip)]
