"""In which frame the number and the way of a cell are shown."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from napari_phase4d._napari.viewing.cells import numbers_layer
from napari_phase4d.analysis import Cells

#: A pause in the recording; and times that jitter.
JITTER = np.cumsum(0.1 + 0.02 * np.random.default_rng(0).standard_normal(200))
PAUSED = np.array([0.0, 1, 2, 3, 10, 11, 12])


@pytest.mark.parametrize(
    ("times", "angles"),
    [
        (PAUSED, np.array([-7.0, 21.0])),
        (JITTER, np.array([0.0])),
        (PAUSED, np.array([-30.0, 0, 5, 21])),
        (np.array([0.0]), np.array([21.0, -30, 5])),
    ],
)
def test_numbers_stand_in_their_frames_however_uneven_these_are(
    times: np.ndarray, angles: np.ndarray
) -> None:
    grid = {"time": times, "angle": angles, "y": np.arange(8.0), "x": np.arange(8.0)}
    labels = xr.DataArray(
        np.zeros([len(places) for places in grid.values()], np.int32), coords=grid
    )
    table = pd.DataFrame(
        {
            "cell": 1,
            "time (s)": np.repeat(times, len(angles)),
            "angle (deg)": np.tile(angles, len(times)),
            "y (um)": 3.25,
            "x (um)": 4.0,
            "largest phase (rad)": 1.0,
        }
    )
    shown = numbers_layer(Cells(labels, table, "angular"), "numbers", {1: "white"})["data"]
    frames = [(t, a, 3.25, 4) for t in range(len(times)) for a in range(len(angles))]
    assert shown.tolist() == [list(frame) for frame in frames]
