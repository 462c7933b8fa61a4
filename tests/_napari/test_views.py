"""Step 5 shows one thing at a time and where methods disagree; headings say what to look at."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from driving import canvas_of, click_cell, frame_label, frame_on_canvas, let_settle
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from test_dock_reopened import close

import napari_phase4d as p4d
from napari_phase4d.pipeline import PAPER_METHODS

pytestmark = pytest.mark.gui

SHAPE = (90, 110)
METHODS = ("spatial-2d", "angular", "directional-l1")


@pytest.fixture
def differing(dock: Any, qtbot: Any) -> Any:
    """Return the dock with results that differ, as the run button leaves it."""
    exact = p4d.simulation.swimming_euglena(SHAPE, 12, peak_rad=30)
    dock.session.set_phase(exact["wrapped"])
    dock.session.update(methods=METHODS)
    QTest.mouseClick(dock.unwrap.go, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    return dock


def down(dock: Any) -> list[str]:
    """Names of the views whose button is down."""
    return [name for name, button in dock.compare.views.items() if button.isChecked()]


@pytest.mark.thorough
def test_one_view_at_a_time(differing: Any, click: Any, viewer: Any) -> None:
    assert down(differing) == ["results"]
    layer = viewer.layers["WL1"]
    low, high = layer.contrast_limits
    zero, top = layer.colormap.map(np.array([(0 - low) / (high - low), 1.0]))
    assert zero[:3].max() < 0.05  # the empty field is black
    assert top[:3].sum() > 2
    for name, button, words in (
        ("confidence", "show_confidence", "colours: chance to be right, 0 to 1"),
        ("margin", "show_margin", "colours: steps in half cycles"),
        ("wrapped", "show_wrapped", ""),
        ("difference", "show_difference", "colours: difference in rad"),
        ("results", "side_by_side", "colours: phase in rad"),
    ):
        click(button)
        assert down(differing) == [name]
        if name == "confidence":  # what is safe is bright
            colours = viewer.layers["confidence in WL1"].colormap.map(np.array([0.0, 1.0]))
            assert colours[1, :3].sum() > colours[0, :3].sum() + 1
        text = viewer.canvas.overlays.text
        assert (frame_on_canvas(viewer)[:5], text.text) == ("time ", words)
        assert text.visible == bool(words)
        assert not viewer.canvas.overlays.current_slice.visible  # which knows no units
        places = {
            la.colorbar.position for la in viewer.layers if la.visible and la.colorbar.visible
        }
        # In one row, the bar would stand where the words do.
        assert places <= {"top_right" if name in ("wrapped", "difference") else "bottom_left"}
    viewer.dims.set_current_step(0, 4)
    viewer.dims.set_current_step(1, 1)
    times = differing.session.reconstruction["time"].values
    assert frame_on_canvas(viewer) == f"time {times[4]:.3g} s, angle 21°"
    click("leave_grid")
    assert frame_on_canvas(viewer) == ""
    assert viewer.canvas.overlays.text.text == ""
    assert not viewer.canvas.overlays.text.visible
    assert down(differing) == []
    # A button whose view can't be shown does not stay down.
    differing.session.take_outcome(None)
    click("show_confidence")
    assert differing.status.property("wrong")
    assert down(differing) == []


@pytest.mark.thorough
def test_the_users_own_words_stay_on_the_canvas(differing: Any, click: Any, viewer: Any) -> None:
    click("leave_grid")
    text = viewer.canvas.overlays.text
    text.text, text.visible = "cell 7, March", True
    click("side_by_side")
    assert (text.text, text.visible) == ("cell 7, March", True)
    assert viewer.canvas.overlays.current_slice.visible  # so that time and view are said
    assert frame_on_canvas(viewer) == ""
    click("leave_grid")
    text.text = ""
    click("side_by_side")
    assert frame_on_canvas(viewer)
    text.text = "cell 8, March"  # in the midst of it
    viewer.dims.set_current_step(0, 3)
    assert frame_on_canvas(viewer) == ""
    assert viewer.canvas.overlays.current_slice.visible


@pytest.mark.thorough
def test_the_frame_stands_above_what_the_colours_mean(
    differing: Any, click: Any, viewer: Any
) -> None:
    canvas = canvas_of(viewer)
    label = frame_label(viewer)
    size = canvas.size()
    for height in (size.height(), size.height() - 40):
        canvas.resize(size.width(), height)
        assert label.x() < 20
        assert 20 < canvas.height() - label.geometry().bottom() < 50
    canvas.resize(size)
    above = label.geometry().bottom()
    click("show_wrapped")  # whose colours need no words
    label = frame_label(viewer)
    assert above < label.geometry().bottom() < canvas.height()


@pytest.mark.thorough
def test_napari_says_the_frame_when_the_panel_has_closed(differing: Any, viewer: Any) -> None:
    assert not viewer.canvas.overlays.current_slice.visible
    differing.close_down()
    assert frame_on_canvas(viewer) == ""
    assert viewer.canvas.overlays.current_slice.visible
    assert viewer.canvas.overlays.text.text == "colours: phase in rad"


@pytest.mark.thorough
def test_another_panel_says_it_again(differing: Any, viewer: Any, qtbot: Any) -> None:
    close(viewer, differing, qtbot)
    viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    viewer.dims.set_current_step(0, 4)
    assert frame_on_canvas(viewer) == "time 0.667 s, angle 21°"
    assert not viewer.canvas.overlays.current_slice.visible


@pytest.mark.thorough
def test_the_difference_is_to_what_is_chosen(
    differing: Any, click: Any, viewer: Any, qtbot: Any
) -> None:
    assert differing.compare.difference.value == "less WL1"  # the one most to be trusted
    click("show_difference")
    results = differing.session.results
    layer = viewer.layers["2-D − WL1"]
    expected = results["spatial-2d"].values - results["directional-l1"].values
    np.testing.assert_array_equal(layer.data, expected)
    differing.compare.difference.value = "less 2-D"
    let_settle(qtbot, differing)
    assert viewer.layers["WL1 − 2-D"].visible


@pytest.mark.thorough
def test_the_sliders_go_to_where_methods_disagree(differing: Any, viewer: Any, qtbot: Any) -> None:
    worst = differing.session.verdict.frame
    assert worst not in (None, (0, 0))
    assert differing.presenter.current_frame() == worst
    assert "here methods disagree most" in differing.status.text()

    # The strip shows where they agree, and leads there.
    strip, session = differing.compare.agreement, differing.session
    assert strip.isVisible()
    inside = session.outcome.comparison.object_mask().values
    first, *others = (session.results[method].values for method in METHODS)
    differ = np.any([abs(other - first) > np.pi for other in others], axis=0)
    shares = (differ & inside).sum((2, 3)) / inside.sum((2, 3))
    assert shares.max() > 0.005
    np.testing.assert_allclose(strip._picture.scores, 1 - shares, atol=1e-6)
    click_cell(strip, 4, 1)
    assert differing.presenter.current_frame() == (4, 1)
    strip.setFocus()
    for key in (Qt.Key.Key_Right, Qt.Key.Key_Right, Qt.Key.Key_Return):
        QTest.keyClick(strip, key)
    assert differing.presenter.current_frame() == (6, 1)

    # Napari's own words do not change then: for each it would lay the names of all results out.
    heard: list[Any] = []
    overlays = viewer.canvas.overlays
    for overlay in (overlays.text, overlays.current_slice):
        overlay.events.connect(heard.append)
    before = frame_on_canvas(viewer)
    viewer.dims.set_current_step(0, 4)
    assert frame_on_canvas(viewer) != before
    assert not heard


@pytest.mark.thorough
def test_they_move_there_in_a_turn_of_their_own(viewer: Any, dock: Any, qtbot: Any) -> None:
    dock.session.set_phase(p4d.simulation.swimming_euglena(SHAPE, 12, peak_rad=30)["wrapped"])
    dock.session.unwrap(METHODS)
    moved: list[bool] = []
    turns = dock.presenter.turns
    viewer.dims.events.current_step.connect(lambda _: moved.append(turns.pending))
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    qtbot.waitUntil(lambda: not turns.pending)
    assert dock.presenter.current_frame() == dock.session.verdict.frame
    assert moved
    assert all(moved)


@pytest.mark.thorough
def test_but_not_if_somebody_has_moved_them(dock: Any, qtbot: Any) -> None:
    dock.session.set_phase(p4d.simulation.swimming_euglena(SHAPE, 12, peak_rad=30)["wrapped"])
    dock.session.update(methods=METHODS)
    dock.session.unwrap(METHODS)
    dock.presenter.go_to(3, 1)
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    assert dock.session.verdict.frame is not None
    assert dock.presenter.current_frame() == (3, 1)


@pytest.mark.thorough
def test_the_picture_is_cropped_to_the_object(viewer: Any, dock: Any) -> None:
    cell = p4d.simulation.swimming_euglena((60, 60), 2, peak_rad=9)["wrapped"].values
    wide = np.zeros((2, 2, 240, 240), np.float32)
    wide[..., 150:210, 20:80] = cell  # in one corner
    pixel_um = 0.5
    places = {axis: (axis, pixel_um * np.arange(240)) for axis in ("y", "x")}
    coords = {"time": [0.0, 1.0], "angle": [0.0, 5.0], **places}
    dock.session.set_phase(xr.DataArray(wide, coords, ("time", "angle", "y", "x")))
    dock.session.unwrap(["spatial-2d", "temporal"])
    centre = np.array(viewer.scene.camera.center[-2:])
    np.testing.assert_allclose(centre, [180 * pixel_um, 50 * pixel_um], atol=6 * pixel_um)
    cropped = viewer.scene.camera.zoom
    cell = np.array(viewer.canvas.size) / viewer.canvas.grid.actual_shape(viewer.layers)
    assert (60 * pixel_um * cropped < cell).all()
    viewer.reset_view()
    assert cropped > 2 * viewer.scene.camera.zoom


@pytest.mark.thorough
@pytest.mark.parametrize("methods", [PAPER_METHODS[:1], PAPER_METHODS[:2], PAPER_METHODS])
def test_every_cell_of_the_grid_holds_the_whole_field(
    methods: tuple[str, ...], viewer: Any, dock: Any, qtbot: Any
) -> None:
    cell = p4d.simulation.swimming_euglena((60, 60), 2, peak_rad=9)["wrapped"]
    dock.session.set_phase(cell.where(cell != 0, np.float32(0.5)))  # nothing to crop to
    dock.session.update(methods=methods, mask=None)
    QTest.mouseClick(dock.unwrap.go, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: dock.session.outcome is not None, timeout=60_000)
    let_settle(qtbot, dock)
    layer, camera, canvas = viewer.layers["2-D"], viewer.scene.camera, viewer.canvas
    cells = canvas.grid.actual_shape(viewer.layers)
    field = np.ptp(layer.extent.world, axis=0)[-2:] + layer.scale[-2:]
    assert 0.85 < (field * camera.zoom / (np.array(canvas.size) / cells)).max() < 1


@pytest.mark.thorough
def test_results_appear_as_their_methods_end(dock: Any, qtbot: Any) -> None:
    exact = p4d.simulation.swimming_euglena((160, 200), 24, peak_rad=30)
    dock.session.set_phase(exact["wrapped"])
    dock.session.update(methods=("spatial-2d", "directional-l1"), boundary=((0, 0),))
    seen: list[tuple[str, bool]] = []
    dock.session.result_finished.connect(
        lambda method, *_: seen.append((method, dock.session.outcome is None))
    )
    QTest.mouseClick(dock.unwrap.go, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    # Each came before the whole, and is shown by one layer.
    assert seen == [("spatial-2d", True), ("directional-l1", True)]
    names = [layer.name for layer in dock.presenter.viewer.layers]
    assert names.count("2-D") == names.count("WL1") == 1


@pytest.mark.thorough
def test_a_heading_is_amber_where_something_needs_a_look(dock: Any, small_video: Any) -> None:
    badge = dock.sections[0].badge
    dock.session.set_recording(small_video)
    assert badge.text() == "✓ done"
    doubted = replace(small_video, notes=("The camera pixel is not known.",))
    dock.session.set_recording(doubted)
    assert badge.text() == "⚠ look"
    assert "The camera pixel is not known." in badge.toolTip()


def test_an_error_goes_with_its_cause(ready: Any, click: Any, tick_only: Any) -> None:
    tick_only()
    click("run")
    assert "no method is ticked" in ready.status.text()
    click("method_spatial-2d")
    assert not ready.status.property("wrong")
    assert "no method" not in ready.status.text()


@pytest.mark.thorough
def test_a_recipe_with_lobes_goes_on_with_phase(dock: Any, ready: Any) -> None:
    recipe = ready.session.recipe
    assert recipe.lobes
    ready.session.set_recording(ready.session.recording, recipe=recipe)
    assert dock.sections[2].is_open
    assert "press Reconstruct" in dock.status.text()


@pytest.mark.thorough
def test_the_others_open_by_a_click(dock: Any, click: Any) -> None:
    dock.show_step(3)
    rest, more = dock.unwrap.list.rest, dock.unwrap.list.more
    assert not rest.isVisible()
    assert more.text() == "Others (0 of 7 ticked)"
    click("method_laplacian")  # which opens them first
    assert rest.isVisible()
    assert more.text() == "Others (1 of 7 ticked)"
    assert "laplacian" in dock.session.recipe.methods
    click("more_methods")
    assert not rest.isVisible()


def test_a_layer_of_napari_is_offered(viewer: Any, dock: Any) -> None:
    viewer.add_image(np.random.default_rng(0).random((64, 64)), name="from the camera")
    assert "“from the camera”, choose it as the layer in step 1" in dock.status.text()


def test_one_frame_has_no_rate_of_the_recording_before(dock: Any, small_video: Any) -> None:
    dock.session.set_recording(small_video)
    rate = dock.recording.numbers["frame_rate_hz"]
    assert rate.value == pytest.approx(small_video.frame_rate_hz)
    one = p4d.Recording.from_frames(np.asarray(small_video.raw_frame(0))[None])
    dock.session.set_recording(one)
    assert rate.value == 1.0
