"""Stacks made wrong in one way at a time, given to everything that takes one: never in silence.

Each call is refused in one sentence, or warns, or gives what the right stack gives.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import itoh_margin, residues, traces
from stacks import without_attrs as bare
from test_wrong_input import EXACT, OF_UNWRAPPED, OF_WRAPPED, WRAPPED, scaled, with_places

N_Y, N_X = WRAPPED.sizes["y"], WRAPPED.sizes["x"]
BY_UNIT = {"radian": 1.0, "degree": 180 / np.pi, "turn": 0.5 / np.pi}


def other_kind(stack: xr.DataArray) -> xr.DataArray:
    return WRAPPED if stack is EXACT else EXACT


def with_pixel(stack: xr.DataArray, value: float) -> xr.DataArray:
    values = stack.values.copy()
    values[1, 0, 9, 9] = value
    return stack.copy(data=values)


#: Ways to make a stack wrong, or to write the same in another way.
WAYS: dict[str, Callable[[xr.DataArray], Any]] = {
    "angles unsorted": lambda s: s.isel(angle=[1, 0]),
    "times shuffled": lambda s: s.isel(time=[2, 0, 3, 1]),
    "times falling": lambda s: s.isel(time=slice(None, None, -1)),
    "a time is NaN": lambda s: with_places(s, "time", [0, 1, np.nan, 3]),
    "times are text": lambda s: with_places(s, "time", list("abcd")),
    "angles are text": lambda s: with_places(s, "angle", ["a", "b"]),
    "angles twice": lambda s: with_places(s, "angle", [7, 7]),
    "times twice": lambda s: with_places(s, "time", [0, 1, 1, 2]),
    "an angle is infinite": lambda s: with_places(s, "angle", [0, np.inf]),
    "uneven y": lambda s: with_places(s, "y", np.arange(N_Y * 1.0) ** 2),
    "shuffled x": lambda s: with_places(s, "x", np.roll(np.arange(N_X * 1.0), 3)),
    "y in seconds": lambda s: scaled(s, "y", 1, "s"),
    "x in pixels": lambda s: scaled(s, "x", 1, "px"),
    "times in micrometres": lambda s: scaled(s, "time", 1, "um"),
    "angles in percent": lambda s: scaled(s, "angle", 1, "percent"),
    "a path in nm": lambda s: bare(s).assign_attrs(units="nm"),
    "amplitude": lambda s: bare(s).assign_attrs(units="a.u."),
    "a share": lambda s: bare(s).assign_attrs(units="1"),
    "camera frames": lambda s: (bare(s) * 5 + 20).astype("u1"),
    "deep camera frames": lambda s: (bare(s) * 3000 + 12000).astype("u2"),
    "bool": lambda s: s > 1,
    "complex": lambda s: np.exp(1j * s),
    "text": lambda s: np.full(s.shape, "a"),
    "objects": lambda s: np.full(s.shape, None),
    "the other kind": other_kind,
    "a Dataset": lambda s: xr.Dataset({"a": s, "b": s}),
    "rows of other lengths": lambda s: [[1.0, 2.0], [1.0]],
    "None": lambda s: None,
    "a name": lambda s: "phase.tif",
    "a number": lambda s: 3.0,
    "one axis": lambda s: s.values.ravel(),
    "five axes": lambda s: s.values[None],
    "no times": lambda s: s[:0],
    "no pixels": lambda s: s[..., :0],
    "all NaN": lambda s: s.copy(data=np.full(s.shape, np.nan, np.float32)),
    "names of other axes": lambda s: s.rename(y="z"),
    "another pixel": lambda s: scaled(s, "x", 2, "um"),
    "other angles": lambda s: s.assign_coords(angle=[100.0, 105.0]),
    "fewer times": lambda s: s[:3],
    "fewer rows": lambda s: s[:, :, 2:],
    "one view": lambda s: s.isel(angle=0),
    "degrees, as it says": lambda s: (bare(s) * BY_UNIT["degree"]).assign_attrs(units="degree"),
    "turns, as it says": lambda s: (bare(s) * BY_UNIT["turn"]).assign_attrs(units="turn"),
    "nanometres, as they say": lambda s: scaled(scaled(s, "y", 1e3, "nm"), "x", 1e3, "nm"),
    "milliseconds, as they say": lambda s: scaled(s, "time", 1000, "ms"),
    "radians of angle, as they say": lambda s: scaled(s, "angle", np.pi / 180, "rad"),
    "axes in another order": lambda s: s.transpose("x", "angle", "y", "time"),
    "double precision": lambda s: s.astype(np.float64),
    "on disk": lambda s: s.chunk({"time": 2}),
    "a view that steps": lambda s: s.copy(data=np.repeat(s.values, 2, axis=-1)[..., ::2]),
    "big-endian": lambda s: s.copy(data=s.values.astype(">f4")),
    "read-only": lambda s: s.copy(data=np.broadcast_to(s.values, s.shape)),
}
WORKS: dict[str, Callable[[Any], Any]] = {
    **OF_WRAPPED,
    **OF_UNWRAPPED,
    "itoh_margin": itoh_margin,
    "find_cells": p4d.find_cells,
    "residues": residues,
    "traces": lambda phase: traces({"a": phase}, (1, 0), (9, 9)),
}
#: What takes wrapped phase.
FROM_WRAPPED = {*OF_WRAPPED, "residues"}
#: Ways that are wrong only where there is another stack to fit.
OF_TWO = ("another pixel", "other angles", "fewer times", "fewer rows", "one view")
#: What takes a single stack.
ALONE = (
    "unwrap", "compare", "score_boundaries", "measure", "itoh_margin", "traces", "find_cells",
    "residues",
)  # fmt: skip


def numbers(result: Any) -> list[np.ndarray]:
    """Return all numbers of a result, in the order of angles."""
    if isinstance(result, p4d.Comparison):
        return [a for stack in result.results.values() for a in numbers(stack)]
    if isinstance(result, xr.Dataset):
        return [a for _, stack in sorted(result.items()) for a in numbers(stack)]
    if isinstance(result, xr.DataArray):
        known = [d for d in ("time", "angle") if d in result.coords and result[d].ndim]
        named = [d for d in ("time", "angle", "y", "x") if d in result.dims]
        ordered = result.sortby(known).transpose(*named, ...) if known else result
        return [np.asarray(ordered.values, np.float64)]
    if isinstance(result, pd.DataFrame):
        named = [c for c in ("time (s)", "angle (deg)") if c in result]
        return [result.sort_values(named).select_dtypes("number").to_numpy(np.float64)]
    if isinstance(result, (float, int, np.floating)):
        return [np.asarray(float(result))]
    found = [vars(result)[name] for name in ("over_time", "over_angle")]
    return [np.asarray(v, np.float64) for part in found for v in part.values()]


def outcome_of(work: Callable[[Any], Any], given: Any) -> tuple[str, Any]:
    """Return what happens: "refused", "warned" or "done", with what was said or found."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = work(given)
        except (TypeError, ValueError) as error:
            return "refused", str(error)
    ours = [w for w in said if w.category is UserWarning]
    return ("warned", str(ours[0].message)) if ours else ("done", result)


@lru_cache
def expected(name: str) -> list[np.ndarray]:
    """Return what the right stack gives."""
    return numbers(WORKS[name](WRAPPED if name in FROM_WRAPPED else EXACT))


CASES = [(way, name) for way in WAYS for name in WORKS if not (way in OF_TWO and name in ALONE)]


@pytest.mark.thorough
@pytest.mark.parametrize(("way", "name"), CASES)
def test_nothing_wrong_in_silence(way: str, name: str) -> None:
    work, right = WORKS[name], WRAPPED if name in FROM_WRAPPED else EXACT
    what, found = outcome_of(work, WAYS[way](right))
    if what in ("refused", "warned"):
        assert found
        assert "\n" not in found
        assert "napari_phase4d" not in found
        return
    for one, other in zip(numbers(found), expected(name), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
