"""Faults that a reading of the window found, each as its reader made it happen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from napari_phase4d._napari.session import Plan, folder_without_results
from napari_phase4d._napari.viewing.pointing import FRAME_COLUMNS, note_frame
from napari_phase4d.io.tiff import has_colours
from napari_phase4d.recording import Recording

pytestmark = pytest.mark.gui


@pytest.mark.thorough
def test_results_are_not_saved_among_frames_or_over_what_is_not_ours(
    compared: Any, tmp_path: Path, small_video: Recording
) -> None:
    session, frames = compared.session, tmp_path / "frames"
    frames.mkdir()
    for number, frame in enumerate(small_video.holograms.values):
        tifffile.imwrite(frames / f"f{number:03}.tif", frame)
    session.set_recording(p4d.open_recording(frames))
    session.find_lobes()
    session.reconstruct()
    session.unwrap(["spatial-2d"])
    assert folder_without_results(frames, session.recipe.recording).parent == frames
    before = sorted(frames.iterdir())
    with pytest.raises(OSError, match="is the recording itself"):
        session.save(frames)
    assert sorted(frames.iterdir()) == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "table.csv").write_text("mine, precious")
    with pytest.raises(OSError, match="was not made by a run"):
        session.save(other)
    assert (other / "table.csv").read_text() == "mine, precious"
    session.save(tmp_path / "new")
    session.save(tmp_path / "new")  # over one's own


@pytest.mark.thorough
def test_a_part_that_can_not_be_shown_holds_nothing_up(dock: Any, qtbot: Any) -> None:
    from queue import SimpleQueue

    parts: SimpleQueue[str] = SimpleQueue()
    received = []

    def work(*_: Any) -> str:
        parts.put("one")
        return "all"

    def fails(part: str) -> None:
        raise OSError(part)

    dock.jobs.start(Plan("Trying", work, received.append, parts=parts, receive_part=fails))
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert received == ["all"]


@pytest.mark.thorough
def test_regions_in_a_layer_with_features_of_its_own(viewer: Any, compared: Any) -> None:
    layer = viewer.add_shapes(
        [np.array([[1, 1], [1, 9], [9, 9]])], shape_type="polygon", features={"name": ["nucleus"]}
    )
    note_frame(layer, (2, 1))
    compared.presenter.go_to(3, 0)
    layer.add_polygons([np.array([[2, 2], [2, 8], [8, 8]])])  # which the panel notes by itself
    assert layer.features["name"][0] == "nucleus"
    assert layer.features[list(FRAME_COLUMNS)].to_numpy().tolist() == [[2, 1], [3, 0]]


def test_the_error_of_a_job_stays_and_nothing_old_comes_back(dock: Any, qtbot: Any) -> None:
    def work(task: Any) -> None:
        task.progress(1, 2, "half of it")
        msg = "the disk is full"
        raise OSError(msg)

    dock.jobs.start(Plan("Trying", work, lambda _: None))
    qtbot.waitUntil(lambda: dock.status.property("wrong") is True, timeout=60_000)
    dock.session.update(background_order=4)
    assert dock.status.text() == "⚠ the disk is full"
    dock.recording.failed.emit("the number is too small")
    dock.session.update(background_order=3)
    assert "half of it" not in dock.status.text()
    assert not dock.status.property("wrong")


@pytest.mark.thorough
def test_frames_that_say_nothing_are_grey_in_the_strip(dock: Any) -> None:
    phase = p4d.simulation.swimming_euglena((60, 72), 6, pixel_um=0.5, peak_rad=9)["wrapped"]
    phase = phase.copy()
    phase[4] = np.nan
    dock.session.set_phase(phase)
    dock.session.unwrap(["spatial-2d", "temporal-angular", "directional-l1"])
    dock.session.weigh()
    strip = dock.compare.agreement
    assert np.isnan(strip._picture.scores[4]).all()
    assert not np.isnan(strip._picture.scores[[0, 1, 2, 3, 5]]).any()
    assert "says nothing" in strip._picture.words_on((4, 0))


@pytest.mark.thorough
def test_zero_stays_black_whatever_the_contrast(compared: Any) -> None:
    compared.presenter.side_by_side()
    layer = compared.presenter.results()[0]

    def colour_at(value: float) -> np.ndarray:
        low, high = layer.contrast_limits
        return layer.colormap.map(np.array([(value - low) / (high - low)]))[0, :3]

    layer.contrast_limits_range = (-20, 20)
    for limits in ((-3, 9), (-9, 9), (-1, 9), (-9, 1)):
        layer.contrast_limits = limits
        assert colour_at(0).max() < 0.06, limits
        assert colour_at(limits[0])[2] > colour_at(limits[0])[0]  # blue below zero
    layer.contrast_limits = (2, 9)
    assert colour_at(2).max() > 0.1  # 2 rad is not zero
    layer.colormap = "gray"
    layer.contrast_limits = (-3, 9)
    assert layer.colormap.name == "gray"


@pytest.mark.thorough
def test_the_picture_stays_where_another_layer_is_shown(viewer: Any, dock: Any) -> None:
    viewer.add_image(np.zeros((2000, 2000)), name="fluorescence")
    made = p4d.simulation.swimming_euglena((60, 72), 4, pixel_um=0.5, peak_rad=9)
    dock.session.set_phase(made["wrapped"])
    dock.session.unwrap(["spatial-2d", "temporal-angular"])
    low, high = viewer.layers.get_extent([la for la in viewer.layers if la.visible]).world
    centre = np.array(viewer.scene.camera.center)[-2:]
    assert (low[-2:] <= centre).all()
    assert np.allclose(centre, (low + high)[-2:] / 2, atol=2)


@pytest.mark.thorough
def test_settings_read_no_frame_again(dock: Any, small_video: Recording) -> None:
    dock.session.set_recording(small_video)
    dock.session.find_lobes()
    import napari_phase4d._napari.steps.step as looked

    calls = []
    original = looked.first_seen

    def counted(recording: Recording) -> Any:
        calls.append(recording)
        return original(recording)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(looked, "first_seen", counted)
        dock.session.update(background_order=4)
        dock.session.set_lobes(dock.session.lobes[::-1])
    assert calls == []


@pytest.mark.thorough
def test_results_of_a_run_that_failed_go(ready: Any, viewer: Any, qtbot: Any) -> None:
    ready.session.update(methods=("spatial-2d", "temporal-angular"))
    names = [layer.name for layer in viewer.layers]
    result = ready.session.reconstruction["phase"]
    ready.presenter.show_finished("spatial-2d", "2-D", result)
    assert len(viewer.layers) > len(names)
    ready.jobs.failed.emit("the disk is full")
    assert [layer.name for layer in viewer.layers] == names


@pytest.mark.thorough
def test_the_view_is_marked_when_the_panel_opens_again(viewer: Any, compared: Any) -> None:
    compared.presenter.side_by_side()
    compared.compare.views["results"].setChecked(False)
    _, again = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    assert again is compared or again.compare.views["results"].isChecked()


def test_grey_ramps_are_no_colours(tmp_path: Path) -> None:
    ramp = np.tile((np.arange(256) * 257).astype(np.uint16), (3, 1))
    colours = ramp.copy()
    colours[1] = colours[1, ::-1]
    for palette, expected in ((ramp, False), (colours, True)):
        path = tmp_path / f"{expected}.tif"
        frame = np.arange(64 * 64, dtype=np.uint8).reshape(64, 64)
        tifffile.imwrite(path, frame, photometric="palette", colormap=palette)
        with tifffile.TiffFile(path) as tif:
            assert has_colours(tif.pages[0]) is expected
