"""The table of a comparison: one row a method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d.evaluation.errors import mean_squared_error, wrong_cycle_share
from napari_phase4d.stacks import KIND, UNWRAPPED, on_grid_of, unwrapped_stack

__all__ = [
    "DOUBTFUL",
    "OF_TRUTH",
    "as_truth",
    "doubtful_percent",
    "errors",
    "in_order",
    "table_of",
]

#: Columns of the table that need truth.
OF_TRUTH = ("mse_rad2", "wrong_cycles_percent")
#: Columns of the table, in the order in which they are shown.
COLUMNS = ("method", "seconds", "peak_mb", "doubtful_percent", *OF_TRUTH)
#: A pixel is doubtful if it is trusted less than this.
DOUBTFUL = 0.5


def table_of(rows: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Return a table of one row a method."""
    return pd.DataFrame(list(rows.values()), index=pd.Index(list(rows), name="id"))


def in_order(table: pd.DataFrame) -> pd.DataFrame:
    """Put the columns of a table into the order in which they are shown."""
    return table[[name for name in COLUMNS if name in table.columns]]


def as_truth(truth: xr.DataArray | Any, phase: xr.DataArray) -> xr.DataArray | None:
    """Return truth in the form of the phase, or None."""
    if truth is None:
        return None
    fitting = on_grid_of(truth, phase, "truth")
    if fitting.dtype.kind == "b":
        msg = "truth is bool, as masks are; give exact phase, or the mask as mask=..."
        raise TypeError(msg)
    exact = phase.copy(data=unwrapped_stack(fitting, "truth").values)
    exact.attrs = {**phase.attrs, KIND: UNWRAPPED}
    return exact


def errors(result: xr.DataArray, truth: xr.DataArray | None) -> dict[str, float]:
    """Return the columns that need truth."""
    if truth is None:
        return {}
    return {
        "mse_rad2": mean_squared_error(result, truth),
        "wrong_cycles_percent": 100 * wrong_cycle_share(result, truth),
    }


def doubtful_percent(confidence: xr.DataArray, inside: xr.DataArray) -> float:
    """Return the share in percent of the pixels inside that are trusted less than 0.5."""
    trust = confidence.transpose(*inside.dims).values
    count = np.count_nonzero(inside.values)
    if count == 0:
        return float("nan")
    return 100 * np.count_nonzero((trust < DOUBTFUL) & inside.values) / count
