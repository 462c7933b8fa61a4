"""Drag and drop and File > Open take every format."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest
from napari.layers import Layer
from npe2 import PluginManifest

from format_cases import CASES
from format_writers import INTERVAL_S, PIXEL_UM, noise
from napari_phase4d._napari.menus import get_reader
from napari_phase4d.io import READABLE_SUFFIXES

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.gui


def patterns() -> list[str]:
    manifest = PluginManifest.from_file(ROOT / "src" / "napari_phase4d" / "napari.yaml")
    return [p for reader in manifest.contributions.readers for p in reader.filename_patterns]


#: Of these napari would ask each time who is to read them, and reads them well itself: a layer
#: of a grey picture is taken in step 1.
PICTURES = {".png", ".bmp", ".jpg", ".jpeg"}


def test_manifest_names_what_can_be_read() -> None:
    assert set(READABLE_SUFFIXES) > PICTURES
    named = {*READABLE_SUFFIXES, ".json"} - PICTURES
    assert set(patterns()) == {f"*{suffix}" for suffix in named}


OPENED = [
    n for n, c in CASES.items() if c.exact and not c.single and not c.options and "*" not in n
]


@pytest.mark.parametrize("name", OPENED)
def test_file_becomes_a_layer(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    frames = noise(6, (48, 64), case.dtype)
    path = case.write(tmp_path, frames)
    assert path.is_dir() or any(fnmatch(path.name, pattern) for pattern in patterns())
    (layer_tuple,) = get_reader(str(path))(str(path))
    layer = Layer.create(*layer_tuple)
    assert layer.data.shape == (6, 1, 48, 64)
    np.testing.assert_array_equal(np.asarray(layer.data[5, 0]), frames[5])
    if case.interval:
        assert layer.scale[0] == pytest.approx(INTERVAL_S)
    if case.pixel:
        assert layer.scale[-1] == pytest.approx(PIXEL_UM)


def test_files_dropped_together_are_one_recording(tmp_path: Path) -> None:
    frames = noise(12, (48, 64), np.uint16)
    files = []
    for i in range(12):
        files.append(str(tmp_path / f"frame{i}.npy"))
        np.save(files[-1], frames[i])
    mixed = sorted(files)  # as a file dialog lists them: 10 before 2
    (layer_tuple,) = get_reader(mixed)(mixed)
    np.testing.assert_array_equal(np.asarray(layer_tuple[0])[:, 0], frames)
    assert get_reader([*files, str(tmp_path / "notes.txt")]) is None
    assert get_reader([str(tmp_path / "a.json"), str(tmp_path / "b.json")]) is None


def test_raw_file_that_needs_a_layout_says_where_to_open_it(tmp_path: Path) -> None:
    path = tmp_path / "camera.raw"
    path.write_bytes(noise(2, (48, 64), np.uint16).tobytes())
    with pytest.raises(ValueError, match=r"camera\.raw is raw .* in step 1 of the Phase 4D dock"):
        get_reader(str(path))(str(path))
