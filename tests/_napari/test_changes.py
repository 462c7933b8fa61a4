"""What must follow when something is changed after, or while, results are made."""

from __future__ import annotations

import numpy as np
import pytest
from driving import let_settle
from qtpy.QtCore import QEvent

import napari_phase4d as p4d
from napari_phase4d._napari.session import (
    Changed,
    Session,
    plan_confidence,
    plan_scores,
    plan_unwrapping,
)
from napari_phase4d.task import UNWATCHED, Task

pytestmark = pytest.mark.gui


@pytest.mark.thorough
def test_a_refused_close_leaves_the_dock_working(viewer, ready, click, qtbot, tick_only) -> None:
    """napari asks before it closes; who answers Cancel goes on."""
    tick_only("spatial-2d")
    window = ready.window()
    ready.eventFilter(window, QEvent(QEvent.Type.Close))  # as napari's window gets it
    qtbot.wait(50)
    assert window.isVisible()
    assert not ready.jobs.closed
    click("run")
    assert ready.session.outcome is not None


@pytest.mark.thorough
def test_corrected_wavelength_reaches_phase_results_and_measure(viewer, ready, click) -> None:
    ready.recording.numbers["wavelength_nm"].value = 532
    for stack in ready.session.reconstruction.data_vars.values():
        assert stack.attrs["wavelength_um"] == 0.532
    ready.session.unwrap(["spatial-2d"])
    result = ready.session.results["spatial-2d"]
    assert result.attrs["wavelength_um"] == 0.532
    click("measure")
    table = ready.compare.measuring.measured
    assert len(table) == 12
    inside = ready.session.outcome.comparison.object_mask().values.astype(bool)
    phase = np.where(inside, result.values, np.nan)
    expected = np.nanmean(phase, axis=(2, 3)).ravel() * 532 / (2 * np.pi)
    np.testing.assert_allclose(table["mean optical path difference (nm)"], expected, rtol=1e-4)
    ready.recording.numbers["magnification"].value = 30
    assert ready.compare.measuring.measured.empty  # its areas would be of the old scale


@pytest.mark.thorough
def test_one_number_of_the_microscope_leaves_the_others(ready) -> None:
    odd = p4d.Optics(wavelength_um=0.51234567, magnification=12.3456789)
    ready.session.recalibrate(ready.session.recording.calibrated(odd))
    ready.recording.numbers["medium_index"].value = 1.34
    assert ready.session.recipe.optics == p4d.Optics(
        0.51234567, odd.camera_pixel_um, 12.3456789, 1.34
    )


@pytest.mark.thorough
def test_regions_and_frame_stay_in_place_when_the_scale_changes(viewer, ready) -> None:
    ready.session.unwrap(["spatial-2d"])
    regions = ready.presenter.add_regions()
    regions.add_rectangles(np.array([[4, 4], [4, 9], [9, 9], [9, 4]]))
    ready.presenter.go_to(3, 1)
    before = regions.scale / viewer.layers["2-D"].scale[2:]
    ready.recording.numbers["magnification"].value = 30
    np.testing.assert_allclose(regions.scale / viewer.layers["2-D"].scale[2:], before)
    ready.recording.numbers["frame_rate_hz"].value = 2
    assert ready.presenter.current_frame() == (3, 1)


@pytest.mark.thorough
def test_unasked_work_that_came_too_late_is_done_again(viewer, ready, qtbot) -> None:
    plan = plan_scores(ready.session, unasked=True)
    found = plan.work(UNWATCHED)
    ready.recording.numbers["magnification"].value = 30
    with pytest.raises(Changed):
        plan.receive(found)
    qtbot.waitUntil(lambda: ready.session.scores is not None, timeout=60_000)
    scores = ready.session.scores
    np.testing.assert_array_equal(scores["time"], ready.session.reconstruction["time"])


@pytest.mark.thorough
def test_truth_chosen_while_results_are_made_or_weighed_counts(ready) -> None:
    session: Session = ready.session
    session.update(methods=("spatial-2d", "directional-l1"))
    plan = plan_unwrapping(session)
    outcome = plan.work(UNWATCHED)
    exact = outcome.comparison.results["directional-l1"] + 0.5
    session.set_truth(exact)
    plan.receive(outcome)
    assert session.outcome.truth is exact
    table = session.outcome.comparison.table
    assert table["mse_rad2"]["directional-l1"] == pytest.approx(0.25, rel=1e-4)
    plan = plan_confidence(session)
    found = plan.work(UNWATCHED)
    session.set_truth(None)
    plan.receive(found)
    table = session.outcome.comparison.table
    assert "doubtful_percent" in table
    assert "mse_rad2" not in table


@pytest.mark.thorough
def test_weighing_is_cancelled_between_results(ready) -> None:
    ready.session.unwrap(["spatial-2d", "temporal", "directional-l1"])
    done: list[int] = []
    plan = plan_confidence(ready.session)
    with pytest.raises(p4d.Cancelled):
        plan.work(Task(lambda n, *_: done.append(n), lambda: bool(done)))
    assert done == [1]
    assert not ready.session.confidence


@pytest.mark.thorough
def test_thin_frames_go_with_their_view_or_not_at_all(ready) -> None:
    session: Session = ready.session
    session.update(boundary=((2, 1), (-1, 0)))
    assert session.recipe.boundary == ((2, 1), (5, 0))
    with pytest.raises(ValueError, match=r"no thin frame \(0, 5\)"):
        session.update(boundary=((0, 5),))
    session.set_lobes([session.lobes[1]])  # the first view goes, and its thin frame with it
    session.reconstruct()
    assert session.recipe.boundary == ((2, 0),)


@pytest.mark.thorough
def test_settings_that_no_field_shows_are_kept(viewer, ready, click, tmp_path) -> None:
    options = {"region-growing": {"rga_threshold": 3.14159}} if has_option() else {}
    ready.session.update(reference=3, options=options, methods=("temporal", "spatial-2d"))
    assert ready.phase.reference.value == "frame 3"
    click("drift")
    assert ready.session.recipe.reference == 3
    assert ready.session.recipe.options == options
    click("reconstruct")
    click("run")
    assert ready.session.outcome.recipe.methods == ("temporal", "spatial-2d")
    assert ready.session.outcome.recipe.options == options


def has_option() -> bool:
    names = {option.name for option in p4d.METHODS["region-growing"].options}
    return "rga_threshold" in names


@pytest.mark.thorough
def test_holograms_are_saved_after_reconstruction(viewer, ready, tmp_path) -> None:
    layer = ready.presenter.holograms
    (path,) = layer.save(str(tmp_path / "video.ome.tif"), plugin="napari-phase4d")
    assert p4d.read_results(path).shape == layer.data.shape


@pytest.mark.thorough
def test_leaving_the_grid_after_all_layers_have_gone(viewer, ready, click) -> None:
    ready.session.unwrap(["spatial-2d", "temporal"])
    viewer.layers.clear()
    mine = viewer.add_image(np.zeros((4, 4)), name="mine")
    click("leave_grid")
    assert not ready.status.property("wrong")
    assert mine.visible
    assert not viewer.canvas.grid.enabled


@pytest.mark.thorough
def test_measure_plot_follows_the_angle(viewer, ready, click, qtbot) -> None:
    ready.session.unwrap(["spatial-2d"])
    click("measure")
    plot = ready.compare.measuring.plot
    for angle in (0, 1):
        ready.presenter.go_to(0, angle)
        let_settle(qtbot, ready)
        table = ready.compare.measuring.measured
        rows = table[table["angle (deg)"] == float(angle)]
        shown = plot.figure.axes[0].get_lines()[0].get_ydata()
        np.testing.assert_array_equal(shown, rows["dry mass (pg)"])


@pytest.mark.thorough
def test_results_of_another_run_are_not_replaced(ready, tmp_path) -> None:
    from napari_phase4d._napari.session import folder_without_results

    assert folder_without_results(tmp_path) == tmp_path
    ready.session.find_lobes()
    ready.session.unwrap(["spatial-2d"])
    ready.session.save(tmp_path)
    assert folder_without_results(tmp_path) == tmp_path / "results_1"
