"""Many cells in the window: shown without a stall, and no more of them in memory than needed."""

from __future__ import annotations

import threading
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.cells import CellLayers, ReadyLayers
from napari_phase4d._napari.widgets.result_table import ResultTable
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


@pytest.mark.thorough
@pytest.mark.gui
def test_layers_of_cells_are_made_outside_of_the_windows_thread(dock, click, monkeypatch):
    """They take a copy of all labels, and the first ones have their colours compiled."""
    sample = p4d.simulation.swimming_cells((96, 112), 4, 2, divisions=0, leaving=0)
    dock.session.set_phase(sample["wrapped"])
    dock.session.unwrap(["directional-l1"], mask=None)
    threads, made = [], ReadyLayers.of.__func__

    def noting(cls, cells):
        threads.append(threading.current_thread())
        return made(cls, cells)

    monkeypatch.setattr(ReadyLayers, "of", classmethod(noting))
    for _ in range(2):
        click("find_cells")
    assert len(threads) == 2
    assert threading.main_thread() not in threads
    outlines = dock.presenter.cells.outlines
    assert outlines in dock.presenter.viewer.layers
    np.testing.assert_array_equal(outlines.data, dock.session.cells.labels)
    assert not np.shares_memory(outlines.data, dock.session.cells.labels.values)


def test_the_colour_of_a_cell_stays_when_its_row_is_chosen(qtbot) -> None:
    table = ResultTable("colours")
    qtbot.addWidget(table)
    cells = pd.DataFrame({"cell": [1, 2]})
    table.show_frame(cells, {"cell": ("cell", "")}, colours=["#3a9bdc", "#e08a00"])
    table.show()
    table.selectRow(1)
    rect = table.visualItemRect(table.item(1, 0))
    picture = table.viewport().grab(rect).toImage()
    row = [picture.pixelColor(x, picture.height() // 2).name() for x in range(picture.width())]
    assert row.count("#e08a00") >= 8
