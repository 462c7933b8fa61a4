"""What the finder can't know is said in step 2, and lost frames in step 1."""

from __future__ import annotations

import numpy as np
import pytest
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

CARRIERS = ((0.19, 0.21), (-0.21, 0.19))

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def ambiguous() -> Recording:
    """All beams are equally strong and nearly plane: any of them might be the reference."""
    exact = swimming_euglena((256, 256), 3, pixel_um=5.2 / 30, peak_rad=0.15)
    video = multiplexed_video(exact["phase"], carriers=CARRIERS, reference_amplitude=1.0)
    frames = video.holograms.values.copy()
    frames[1] = 0
    return Recording.from_frames(frames, name="ambiguous")


@pytest.mark.thorough
def test_doubt_is_said_and_the_other_choice_is_one_click_away(dock, click, ambiguous) -> None:
    dock.session.set_recording(ambiguous)
    click("find_lobes")
    step, found = dock.lobes, dock.session.found
    assert found.doubts_of_views
    assert "Views and their beats look alike here" in step.warnings.text()
    first = [lobe.carrier for lobe in dock.session.lobes]
    click("other_lobes")
    second = [lobe.carrier for lobe in dock.session.lobes]
    assert second == [lobe.carrier for lobe in found.other] != first
    assert "This is the other choice" in step.warnings.text()
    click("other_lobes")
    assert [lobe.carrier for lobe in dock.session.lobes] == first
    assert "This is the other choice" not in step.warnings.text()
    dock.session.set_lobes(dock.session.lobes[:1])  # changed by hand: no longer what was found
    QApplication.processEvents()
    assert not step.other.isVisible()
    assert "look alike" not in step.warnings.text()


@pytest.mark.thorough
def test_lost_frames_are_listed_in_step_1(dock, click, ambiguous) -> None:
    dock.session.set_recording(ambiguous)
    click("find_lobes")
    assert "1 frame of 3 is lost and left out: 1 (blank)." in dock.recording.facts.text()
    click("reconstruct")
    assert dock.session.reconstruction.attrs["lost_times"] == [1]
    assert "1 frame of 3 left out as lost, first at time 1." in dock.phase.facts.text()
    click("find_lobes")


@pytest.mark.thorough
def test_a_recording_that_begins_with_a_lost_frame_opens(dock, click, ambiguous) -> None:
    frames = ambiguous.holograms.values[[1, 0, 2]].astype(np.float32)
    frames[0] = np.nan
    dock.session.set_recording(p4d.open_recording(frames))
    click("find_lobes")
    assert "1 frame of 3 is lost and left out: 0 (NaN)." in dock.recording.facts.text()
