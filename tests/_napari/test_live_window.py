"""A recording is watched in the window while it is written: clicks, keys, and real files."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from driving import LEFT, frame_on_canvas
from numpy.typing import NDArray
from qtpy.QtCore import Qt, QTimer
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QLineEdit, QPushButton
from test_dock_reopened import close

import napari_phase4d as p4d
from napari_phase4d._napari.session import LiveView, StepState, step_states
from napari_phase4d._napari.session.live_plans import Newest
from napari_phase4d._napari.steps.live import WatchDialog
from napari_phase4d._napari.viewing import live as live_viewing
from napari_phase4d.pipeline import LiveStatus

pytestmark = pytest.mark.gui

N = 14
METHODS = ("temporal-angular", "directional-l1")


@pytest.fixture(scope="module")
def video() -> NDArray[np.uint8]:
    exact = p4d.simulation.swimming_euglena((128, 128), N, pixel_um=5.2 / 60 * 4, peak_rad=6)
    return p4d.simulation.multiplexed_video(exact["phase"]).holograms.values


@contextmanager
def camera(folder: Path, frames: Any, pause_s: float = 0.05) -> Iterator[None]:
    """Write frames in a thread, as a camera does: to the last one, or until it is left."""
    faults: list[Exception] = []
    over = threading.Event()

    def write() -> None:
        try:
            folder.mkdir(exist_ok=True)
            for number, frame in enumerate(frames):
                tifffile.imwrite(folder / f"frame_{number:04}.tif", frame)
                if over.wait(pause_s) and isinstance(frames, cycle):
                    return
        except Exception as error:
            faults.append(error)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    assert not faults, faults


def answer_by_keys(source: Path, out: Path | None = None) -> list[str]:
    """Fill in the dialog that opens next with the keyboard alone; return where results go."""
    told: list[str] = []

    def answer() -> None:
        dialog = QApplication.activeModalWidget()
        if not isinstance(dialog, WatchDialog):
            QTimer.singleShot(50, answer)
            return
        QTest.keyClicks(dialog.findChild(QLineEdit, "watch_source"), str(source))
        line = dialog.findChild(QLineEdit, "watch_out")
        if out is not None:
            QTest.keyClick(line, Qt.Key.Key_A, Qt.KeyboardModifier.ControlModifier)
            QTest.keyClicks(line, str(out))
        told.append(line.text())
        QTest.keyClick(line, Qt.Key.Key_Return)

    QTimer.singleShot(50, answer)
    return told


@pytest.fixture
def watching(dock: Any, qtbot: Any) -> Callable[..., Any]:
    """Press Watch…, answer, and return the part of the dock that says how far it is."""

    def watching(source: Path, out: Path | None = None, methods: Any = METHODS[:1]) -> Any:
        dock.session.update(n_views=2, methods=methods)
        dock.show_step(0)
        told = answer_by_keys(source, out)
        qtbot.mouseClick(dock.findChild(QPushButton, "watch"), LEFT)
        assert told
        qtbot.waitUntil(dock.recording.live.isVisible, timeout=60_000)
        return dock.recording.live

    return watching


def wait_for_end(dock: Any, qtbot: Any) -> None:
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert not dock.recording.live.isVisible()


def live_layers(viewer: Any) -> list[Any]:
    return [layer for layer in viewer.layers if layer.name.endswith(", live")]


@pytest.mark.thorough
def test_watched_to_the_end_it_is_what_a_run_gives(
    viewer, dock, qtbot, watching, video, tmp_path
) -> None:
    seen: list[LiveView] = []
    shapes: set[tuple[int, ...]] = set()

    def look(view: LiveView) -> None:
        seen.append(view)
        shapes.update(layer.data.shape for layer in live_layers(viewer))

    dock.session.live_changed.connect(look)
    folder = tmp_path / "cell"
    with camera(folder, video):
        live = watching(folder, methods=METHODS)
        qtbot.waitUntil(lambda: len(live_layers(viewer)) == 2, timeout=60_000)
        first, other = live_layers(viewer)
        assert (first.name, other.name) == ("wrapped phase, live", "T/A, live")
        assert first.axis_labels == ("time", "angle", "y", "x")
        assert list(map(str, first.units)) == ["second", "degree", "micrometer", "micrometer"]
        assert first.scale[-1] == pytest.approx(seen[-1].like["x"].diff("x").values[0])
        qtbot.waitUntil(lambda: seen[-1].index == N - 1, timeout=60_000)
        newest = seen[-1].shown["temporal-angular"]
        qtbot.waitUntil(lambda: np.array_equal(other.data[0], newest), timeout=60_000)
        assert f"{N} frames seen, {N} done" in live.line.text()
        qtbot.mouseClick(live.stop, LEFT)
        wait_for_end(dock, qtbot)
    assert shapes == {(1, 2, *seen[-1].like.shape[2:])}
    assert not live_layers(viewer)
    out = tmp_path / "cell_phase"
    again = p4d.run(p4d.Recipe.from_file(out / "recipe.json"))
    assert list(dock.session.results) == list(METHODS)
    for method in METHODS:
        kept = dock.session.results[method]
        np.testing.assert_array_equal(kept.values, again.comparison.results[method].values)
        assert viewer.layers[p4d.METHODS[method].label].data.shape == kept.shape
    phase = dock.session.reconstruction["phase"]
    np.testing.assert_array_equal(phase.values, again.reconstruction["phase"].values)
    # The dock goes on as after a run: all is there, and nothing is old.
    assert dock.session.recording.n_frames == N
    assert len(dock.session.lobes) == 2
    assert set(step_states(dock.session)) == {StepState.DONE}
    assert dock.sections[4].is_open
    # What was told last of the newest frame is its phase in the end.
    np.testing.assert_array_equal(
        seen[-1].shown["temporal-angular"], dock.session.results["temporal-angular"].values[-1]
    )


@pytest.mark.thorough
def test_stop_keeps_what_has_come(viewer, dock, qtbot, watching, video, tmp_path) -> None:
    with camera(tmp_path / "cell", video[:9]):
        live = watching(tmp_path / "cell", tmp_path / "kept")
        qtbot.waitUntil(lambda: len(live_layers(viewer)) == 2, timeout=60_000)
    live.stop.setFocus()
    QTest.keyClick(live.stop, Qt.Key.Key_Space)
    assert not live.stop.isEnabled()
    wait_for_end(dock, qtbot)
    assert dock.session.results["temporal-angular"].sizes["time"] == 9
    assert (tmp_path / "kept" / "recipe.json").is_file()
    # Another run does not take their place.
    with camera(tmp_path / "next", video[:9]):
        live = watching(tmp_path / "next", tmp_path / "kept")
        qtbot.waitUntil(lambda: len(live_layers(viewer)) == 2, timeout=60_000)
        qtbot.mouseClick(live.stop, LEFT)
        wait_for_end(dock, qtbot)
    assert (tmp_path / "kept" / "results_1" / "recipe.json").is_file()
    assert dock.session.recording.name == "next"


@pytest.mark.thorough
def test_cancel_writes_nothing_and_shows_what_was_there(
    viewer, ready, qtbot, watching, video, tmp_path
) -> None:
    mine = viewer.add_image(np.zeros((3, 3)), name="mine")
    before = [(layer, layer.visible) for layer in viewer.layers]
    recording, recipe = ready.session.recording, ready.session.recipe
    viewer.dims.set_current_step(0, 4)
    ready.session.update(lobes=())  # those of another recording would not fit
    with camera(tmp_path / "cell", cycle(video)):
        watching(tmp_path / "cell", tmp_path / "out")
        qtbot.waitUntil(
            lambda: [layer.visible for layer in live_layers(viewer)] == [True, True],
            timeout=60_000,
        )
        # They are seen wherever the slider of time is.
        assert viewer.dims.current_step[0] == 4
        assert all(np.ptp(la._data_view) > 0 for la in live_layers(viewer))
        qtbot.mouseClick(ready.cancel, LEFT)
        wait_for_end(ready, qtbot)
    assert "cancelled" in ready.status.text()
    assert [(layer, layer.visible) for layer in viewer.layers] == before
    assert mine.data.shape == (3, 3)
    assert not (tmp_path / "out").exists()
    assert ready.session.recording is recording
    assert ready.session.recipe.optics == recipe.optics


@pytest.mark.thorough
def test_a_folder_without_a_frame_is_said(viewer, dock, qtbot, watching, tmp_path) -> None:
    (tmp_path / "empty").mkdir()
    live = watching(tmp_path / "empty")
    assert live.line.text() == "Waiting for frames in empty …"
    qtbot.mouseClick(live.stop, LEFT)
    wait_for_end(dock, qtbot)
    assert "no frame came to" in dock.status.text()
    assert not live_layers(viewer)
    assert not (tmp_path / "empty_phase").exists()


@pytest.mark.thorough
def test_what_cannot_be_is_said_beside_the_button(dock, qtbot, watching, tmp_path) -> None:
    answer_by_keys(tmp_path / "cell")
    dock.session.update(methods=())
    qtbot.mouseClick(dock.recording.live.begin, LEFT)
    assert "no method is ticked" in dock.status.text()
    (tmp_path / "taken").write_text("mine")
    watching(tmp_path / "cell", tmp_path / "taken")
    wait_for_end(dock, qtbot)
    assert "taken" in dock.status.text()
    assert dock.status.property("wrong")
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.thorough
def test_closing_the_dock_in_the_midst_writes_nothing(
    viewer, dock, qtbot, watching, video, tmp_path
) -> None:
    session = dock.session
    with camera(tmp_path / "cell", cycle(video)):
        watching(tmp_path / "cell", tmp_path / "out")
        qtbot.waitUntil(lambda: len(live_layers(viewer)) == 2, timeout=60_000)
        shown = [layer.data for layer in live_layers(viewer)]
        close(viewer, dock, qtbot)
        _, again = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
        qtbot.wait(1500)
    assert session.outcome is None
    assert not (tmp_path / "out").exists()
    # The last picture stays; nothing comes late.
    for layer, data in zip(live_layers(viewer), shown, strict=True):
        assert layer.data is data
    assert not again.recording.live.isVisible()
    again.jobs.cancel()


@pytest.mark.thorough
def test_the_newest_frame_is_side_by_side_with_its_wrapped_phase(
    viewer, dock, qtbot, watching, video, tmp_path
) -> None:
    with camera(tmp_path / "cell", cycle(video), pause_s=0.2):
        live = watching(tmp_path / "cell")
        qtbot.waitUntil(
            lambda: [layer.colorbar.visible for layer in live_layers(viewer)].count(True) == 1,
            timeout=60_000,
        )
        assert viewer.canvas.grid.enabled
        _, other = live_layers(viewer)
        assert other.colorbar.visible  # and not the wrapped one, whose colours are always the same
        qtbot.waitUntil(lambda: not dock.presenter.turns.pending, timeout=60_000)
        # The one time of these layers is not that of the newest frame.
        assert not viewer.canvas.overlays.current_slice.visible
        assert frame_on_canvas(viewer) == ""
        before = other.data
        qtbot.waitUntil(lambda: other.data is not before, timeout=60_000)
        qtbot.waitUntil(lambda: " s after it came" in live.line.text(), timeout=60_000)
        qtbot.mouseClick(live.stop, LEFT)
        wait_for_end(dock, qtbot)
    assert not live_layers(viewer)


@pytest.mark.thorough
def test_a_layer_that_the_user_takes_away_is_not_missed(
    viewer, dock, qtbot, watching, video, tmp_path
) -> None:
    with camera(tmp_path / "cell", cycle(video)):
        live = watching(tmp_path / "cell")
        qtbot.waitUntil(
            lambda: [layer.colorbar.visible for layer in live_layers(viewer)].count(True) == 1,
            timeout=60_000,
        )
        wrapped, unwrapped = live_layers(viewer)
        viewer.layers.selection.active = unwrapped
        viewer.layers.remove_selected()
        before = wrapped.data
        qtbot.waitUntil(lambda: wrapped.data is not before, timeout=60_000)
        qtbot.mouseClick(live.stop, LEFT)
        wait_for_end(dock, qtbot)
    assert not live_layers(viewer)
    assert list(dock.session.results) == ["temporal-angular"]


@pytest.mark.thorough
def test_pictures_give_way_while_many_frames_wait(
    viewer, dock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_viewing, "SELDOM_S", 3600.0)
    layers = live_viewing.LiveLayers(dock.presenter)
    like = p4d.simulation.swimming_euglena((32, 32), 1)["phase"]

    def show(index: int, behind: int) -> float:
        values = np.full(like.shape[1:], index, np.float32)
        status = LiveStatus(seen=index + 1 + behind, done=index + 1)
        layers.show(LiveView(index=index, shown={"wrapped": values}, like=like, status=status))
        (layer,) = live_layers(viewer)
        return float(layer.data.max())

    show(0, behind=0)
    assert show(1, behind=0) == 1
    assert show(2, behind=100) == 1
    assert show(3, behind=2) == 3
    monkeypatch.setattr(live_viewing, "SELDOM_S", 0.0)
    assert show(4, behind=100) == 4


@pytest.mark.thorough
def test_a_script_watches_through_the_session(dock, video, tmp_path) -> None:
    dock.session.update(n_views=2, methods=("temporal-angular",))
    with camera(tmp_path / "cell", video, pause_s=0.0):
        table = dock.session.watch(tmp_path / "cell", tmp_path / "out", frames=N)
    assert list(table.index) == ["temporal-angular"]
    assert dock.session.results["temporal-angular"].sizes["time"] == N


@pytest.mark.thorough
def test_only_the_newest_frame_waits_and_the_others_are_counted() -> None:
    newest = Newest()
    for index in range(5):
        newest.put(index, {"wrapped": np.full((1, 2, 2), index, np.float32)})
    newest.status(LiveStatus(seen=5, done=5))
    view = newest.get_nowait()
    assert (view.index, view.not_shown) == (4, 4)
    assert view.sentence.endswith("; 4 not shown")
    newest.put(5, {"wrapped": np.zeros((1, 2, 2), np.float32)})
    view = newest.get_nowait()
    assert view.not_shown == 4
    # What is told once a second is not older than the newest frame.
    assert view.sentence.startswith("6 frames seen, 6 done")


@pytest.mark.thorough
def test_the_headline_says_whether_frames_come_and_how_late() -> None:
    view = LiveView()
    assert view.headline(10.0) == "The first frames are looked at"
    view = LiveView(index=11, done_s=10.0)
    assert view.headline(10.1) == "Live: frame 12"
    view = replace(view, status=LiveStatus(seen=12, done=12, delay_s=0.05))
    assert view.headline(10.1) == "Live: frame 12, shown 0.15 s after it came"
    assert view.headline(17.0) == "No new frame for 7 s"
