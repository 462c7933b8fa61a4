"""Results as napari opens them: by its own reader, and by ours with scale, units and times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import pytest
import xarray as xr

from napari_phase4d._napari.menus import write_stack
from napari_phase4d._napari.viewing import layers
from napari_phase4d._napari.viewing.layers import METADATA_KEY
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.stacks import AXES

pytestmark = pytest.mark.gui

ENDINGS = [".ome.tif", ".ome.zarr"]


@pytest.fixture
def stack() -> xr.DataArray:
    values = np.random.default_rng(0).normal(size=(3, 2, 24, 30)).astype(np.float32)
    coords = {
        "time": ("time", [0.0, 0.5, 1.5], {"units": "s"}),
        "angle": ("angle", [-7.0, 21.0], {"units": "deg"}),
        "y": ("y", np.arange(24) * 0.3, {"units": "um"}),
        "x": ("x", np.arange(30) * 0.4, {"units": "um"}),
    }
    attrs = {"units": "rad", "method": "temporal-angular", "boundary": [[0, 0]]}
    return xr.DataArray(values, dims=AXES, coords=coords, name="temporal-angular", attrs=attrs)


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ENDINGS)
def test_naparis_own_reader_opens_results(
    viewer: Any, tmp_path: Path, stack: xr.DataArray, ending: str
) -> None:
    path = write_phase(tmp_path / f"ta{ending}", stack)
    (layer,) = viewer.open(path, plugin="napari")
    np.testing.assert_array_equal(np.asarray(layer.data), stack.values)
    # It reads no scale of any file; the numbers for it are in the files, see tests/test_travel.py.
    np.testing.assert_array_equal(layer.scale, 1)
    assert not layer.multiscale
    if ending == ".ome.zarr":
        assert layer.data.chunksize == (1, 1, 24, 30)  # lazily, a frame at a time


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ENDINGS)
def test_our_reader_opens_results_in_place(
    viewer: Any, tmp_path: Path, stack: xr.DataArray, ending: str
) -> None:
    path = write_phase(tmp_path / f"ta{ending}", stack)
    (layer,) = viewer.open(path, plugin="napari-phase4d")
    np.testing.assert_array_equal(np.asarray(layer.data), stack.values)
    np.testing.assert_allclose(layer.scale[1:], [28, 0.3, 0.4])
    np.testing.assert_allclose(layer.translate, [0, -7, 0, 0])
    assert [str(unit) for unit in layer.units] == ["second", "degree", "micrometer", "micrometer"]
    assert layer.axis_labels == AXES
    assert layer.name == "ta"
    note = layer.metadata[METADATA_KEY]
    assert note["kind"] == "unwrapped"
    assert note["times_s"] == [0.0, 0.5, 1.5]  # uneven as they are
    assert note["angles_deg"] == [-7.0, 21.0]
    assert isinstance(layer.data, np.ndarray) == (ending == ".ome.tif")
    viewer.dims.set_point(0, 1.5)
    viewer.dims.set_point(1, 21)
    value = layer.get_value((*viewer.dims.point[:2], 5 * 0.3, 7 * 0.4), world=True)
    assert value == stack.values[-1, 1, 5, 7]


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ENDINGS)
def test_layers_of_results_are_saved_again_as_they_were(
    viewer: Any,
    tmp_path: Path,
    stack: xr.DataArray,
    ending: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = write_phase(tmp_path / f"ta{ending}", stack)
    (layer,) = viewer.open(path, plugin="napari-phase4d")
    data, keywords, _ = layer.as_layer_data_tuple()
    monkeypatch.setattr(layers.OnDemand, "__array__", pytest.fail)  # not all at once
    (written,) = write_stack(str(tmp_path / f"again{ending}"), data, keywords)
    assert written == str(tmp_path / f"again{ending}")
    again = read_results(written)
    np.testing.assert_array_equal(again.values, stack.values)
    np.testing.assert_array_equal(again["time"], stack["time"])
    np.testing.assert_array_equal(again["angle"], stack["angle"])
    assert again.attrs == stack.attrs


@pytest.mark.thorough
def test_lazy_layers_of_any_origin_are_saved_a_part_at_a_time(viewer: Any, tmp_path: Path) -> None:
    asked: list[tuple[int, ...]] = []

    def frame(block_info: Any = None) -> np.ndarray:
        asked.append(block_info[None]["chunk-location"])
        return np.full((1, 24, 30), block_info[None]["chunk-location"][0], np.float32)

    lazy = da.map_blocks(
        frame, chunks=((1,) * 4, (24,), (30,)), dtype=np.float32, meta=np.empty((0, 0, 0), "f4")
    )
    layer = viewer.add_image(lazy, scale=(0.5, 0.2, 0.2), contrast_limits=(0, 4))
    asked.clear()
    data, keywords, _ = layer.as_layer_data_tuple()
    (written,) = write_stack(str(tmp_path / "any.zarr"), data, keywords)
    assert Path(written).name == "any.ome.zarr"
    assert sorted(asked) == [(i, 0, 0) for i in range(4)]  # each once
    found = read_results(written)
    assert found.dims == AXES
    np.testing.assert_array_equal(found[:, 0, 0, 0], [0, 1, 2, 3])
    assert float(found["time"][1]) == 0.5
