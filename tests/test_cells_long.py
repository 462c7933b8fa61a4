"""Cells of stacks that do not fit into memory: never more than a few frames at a time."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

import dask.array as da
import numpy as np
import pytest
import xarray as xr
from dask.callbacks import Callback

import napari_phase4d as p4d
from napari_phase4d import stack
from napari_phase4d.analysis import (
    cell_results,
    cells_in,
    copied_labels,
    measures,
    region_with_cell,
)
from napari_phase4d.task import Cancelled

SHAPE = (320, 2, 128, 128)
#: Bytes of labels as bool, of which no part of the work may make a stack.
AS_BOOL = int(np.prod(SHAPE))


@pytest.fixture(autouse=True)
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (stack, cell_results, measures):
        monkeypatch.setattr(module, "PART_BYTES", 2**18)


@contextmanager
def at_most(limit: int) -> Iterator[None]:
    """Fail where more than so many bytes are held at a time; mapped files do not count."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


def frame_at(time: int) -> np.ndarray:
    """Return two views of two cells, of which the first moves, and the second comes late."""
    y, x = np.mgrid[: SHAPE[2], : SHAPE[3]]
    frame = np.zeros(SHAPE[1:], dtype=np.int32)
    frame[:, (y - 40) ** 2 + (x - 30 - time // 8) ** 2 < 10**2] = 1
    if time > 3:
        frame[:, (y - 90) ** 2 + (x - 60) ** 2 < 9**2] = 2
    return frame


def lazy(work, dtype) -> xr.DataArray:
    """Return a stack of which each time is computed when it is looked at."""
    values = da.map_blocks(
        lambda block_id: work(frame_at(block_id[0]))[None].astype(dtype),
        chunks=((1,) * SHAPE[0], *((n,) for n in SHAPE[1:])), dtype=dtype,
        meta=np.empty((0,) * 4, dtype),
    )  # fmt: skip
    coords = {"time": np.arange(SHAPE[0]) / 4, "angle": [-7.0, 21.0]}
    coords |= {axis: np.arange(n) / 4 for axis, n in zip("yx", SHAPE[2:], strict=True)}
    return xr.DataArray(values, dims=("time", "angle", "y", "x"), coords=coords)


@pytest.fixture(scope="module")
def labels() -> xr.DataArray:
    return lazy(lambda frame: frame, np.int32)


@pytest.fixture(scope="module")
def phase() -> xr.DataArray:
    return lazy(lambda frame: 2.0 * (frame > 0), np.float32)


def spot() -> np.ndarray:
    region = np.zeros(SHAPE[2:], dtype=bool)
    region[36:45, 28:35] = True
    return region


@pytest.mark.thorough
def test_a_region_goes_along_in_any_length(labels: xr.DataArray) -> None:
    region_with_cell(spot(), (0, 1), labels[:4])  # what is imported first does not count
    told: list[tuple[int, int]] = []
    with at_most(AS_BOOL // 3):
        moved = region_with_cell(
            spot(), (0, 1), labels, progress=lambda done, total, _: told.append((done, total))
        )
        for time in (0, 3, 100, SHAPE[0] - 1):
            wanted = np.roll(spot(), time // 8, axis=1)
            np.testing.assert_array_equal(moved[time, 0], wanted)
    assert moved.dims == labels.dims
    assert told[-1] == (SHAPE[0], SHAPE[0])


@pytest.mark.thorough
def test_a_region_is_measured_in_any_length(labels: xr.DataArray, phase: xr.DataArray) -> None:
    moved = region_with_cell(spot(), (0, 1), labels)
    p4d.measure(phase[:4], {"spot": moved[:4]}, p4d.Optics())
    in_memory = phase.compute()
    with at_most(AS_BOOL // 2):
        table = p4d.measure(in_memory, {"spot": moved}, p4d.Optics())
    assert (table["area (um^2)"] == spot().sum() / 16).all()
    np.testing.assert_allclose(table["mean phase (rad)"], 2.0)


def test_a_region_stops_going_along_when_cancelled(labels: xr.DataArray) -> None:
    asked = iter([False] * 5 + [True] * 99)
    with pytest.raises(Cancelled, match="following the region"):
        region_with_cell(spot(), (0, 0), labels, cancelled=lambda: next(asked))


@pytest.mark.slow
def test_a_region_on_a_cell_that_is_not_there_yet_weighs_nothing_known(
    labels: xr.DataArray, phase: xr.DataArray
) -> None:
    region = np.zeros(SHAPE[2:], dtype=bool)
    region[88:93, 58:63] = True
    moved = region_with_cell(region, (9, 0), labels)
    assert moved[:6].any(("angle", "y", "x")).values.tolist() == [False] * 4 + [True] * 2
    table = p4d.measure(phase[:6], {"late": moved[:6]}, p4d.Optics(), object_index=1.4)
    at_first = table[table["time (s)"] < 1].drop(columns=["region", "time (s)", "angle (deg)"])
    assert (at_first.pop("area (um^2)") == 0).all()
    assert at_first.isna().all(axis=None)
    assert (table["dry mass (pg)"][8:] > 0).all()
    cells = p4d.measure(phase[:6], labels[:6], p4d.Optics())
    assert cells["time (s)"][cells["cell"] == 2].min() == 1.0


@pytest.mark.slow
def test_lazy_labels_are_measured_without_holding_them(
    labels: xr.DataArray, phase: xr.DataArray
) -> None:
    few = slice(0, 24)
    held: list[int] = []

    def note(_: object, state: dict, failed: bool) -> None:
        held.append(sum(getattr(value, "nbytes", 0) for value in state["cache"].values()))

    with Callback(finish=note):
        found = cells_in(
            phase[few], p4d.Optics(), labels=labels[few], confidence=phase[few] * 0 + 1
        )
    assert found.summary["frames"].tolist() == [24, 20]
    assert max(held) < 4 * labels[0].nbytes


@pytest.mark.slow
def test_labels_in_a_file_are_copied_into_a_file(labels: xr.DataArray) -> None:
    with at_most(labels.nbytes // 4):
        copy = copied_labels(labels[:48])
    assert isinstance(copy, np.memmap)
    np.testing.assert_array_equal(copy[40], labels[40])
    plain = labels[:2].compute()
    copied_labels(plain)[:] = 0
    assert plain.any()
