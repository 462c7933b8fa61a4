"""Many cells in the window: shown without a stall, and no more of them in memory than needed."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d._napari.viewing.cells import CellLayers
from napari_phase4d.analysis import Cells

AXES = ("time", "angle", "y", "x")


def test_outlines_are_compared_frame_by_frame() -> None:
    values = np.zeros((96, 2, 128, 128), dtype=np.int32)
    values[:, :, 20:40, 30:50] = 1
    layer = SimpleNamespace(data=values.copy())
    shown = CellLayers(SimpleNamespace(layers=[layer]))
    shown.outlines = layer
    shown._cells = Cells(xr.DataArray(values, dims=AXES), pd.DataFrame())
    tracemalloc.start()
    assert not shown.is_edited
    assert tracemalloc.get_traced_memory()[1] < values.size // 8
    tracemalloc.stop()
    layer.data[-1, 1, 0, 0] = 7
    assert shown.is_edited
