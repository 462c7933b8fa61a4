"""Refocusing of what a user has made of a reconstruction, and how much a search takes."""

from __future__ import annotations

import re

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography import autofocus, refocused
from napari_phase4d.holography.refocusing import transfer_function
from napari_phase4d.task import Cancelled


@pytest.fixture
def data(small_video) -> xr.Dataset:
    return p4d.reconstruct(small_video, p4d.find_lobes(small_video, 2))


def test_other_variables_stay(data: xr.Dataset) -> None:
    mask = data["phase"] > 0
    found = refocused(data.assign(mask=mask, level=("time", np.arange(data.sizes["time"]))), 3.0)
    xr.testing.assert_identical(found["mask"], mask.rename("mask"))
    xr.testing.assert_identical(found["phase"], refocused(data, 3.0)["phase"])
    assert "refocus_um" not in data.attrs
    assert "refocus_um" not in data["phase"].attrs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wavelength_um", "medium_index", "y"])
def test_what_is_not_known_is_named(data: xr.Dataset, name: str) -> None:
    less = data.drop_vars("y") if name == "y" else data.copy()
    less.attrs.pop(name, None)
    with pytest.raises(ValueError, match=f"refocusing needs {name}, which the dataset does not"):
        refocused(less, 3.0)


def test_lazy_data_are_read_a_time_at_a_time(data: xr.Dataset) -> None:
    import dask

    largest = []

    def noted(block: np.ndarray) -> np.ndarray:
        if block.size:
            largest.append(len(block))
        return block

    lazy = data.chunk({"time": 1})
    lazy["phase"].data = lazy["phase"].data.map_blocks(noted, dtype=np.float32)
    computed = []
    with dask.config.set(scheduler=lambda graph, keys, **kw: counted(computed, graph, keys, **kw)):
        found = refocused(lazy, 3.0)
    xr.testing.assert_identical(found["phase"], refocused(data, 3.0)["phase"])
    assert len(computed) == 2 * data.sizes["time"]


def counted(computed: list, graph, keys, **kw):
    from dask.local import get_sync

    computed.append(1)
    return get_sync(graph, keys, **kw)


def field() -> np.ndarray:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    return np.exp(1j * np.exp(-20 * (x**2 + y**2)))[None].astype(np.complex64)


def test_search_keeps_no_transfer_functions() -> None:
    transfer_function.cache_clear()
    autofocus(field(), 0.63, 0.3, 1.33)
    assert transfer_function.cache_info().currsize == 0
    assert transfer_function.cache_info().maxsize == 1


def test_search_is_stopped_while_it_refines() -> None:
    planes = []

    def progress(done: int, total: int, _: str) -> None:
        planes.append(done == total)

    with pytest.raises(Cancelled):
        autofocus(field(), 0.63, 0.3, 1.33, progress=progress, cancelled=lambda: refining(planes))


def refining(planes: list, calls: list = []) -> bool:  # noqa: B006 - it counts
    calls.append(bool(planes) and planes[-1])
    return sum(calls) > 1  # the first after the last plane belongs to that plane


def test_many_large_views_are_bounded(small_video, monkeypatch: pytest.MonkeyPatch) -> None:
    from napari_phase4d.holography import (
        PhaseSettings,
        find_focus,
        frame_reconstructor,
        reconstruction,
    )

    work = frame_reconstructor(small_video, p4d.find_lobes(small_video, 2), PhaseSettings())
    seen = []
    real = reconstruction.autofocus

    def looked_at(fields, *args, **kw):
        seen.append(fields.shape[0])
        return real(fields, *args, **kw)

    monkeypatch.setattr(reconstruction, "autofocus", looked_at)
    monkeypatch.setattr(reconstruction, "FOCUS_PIXELS", 1)
    find_focus(work, small_video)
    monkeypatch.setattr(reconstruction, "MOST_FOCUS_PIXELS", 1)
    find_focus(work, small_video)
    assert seen == [2, 1]


def test_farther_than_the_field_can_hold_is_said(small_video) -> None:
    lobes = p4d.find_lobes(small_video, 2)
    with pytest.warns(UserWarning, match=r"beyond the edges .* stay within (\d+) um") as said:
        far = p4d.reconstruct(small_video, lobes, refocus_um=1e5)
    (number,) = re.findall(r"within (\d+) um", str(said[0].message))
    most = float(number)
    optics, radius = small_video.optics, max(lobe.radius for lobe in lobes)
    # Light of so fine detail has come from one field aside.
    sine = radius / np.sqrt(2) / optics.pixel_um * optics.wavelength_um / optics.medium_index
    assert most == pytest.approx(128 * optics.pixel_um / np.tan(np.arcsin(sine)), rel=0.1)
    assert far.attrs["refocus_fields_walked"] > 1000
    # Below, nothing is said: warnings are errors here.
    near = p4d.reconstruct(small_video, lobes, refocus_um=-0.9 * most)
    assert near.attrs["refocus_fields_walked"] < 1
