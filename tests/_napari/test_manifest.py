"""What napari finds: commands, reader, sample, widget."""

from __future__ import annotations

import re
from pathlib import Path

import napari
import numpy as np
import pytest
import tifffile
from napari.layers import Layer
from npe2 import PluginManifest

import napari_phase4d as p4d
from napari_phase4d._napari.menus import get_reader
from napari_phase4d.io import write_phase
from napari_phase4d.stacks import AXES

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.gui


def test_manifest_is_valid_and_every_command_exists() -> None:
    manifest = PluginManifest.from_file(ROOT / "src" / "napari_phase4d" / "napari.yaml")
    manifest.validate_imports()
    declared = {command.id for command in manifest.contributions.commands}
    text = (ROOT / "napari.yaml").read_text(encoding="utf-8")
    assert set(re.findall(r"command: (\S+)", text)) == declared


@pytest.mark.thorough
def test_sample_opens_from_the_menu(make_napari_viewer) -> None:
    viewer = make_napari_viewer()
    (layer,) = viewer.open_sample("napari-phase4d", "euglena")
    assert layer.data.shape == (40, 1, 512, 512)
    assert layer.axis_labels == AXES
    assert tuple(str(u) for u in layer.units)[2:] == ("micrometer", "micrometer")
    np.testing.assert_allclose(layer.scale, [1 / 6, 1, 5.2 / 60, 5.2 / 60])


@pytest.mark.thorough
def test_sample_layer_can_be_used_in_the_dock(make_napari_viewer) -> None:
    viewer = make_napari_viewer()
    (layer,) = viewer.open_sample("napari-phase4d", "euglena")
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    assert layer in dock.recording.layer.choices
    dock.recording.layer.value = layer
    assert dock.session.recording.n_frames == 40
    assert dock.session.recording.frame_rate_hz == pytest.approx(6)
    assert list(viewer.layers) == [layer]  # shown already, so none is added


def test_reader_opens_videos_lazily(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (4, 32, 40)).astype(np.uint8)
    path = tmp_path / "video.tif"
    tifffile.imwrite(path, frames, imagej=True, resolution=(2, 2),
                     metadata={"axes": "TYX", "unit": "um", "finterval": 0.5})  # fmt: skip
    (layer_tuple,) = get_reader(str(path))(str(path))
    layer = Layer.create(*layer_tuple)
    assert layer.data.shape == (4, 1, 32, 40)
    assert isinstance(layer_tuple[0], np.memmap)
    np.testing.assert_allclose(layer.scale, [0.5, 1, 0.5, 0.5])
    assert get_reader(str(tmp_path / "text.txt")) is None
    assert get_reader([str(path), str(tmp_path / "a.txt")]) is None


def test_results_reopen_with_scale_units_and_labels(
    make_napari_viewer, tmp_path, small_video
) -> None:
    data = p4d.reconstruct(small_video, p4d.find_lobes(small_video, 2, angles_deg=(-7, 21)))
    result = p4d.unwrap(data["phase"])
    path = write_phase(tmp_path / "ta.ome.tif", result)
    viewer = make_napari_viewer()
    (layer,) = viewer.open(path, plugin="napari-phase4d")
    np.testing.assert_array_equal(layer.data, result.values)
    assert layer.axis_labels == AXES
    np.testing.assert_allclose(layer.scale[1], 28)
    np.testing.assert_allclose(layer.translate[1], -7)
    assert layer.name == "ta"


def test_version_of_napari_is_of_a_supported_series() -> None:
    assert napari.__version__.startswith(("0.9.", "0.10."))
