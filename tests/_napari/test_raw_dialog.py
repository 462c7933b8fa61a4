"""Opening what needs to be asked about, and videos with fewer views than asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from qtpy.QtCore import Qt, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QDialogButtonBox, QSpinBox

import napari_phase4d as p4d
from napari_phase4d._napari.steps.recording import RawDialog

pytestmark = pytest.mark.gui


def answer(height: int, width: int, header: int, button: str) -> list[str]:
    """Type numbers into the dialog that opens next, and press a button; return what it said."""
    said: list[str] = []

    def fill() -> None:
        dialog = QApplication.activeModalWidget()
        if not isinstance(dialog, RawDialog):
            QTimer.singleShot(50, fill)
            return
        for name, number in (("raw_height", height), ("raw_width", width), ("raw_header", header)):
            dialog.findChild(QSpinBox, name).setValue(number)
        said.append(dialog.verdict.text())
        kind = getattr(QDialogButtonBox.StandardButton, button)
        QTest.mouseClick(dialog.buttons.button(kind), Qt.MouseButton.LeftButton)

    QTimer.singleShot(50, fill)
    return said


@pytest.mark.thorough
def test_a_raw_file_is_asked_about(dock, qtbot, small_video, tmp_path: Path) -> None:
    frames = small_video.holograms.values.astype("<u2")
    path = tmp_path / "camera.raw"
    path.write_bytes(b"header12" + frames.tobytes())
    step = dock.steps[0]
    said = answer(128, 128, 8, "Cancel")
    step.open_path(path)
    assert said == ["makes 6 frames; 0 bytes are left over"]
    assert dock.session.recording is None
    answer(128, 128, 8, "Open")
    step.open_path(path)
    qtbot.waitUntil(lambda: dock.session.recording is not None, timeout=60_000)
    qtbot.waitUntil(lambda: not dock.jobs.busy, timeout=60_000)
    np.testing.assert_array_equal(dock.session.recording.holograms.values, frames)
    # What was typed in goes into the recipe, so that others open the file alike.
    assert dock.session.recipe.raw == p4d.RawLayout(128, 128, header_bytes=8)
    assert "p4d.RawLayout(" in p4d_script(dock.session.recipe)


def p4d_script(recipe: p4d.Recipe) -> str:
    from napari_phase4d.scripting import as_python

    return as_python(recipe)


@pytest.mark.thorough
def test_a_plain_video_has_one_view(dock, click) -> None:
    exact = p4d.simulation.swimming_euglena((128, 128), 6, pixel_um=0.35, peak_rad=6)
    plain = p4d.simulation.multiplexed_video(exact["phase"][:, :1], carriers=[(0.19, 0.21)])
    dock.session.set_recording(plain)
    assert dock.session.recipe.n_views is None  # they are counted
    click("find_lobes")
    assert len(dock.session.lobes) == 1
    click("reconstruct")
    assert dock.session.reconstruction["phase"].shape[1] == 1


@pytest.mark.thorough
def test_another_recording_is_not_refocused_like_the_last(dock, small_video) -> None:
    dock.session.set_recording(small_video)
    dock.session.update(refocus_um=12.5)
    dock.session.set_recording(small_video)
    assert dock.session.recipe.refocus_um is None
    assert dock.session.focus is None
