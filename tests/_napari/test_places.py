"""Where else napari shows the plugin: menus, samples, readers, writers, preferences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from napari.settings import get_plugin_settings
from qtpy.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from qtpy.QtGui import QDropEvent

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.layers import METADATA_KEY
from napari_phase4d.io import read_results
from napari_phase4d.sample import yeast_sample

pytestmark = pytest.mark.gui


def menu_titles(viewer: Any, *path: str) -> list[str]:
    """Return the entries of a menu of the window, such as Layers > Measure."""
    menu = viewer.window._qt_window.menuBar()
    for name in path:
        actions = [a for a in menu.actions() if a.text().replace("&", "") == name]
        menu = actions[0].menu()
        menu.aboutToShow.emit()
    return [action.text() for action in menu.actions()]


def test_menus_hold_the_one_shot_commands(viewer) -> None:
    transforms = menu_titles(viewer, "Layers", "Transform")
    measures = menu_titles(viewer, "Layers", "Measure")
    for title in ("Wrapped phase of off-axis holograms", "Unwrap phase, T/A", "Unwrap phase, WL1"):
        assert f"{title} (Phase 4D)" in transforms
    for title in ("Optical path difference of phase", "Dry mass of phase"):
        assert f"{title} (Phase 4D)" in measures


def run_entry(viewer: Any, qtbot: Any, submenu: str, title: str) -> Any:
    """Choose an entry of Layers and return the layer that it adds."""
    menu_titles(viewer, "Layers", submenu)
    bar = viewer.window._qt_window.menuBar()
    layers = next(a for a in bar.actions() if a.text().replace("&", "") == "Layers").menu()
    menu = next(a for a in layers.actions() if a.text().replace("&", "") == submenu).menu()
    count = len(viewer.layers)
    next(a for a in menu.actions() if a.text().startswith(title)).trigger()
    qtbot.waitUntil(lambda: len(viewer.layers) > count, timeout=60_000)
    return viewer.layers[-1]


@pytest.mark.thorough
def test_one_shot_from_holograms_to_dry_mass(viewer, qtbot, small_video, tmp_path) -> None:
    path = tmp_path / "video.npy"
    np.save(path, small_video.holograms.values)
    viewer.open(path, plugin="napari-phase4d")
    viewer.layers.selection.active = viewer.layers[0]
    wrapped = run_entry(viewer, qtbot, "Transform", "Wrapped phase")
    rec = p4d.open_recording(path)
    phase = p4d.reconstruct(rec, p4d.find_lobes(rec, 2))["phase"]
    np.testing.assert_array_equal(wrapped.data, phase.values)
    np.testing.assert_allclose(wrapped.scale[2:], np.diff(phase["y"])[0])
    np.testing.assert_allclose(wrapped.translate[2:], float(phase["y"][0]))
    viewer.layers.selection.active = wrapped
    result = run_entry(viewer, qtbot, "Transform", "Unwrap phase, T/A")
    expected = p4d.unwrap(phase, "temporal-angular").values
    np.testing.assert_array_equal(result.data, expected)
    viewer.layers.selection.active = result
    path_nm = run_entry(viewer, qtbot, "Measure", "Optical path")
    np.testing.assert_allclose(path_nm.data, expected * 632.8 / (2 * np.pi), rtol=1e-5, atol=1e-3)
    viewer.layers.selection.active = result
    mass = run_entry(viewer, qtbot, "Measure", "Dry mass")
    np.testing.assert_allclose(
        mass.data, expected * 0.6328 / (2 * np.pi) / 0.18, rtol=1e-5, atol=1e-5
    )
    assert all(layer.axis_labels == wrapped.axis_labels for layer in viewer.layers)


def test_one_shot_without_the_right_layer_says_so(viewer, qtbot) -> None:
    from napari.utils.notifications import notification_manager

    viewer.add_image(np.zeros((8, 8)))
    menu_titles(viewer, "Layers", "Transform")
    from napari_phase4d._napari.menus import unwrap_ta

    unwrap_ta(viewer)
    said = [record.message for record in notification_manager.records]
    assert any("Select a layer with wrapped phase first" in words for words in said)
    assert len(viewer.layers) == 1


@pytest.mark.thorough
@pytest.mark.parametrize("key", ["euglena", "euglena_phase", "yeast"])
def test_samples_open(viewer, key: str) -> None:
    layers = viewer.open_sample("napari-phase4d", key)
    kinds = [layer.metadata[METADATA_KEY]["kind"] for layer in layers]
    assert kinds == {"euglena": ["holograms"]}.get(key, ["exact", "wrapped"])


@pytest.mark.thorough
def test_sample_phase_has_its_truth(viewer, dock) -> None:
    exact, wrapped = viewer.open_sample("napari-phase4d", "euglena_phase")
    dock.recording.layer.value = wrapped
    np.testing.assert_array_equal(dock.session.truth.values, exact.data)


def test_layers_are_saved_and_opened_again(viewer, tmp_path: Path) -> None:
    _, wrapped = viewer.open_sample("napari-phase4d", "yeast")
    (written,) = wrapped.save(str(tmp_path / "phase.ome.tif"), plugin="napari-phase4d")
    stack = read_results(written)
    np.testing.assert_array_equal(stack.values, wrapped.data)
    np.testing.assert_array_equal(stack["time"], yeast_sample()["wrapped"]["time"])
    (again,) = viewer.open(written, plugin="napari-phase4d")
    np.testing.assert_allclose(again.scale, wrapped.scale)
    assert [str(u) for u in again.units] == [str(u) for u in wrapped.units]
    assert again.axis_labels == wrapped.axis_labels


@pytest.mark.thorough
@pytest.mark.parametrize("shape", [(9, 11), (3, 9, 11), (3, 2, 9, 11)])
def test_any_grey_layer_is_saved(viewer, tmp_path: Path, shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    layer = viewer.add_image(values, scale=np.linspace(0.5, 0.2, len(shape)))
    (written,) = layer.save(str(tmp_path / "any.ome.tif"), plugin="napari-phase4d")
    stack = read_results(written)
    np.testing.assert_array_equal(stack.values.reshape(shape), values)
    assert stack.dims == ("time", "angle", "y", "x")
    assert float(stack["x"][1] - stack["x"][0]) == pytest.approx(0.2)


@pytest.mark.thorough
def test_recipe_opens_in_viewer_and_dock(viewer, dock, click, qtbot, tmp_path: Path) -> None:
    recipe = p4d.Recipe(
        recording="sample:yeast", methods=("spatial-2d",), boundary=((2, 1),), mask=None
    )
    path = recipe.to_file(tmp_path / "settings.json")
    (layer,) = viewer.open(path, plugin="napari-phase4d")
    dock.recording.layer.value = layer
    assert dock.session.recipe.boundary == ((2, 1),)
    assert not dock.unwrap.mask.value
    ticked = [m for m, row in dock.unwrap.methods.items() if row.tick.isChecked()]
    assert ticked == ["spatial-2d"]
    dock.recording.open_path(path)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert dock.session.recipe == recipe
    assert dock.session.known_truth is not None
    (tmp_path / "other.json").write_text("{}[")
    with pytest.raises(ValueError, match="refused the file"):
        viewer.open(tmp_path / "other.json", plugin="napari-phase4d")


@pytest.mark.thorough
def test_a_file_dropped_on_the_dock_is_opened(viewer, dock, qtbot, tmp_path: Path) -> None:
    path = p4d.Recipe(recording="sample:yeast").to_file(tmp_path / "recipe.json")
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path))])
    event = QDropEvent(
        QPointF(QPoint(20, 20)),
        Qt.DropAction.CopyAction,
        data,
        Qt.MouseButton.LeftButton,
        Qt.KeyboardModifier.NoModifier,
    )
    dock.dropEvent(event)
    qtbot.waitUntil(lambda: dock.session.reconstruction is not None, timeout=60_000)
    assert dock.session.name == "budding yeast"


@pytest.mark.thorough
def test_preferences_hold_the_microscope(viewer, dock, click, qtbot, tmp_path: Path) -> None:
    chosen = get_plugin_settings("napari-phase4d")
    frames = np.random.default_rng(0).integers(0, 200, (3, 32, 32)).astype(np.uint8)
    np.save(tmp_path / "video.npy", frames)
    dock.recording.open_path(tmp_path / "video.npy")
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert dock.session.recording.optics == p4d.Optics()
    dock.recording.numbers["wavelength_nm"].value = 532
    dock.recording.numbers["magnification"].value = 40
    click("remember_optics")
    try:
        assert chosen.microscope.wavelength_nm == 532
        dock.recording.open_path(tmp_path / "video.npy")
        qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
        assert dock.session.recording.optics == p4d.Optics(0.532, magnification=40)
        raw = viewer.add_image(frames, name="raw")
        dock.recording.layer.value = raw
        assert dock.session.recording.optics.magnification == 40
    finally:
        chosen.microscope.wavelength_nm, chosen.microscope.magnification = 632.8, 60.0


def test_theme_changes_at_once(viewer, dock) -> None:
    for theme in ("light", "dark"):
        viewer.theme = theme
        assert dock.grab().width() > 0
