"""Step 3 of the dock: what is removed, refocusing, and how noisy the phase is."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d.analysis import noise_sentence
from napari_phase4d.holography import propagate
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import swimming_euglena

pytestmark = pytest.mark.gui
#: Depth of focus of what is recorded here: a lobe of 0.1 cycles per pixel of 0.173 um.
DEPTH_UM = 1.333 * 0.6328 / (0.6328 * 0.1 / 0.173) ** 2


def wait_until(condition: Any, seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not condition():
        QApplication.processEvents()
        time.sleep(0.005)
        assert time.monotonic() < end


def type_into(box: Any, text: str) -> None:
    box.selectAll()
    QTest.keyClicks(box, text)
    QTest.keyClick(box, Qt.Key.Key_Return)


@pytest.fixture(scope="module")
def defocused() -> Recording:
    """A cell recorded 24 um behind its focus: one view, 4 frames, camera noise."""
    optics = Optics(magnification=30)
    exact = swimming_euglena((192, 192), 4, pixel_um=optics.pixel_um, peak_rad=3)["phase"][:, :1]
    carrier, y, x = (0.21, 0.19), *np.indices((192, 192))
    tilt = np.exp(2j * np.pi * (carrier[0] * y + carrier[1] * x))
    rng = np.random.default_rng(0)
    frames = []
    for phase in exact.values[:, 0]:
        field = propagate(np.exp(1j * phase), 24.0, 0.6328, optics.pixel_um, 1.333)
        light = np.abs(1.5 + field * tilt) ** 2 * 40
        frames.append(np.round(light + rng.normal(0, 0.7, light.shape)).clip(0, 255))
    return p4d.open_recording(np.array(frames, np.uint8), optics, frame_rate_hz=6)


def test_background_and_its_order_follow_the_recipe(dock) -> None:
    dock.show_step(2)
    part, session = dock.phase, dock.session
    assert not part.order.native.isVisible()
    part.background.value = "zernike"
    assert session.recipe.background == "zernike"
    assert part.order.native.isVisible()
    type_into(part.order.native, "6")
    assert session.recipe.background_order == 6
    session.update(background="polynomial", background_order=3)
    assert part.background.value == "polynomial"
    assert part.order.value == 3
    session.update(background="tilt")
    assert not part.order.native.isVisible()


def test_refocus_follows_the_recipe_and_back(dock) -> None:
    dock.show_step(2)
    part, session = dock.phase, dock.session
    assert session.recipe.refocus_um is None
    type_into(part.refocus.native, "-12.5")
    assert session.recipe.refocus_um == -12.5
    type_into(part.refocus.native, "0")
    assert session.recipe.refocus_um is None
    session.update(refocus_um=3.14159)
    assert part.refocus.value == pytest.approx(3.14)
    part.drift.value = False  # another field leaves the digits that are not shown
    assert session.recipe.refocus_um == 3.14159
    session.update(refocus_um="auto")
    assert part.refocus.native.text() == "to the focus"
    part.drift.value = True
    assert session.recipe.refocus_um == "auto"


@pytest.mark.thorough
def test_focus_is_found_by_a_click(dock, click, defocused, qtbot) -> None:
    click("find_focus")
    assert "there is no recording yet" in dock.status.text()
    dock.session.set_recording(defocused)
    dock.session.find_lobes(1)
    said: list[str] = []
    dock.phase.said.connect(said.append)
    click("find_focus")
    assert dock.session.recipe.refocus_um == pytest.approx(-24, abs=DEPTH_UM / 2)
    assert dock.phase.refocus.value == dock.session.recipe.refocus_um
    assert said == [f"Focus found at {dock.session.recipe.refocus_um:.2f} µm, for a phase object."]
    click("reconstruct")
    assert "refocused by -" in dock.phase.facts.text()
    expected = p4d.reconstruct(
        defocused, dock.session.lobes, refocus_um=dock.session.recipe.refocus_um
    )
    np.testing.assert_array_equal(
        dock.session.reconstruction["phase"].values, expected["phase"].values
    )


@pytest.mark.thorough
def test_auto_of_a_recipe_becomes_a_number(dock, defocused) -> None:
    dock.session.set_recording(defocused)
    dock.session.find_lobes(1)
    dock.session.reconstruct(refocus_um="auto")
    found = dock.session.recipe.refocus_um
    assert found == pytest.approx(-24, abs=DEPTH_UM / 2)
    assert dock.session.phase_recipe.refocus_um == found
    assert dock.phase.refocus.native.text() == f"{found:.2f} µm"


@pytest.mark.thorough
def test_refocused_phase_is_stale_with_another_microscope(dock, defocused) -> None:
    """Plain phase is only scaled; refocused phase would come out different."""
    from napari_phase4d._napari.session import StepState, step_states

    session = dock.session
    session.set_recording(defocused)
    session.find_lobes(1)
    for distance, expected in ((None, StepState.DONE), (-24.0, StepState.STALE)):
        session.reconstruct(refocus_um=distance)
        assert step_states(session)[2] is StepState.DONE
        session.recalibrate(defocused.calibrated(Optics(magnification=40)))
        assert step_states(session)[2] is expected
        session.recalibrate(defocused)
    session.update(background_order=5)  # does nothing while a tilt is removed
    assert step_states(session)[2] is StepState.DONE
    session.update(refocus_um=-8.0)
    assert step_states(session)[2] is StepState.STALE


@pytest.mark.thorough
def test_noise_is_shown_after_reconstruct(ready) -> None:
    ready.show_step(2)
    wait_until(lambda: ready.session.noise is not None)
    assert noise_sentence(ready.session.noise) in ready.phase.facts.text()
    assert "Fringe visibility 0.7" in ready.phase.facts.text()
    before = ready.session.noise["temporal_path_nm"].iloc[0]
    recording = ready.session.recording
    green = replace(recording.optics, wavelength_um=0.3164)
    ready.session.recalibrate(recording.calibrated(green))
    assert ready.session.noise["temporal_path_nm"].iloc[0] == pytest.approx(before / 2)
    assert noise_sentence(ready.session.noise) in ready.phase.facts.text()
    ready.session.reconstruct(background="curvature")
    assert ready.session.noise is None or "Noise" in ready.phase.facts.text()


@pytest.mark.thorough
def test_step_fits_a_small_screen_without_scrolling(viewer, ready) -> None:
    ready.show_step(2)
    ready.session.update(background="zernike", refocus_um=-12.34)
    ready.session.reconstruct()
    wait_until(lambda: ready.session.noise is not None)
    QApplication.processEvents()
    assert viewer.window.geometry()[2:] == (1280, 720)
    assert ready.scroll.verticalScrollBar().maximum() == 0
    assert ready.scroll.horizontalScrollBar().maximum() == 0
    for widget in (ready.phase.find_focus, ready.phase.order.native, ready.phase.facts):
        right = widget.mapTo(ready.scroll.viewport(), QPoint(widget.width(), 0)).x()
        assert right <= ready.scroll.viewport().width()


def test_preview_in_step_2_is_refocused(dock, defocused, click) -> None:
    dock.session.set_recording(defocused)
    dock.session.find_lobes(1)
    dock.show_step(1)
    shown: list[list[np.ndarray]] = []
    dock.lobes.strip.set_views = lambda phases, captions: shown.append(list(phases))
    for distance in (None, -24.0):
        dock.session.update(refocus_um=distance)
        dock.lobes.frame_changed()
        count = len(shown)
        wait_until(lambda count=count: len(shown) > count)
    assert np.abs(np.angle(np.exp(1j * (shown[-1][0] - shown[0][0])))).max() > 0.3


@pytest.mark.thorough
def test_views_of_a_few_pixels_are_said(ready, click) -> None:
    assert "are resolved" not in ready.phase.facts.text()
    lobes = [replace(lobe, radius=0.02) for lobe in ready.session.lobes]
    ready.session.set_lobes(lobes)
    click("reconstruct")
    n_y, n_x = ready.session.reconstruction["phase"].shape[2:]
    assert n_x < 12
    assert f"Only {n_x} × {n_y} pixels are resolved" in ready.phase.facts.text()
    assert ready.sections[2].badge.text() == "⚠ look"


@pytest.mark.thorough
def test_a_refocus_that_the_field_cannot_hold_is_said(ready, click) -> None:
    click("reconstruct")
    badge = ready.sections[2].badge
    assert badge.text() == "✓ done"
    type_into(ready.phase.refocus.native, "100000")  # a tenth of a metre
    click("reconstruct")
    assert badge.text() == "⚠ look"
    assert "beyond the edges of the field" in badge.toolTip()
    assert "stay within" in ready.phase.facts.text()
    type_into(ready.phase.refocus.native, "5")
    click("reconstruct")
    assert badge.text() == "✓ done"
    assert "beyond the edges" not in ready.phase.facts.text()
