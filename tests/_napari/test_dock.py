"""The window: by clicks from a recording to results, and what it says when something is wrong."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtGui import QWheelEvent
from qtpy.QtWidgets import QApplication, QWidget

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d._napari.beginning import binding_advice
from napari_phase4d._napari.viewing.layers import METADATA_KEY
from napari_phase4d.io import read_results
from napari_phase4d.stacks import AXES

pytestmark = pytest.mark.gui
RESULTS = ["2-D", "Angular", "Temporal", "T/A", "A/T", "WL1"]


def assert_calibrated(viewer: Any) -> None:
    for layer in viewer.layers:
        assert layer.axis_labels == AXES, layer.name
        units = tuple(str(u) for u in layer.units)
        assert units == ("second", "degree", "micrometer", "micrometer"), layer.name
        assert layer.ndim == 4
    assert tuple(viewer.dims.axis_labels) == AXES


@pytest.mark.thorough
def test_from_the_sample_to_results_by_clicks(viewer, dock, click, tmp_path: Path) -> None:
    """The story of a newcomer: sample, lobes, phase, thin frame, run, grid, save."""
    click("try_sample")
    assert dock.session.recording.n_frames == 40
    click("find_lobes")
    assert [lobe.angle_deg for lobe in dock.session.lobes] == [-7, 21]
    assert dock.lobes.table.rowCount() == 2
    click("reconstruct")
    assert viewer.layers[-1].name.startswith("wrapped phase")
    click("use_view")
    assert dock.session.recipe.boundary == ((0, 0),)
    click("run")
    assert dock.session.recipe.boundary == ((0, 0),)
    shown = [layer.name for layer in viewer.layers if layer.visible]
    assert shown == ["exact", *RESULTS]
    assert viewer.canvas.grid.enabled
    assert_calibrated(viewer)
    for layer in viewer.layers:
        if layer.visible:
            assert layer.data.shape[:2] == (40, 2)
            assert layer.contrast_limits == viewer.layers["T/A"].contrast_limits
    np.testing.assert_allclose(viewer.layers["T/A"].scale[:2], [1 / 6, 28])
    np.testing.assert_allclose(viewer.layers["T/A"].translate[:2], [0, -7])
    # The window shows what a script computes.
    data = p4d.reconstruct(dock.session.recording, dock.session.lobes)
    expected = p4d.unwrap(data["phase"], "temporal-angular", mask="auto")
    np.testing.assert_array_equal(viewer.layers["T/A"].data, expected.values)
    assert dock.compare.figures.table.rowCount() == 6
    click("leave_grid")
    assert not viewer.canvas.grid.enabled
    dock.compare.share.save_to(tmp_path / "out")
    wait_for(dock)
    np.testing.assert_array_equal(
        read_results(tmp_path / "out" / "temporal-angular.ome.tif").values, expected.values
    )
    assert p4d.Recipe.from_file(tmp_path / "out" / "recipe.json").lobes


def wait_for(dock: Any, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while dock.jobs.running:
        QApplication.processEvents()
        time.sleep(0.005)
        assert time.monotonic() < end


@pytest.mark.thorough
@pytest.mark.measured
def test_measured_multiplexed_video_by_clicks(viewer, dock, click) -> None:
    """A measured two-channel time lapse: each view's phase track is that of its own channel."""
    path = measured("multiplexed/mux2_timelapse_t00-29.npz")
    dock.recording.open_path(path)
    wait_for(dock)
    click("find_lobes")
    click("drift")  # the phase of the whole field is what is measured here: keep it
    assert dock.phase.drift.value is False
    click("reconstruct")
    click("mask")  # nothing but a moving field in view: unwrap all of it
    assert dock.unwrap.mask.value is False
    click("run")
    assert_calibrated(viewer)
    lobes = dock.session.lobes
    inside = (slice(1, -1), slice(1, -1))
    with np.load(path) as file:
        channels = [file["chA"], file["chB"]]
    for view, channel in enumerate(channels):
        alone = p4d.reconstruct(p4d.open_recording(channel), [lobes[view]], drift=False)
        expected = np.angle(np.exp(1j * alone["phase"].values[:, 0, *inside]).mean((1, 2)))
        for method in RESULTS:
            phase = viewer.layers[method].data[:, view, *inside]
            track = np.angle(np.exp(1j * phase).mean((1, 2)))
            error = wrap(track - expected)
            assert np.abs(error - error.mean()).max() <= 0.01, method
        smooth = viewer.layers["T/A"].data[:, view, *inside].mean((1, 2))
        assert np.abs(np.diff(smooth)).max() < np.pi


def test_missing_steps_are_said_in_the_dock(dock, click) -> None:
    for button, sentence in (
        ("find_lobes", "there is no recording yet; open one in step 1"),
        ("reconstruct", "there is no recording yet"),
        ("run", "there is no phase yet; press Reconstruct in step 3"),
        ("use_view", "there is no phase yet"),
        ("side_by_side", "there are no results to show yet"),
        ("save_results", "there are no results yet; press Run in step 4"),
        ("remove_lobe", "there is no lobe to remove"),
    ):
        click(button)
        assert sentence in dock.status.text()
        assert dock.status.property("wrong")


def test_unreadable_file_is_said_in_the_dock(dock, tmp_path: Path) -> None:
    (tmp_path / "bad.tif").write_bytes(b"no TIFF at all")
    dock.recording.open_path(tmp_path / "bad.tif")
    wait_for(dock)
    assert "bad.tif can't be read as a TIFF file" in dock.status.text()
    frames = np.full((2, 32, 32), np.nan, np.float32)
    tifffile.imwrite(tmp_path / "nan.tif", frames)
    dock.recording.open_path(tmp_path / "nan.tif")
    wait_for(dock)
    assert "NaN or infinite pixels" in dock.status.text()
    assert dock.session.recording is None


def test_nothing_ticked_is_said(ready, click) -> None:
    for row in ready.unwrap.methods.values():
        row.tick.setChecked(False)
    click("run")
    assert "no method is ticked" in ready.status.text()


@pytest.mark.thorough
def test_second_run_makes_new_layers(viewer, ready, click, tick_only) -> None:
    tick_only("spatial-2d", "temporal-angular")
    click("run")
    first = {layer.name: layer.data.copy() for layer in viewer.layers}
    count = len(viewer.layers)
    ready.session.update(boundary=((3, 0),))
    click("run")
    assert len(viewer.layers) == count + 2
    for name, data in first.items():
        np.testing.assert_array_equal(viewer.layers[name].data, data)
    assert sum(layer.visible for layer in viewer.layers) == 2
    newest = viewer.layers[-1].metadata[METADATA_KEY]
    assert newest["boundary"] == [[3, 0]]


@pytest.mark.thorough
def test_users_layers_stay_as_they_are(viewer, dock, click, small_video, tick_only) -> None:
    tick_only("spatial-2d", "temporal-angular")
    frames = small_video.holograms.values.copy()
    mine = viewer.add_image(frames, name="mine")
    other = viewer.add_image(np.zeros((2, 2)), name="other")
    dock.recording.layer.value = mine
    assert dock.session.recording.name == "mine"
    click("find_lobes")
    click("reconstruct")
    click("run")
    assert other.visible
    assert mine in viewer.layers
    assert mine.data is frames
    assert mine.ndim == 3
    np.testing.assert_array_equal(mine.scale, [1, 1, 1])
    np.testing.assert_array_equal(frames, small_video.holograms.values)
    # Its axes don't fit those of the results; the dock says so and helps.
    assert "sliders don't fit together" in dock.recording.facts.text()
    viewer.layers.remove(other)
    click("remove_raw")
    assert mine not in viewer.layers
    assert tuple(viewer.dims.nsteps[:2]) == (6, 2)
    assert_calibrated(viewer)
    assert "sliders" not in dock.recording.facts.text()


def test_angles_and_results_do_not_pass_to_the_next_recording(dock, small_video) -> None:
    dock.session.set_recording(small_video, angles_deg=(-7, 21))
    dock.session.find_lobes()
    assert [lobe.angle_deg for lobe in dock.session.lobes] == [-7, 21]
    dock.session.set_recording(small_video.calibrated())
    assert dock.session.lobes == []
    dock.session.find_lobes()
    assert [lobe.angle_deg for lobe in dock.session.lobes] == [0, 1]


@pytest.mark.thorough
def test_a_recording_is_on_screen_where_layers_of_another_begin_elsewhere(
    viewer, ready, small_video
) -> None:
    lobes = ready.session.lobes
    ready.session.set_lobes([replace(lobes[0], angle_deg=-7), replace(lobes[1], angle_deg=21)])
    ready.session.reconstruct()
    ready.presenter.go_to(4, 0)
    ready.session.set_recording(small_video.calibrated())
    layer = viewer.layers[-1]
    assert layer.visible
    assert layer.metadata[METADATA_KEY]["kind"] == "holograms"
    np.testing.assert_array_equal(np.asarray(layer._slice.image.raw), small_video.frame(0))


@pytest.mark.thorough
def test_wheel_does_not_change_a_field_that_is_not_in_use(ready) -> None:
    box = ready.recording.numbers["magnification"].native
    ready.show_step(0)
    box.clearFocus()
    centre = QPointF(box.rect().center())
    event = QWheelEvent(
        centre, QPointF(box.mapToGlobal(centre.toPoint())), QPoint(0, 0), QPoint(0, -120),
        Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase,
        False,
    )  # fmt: skip
    QApplication.sendEvent(box, event)
    assert ready.recording.numbers["magnification"].value == 60


@pytest.mark.thorough
def test_thin_frame_stays_with_its_view(ready, click) -> None:
    """The thin frame is kept when the phase is made anew, also if the views change places."""
    ready.session.update(boundary=((4, 1),))
    click("reconstruct")
    assert ready.session.recipe.boundary == ((4, 1),)
    ready.lobes.table.item(0, 3).setText("50")  # the first view becomes the second
    click("reconstruct")
    assert ready.session.recipe.boundary == ((4, 0),)


@pytest.mark.thorough
def test_reference_of_the_last_recording_is_forgotten(ready, small_video) -> None:
    ready.phase.reference.value = "median over time"
    assert ready.session.recipe.reference == "median"
    ready.session.set_recording(small_video.calibrated())
    assert ready.phase.reference.value == "none"
    assert ready.session.recipe.reference is None


def test_reference_file_is_used(ready, click, tmp_path, small_video) -> None:
    np.save(tmp_path / "empty.npy", small_video.holograms.values[0])
    ready.phase.reference.value = "hologram in a file"
    click("reconstruct")
    assert "choose the file with the reference hologram first" in ready.status.text()
    ready.phase.take_reference(tmp_path / "empty.npy")
    click("reconstruct")
    first = ready.session.reconstruction["phase"].values[0]
    assert np.abs(wrap(first)).max() < 0.01  # the first frame divided by itself


def test_current_view_is_read_in_world_coordinates(viewer, ready) -> None:
    for frame in ((0, 0), (3, 1), (5, 0)):
        ready.presenter.go_to(*frame)
        assert ready.presenter.current_frame() == frame
        layer = viewer.layers[-1]
        shown = layer.data[frame]
        np.testing.assert_array_equal(np.asarray(layer._slice.image.raw), shown)


@pytest.mark.thorough
def test_microscope_changes_the_scale_of_what_follows(viewer, ready) -> None:
    before = {layer.name: np.asarray(layer.scale[2:]) for layer in viewer.layers}
    ready.recording.numbers["magnification"].value = 30.0
    assert ready.session.recipe.optics.magnification == 30
    after = {layer.name: np.asarray(layer.scale[2:]) for layer in viewer.layers}
    for name, scale in before.items():
        np.testing.assert_allclose(after[name], 2 * scale)
    ready.recording.numbers["frame_rate_hz"].value = 12.0
    assert [layer.scale[0] for layer in viewer.layers] == pytest.approx([1 / 12] * 3)
    assert tuple(viewer.dims.nsteps[:2]) == (6, 2)
    step = 2 * 5.2 / 60 * ready.session.reconstruction.attrs["pixel_ratio"][1]
    assert np.diff(ready.session.reconstruction["x"]) == pytest.approx(step)
    pixel = ready.session.recording.optics.pixel_um
    assert f"pixel in the sample {pixel:.4g} µm" in ready.recording.facts.text()
    # The layer, chosen again, still has the microscope that was typed.
    ready.recording.layer.value = None
    ready.recording.layer.value = ready.presenter.holograms
    assert ready.session.recording.optics.magnification == 30


def test_dock_fits_a_small_screen(viewer, dock) -> None:
    QApplication.processEvents()
    window = dock.window()
    assert window.width() <= 1280
    assert window.height() <= 720
    for number in range(5):
        dock.show_step(number)
        QApplication.processEvents()
        assert window.height() <= 720
        assert dock.scroll.widget().width() <= dock.scroll.viewport().width()
        position = dock.sections[number].heading.mapTo(dock.scroll.viewport(), QPoint(0, 0))
        assert 0 <= position.y() < dock.scroll.viewport().height()


@pytest.mark.thorough
def test_a_step_that_is_opened_by_hand_comes_into_view(viewer, ready, qtbot) -> None:
    ready.show_step(1)
    QApplication.processEvents()
    qtbot.mouseClick(ready.sections[2].heading, Qt.MouseButton.LeftButton)
    button, port = ready.phase.findChild(QWidget, "reconstruct"), ready.scroll.viewport()
    qtbot.waitUntil(lambda: port.rect().contains(button.mapTo(port, button.rect().center())))
    assert ready.sections[1].is_open


def test_every_field_says_what_it_is(dock) -> None:
    from qtpy.QtWidgets import QAbstractButton, QAbstractSpinBox, QComboBox

    for kind in (QAbstractSpinBox, QComboBox, QAbstractButton):
        for widget in dock.scroll.widget().findChildren(kind):
            if widget.objectName() and not widget.objectName().startswith(
                ("heading", "qt_", "ScrollLeft", "ScrollRight")
            ):
                assert widget.toolTip(), widget.objectName()


def test_a_binding_that_ends_the_program_is_told() -> None:
    assert "pip install 'PySide6<6.12'" in binding_advice((3, 11, 7), "6.12.0")
    for python, pyside in (((3, 12, 0), "6.12.0"), ((3, 11, 7), "6.11.3"), ((3, 11, 7), None)):
        assert not binding_advice(python, pyside)
