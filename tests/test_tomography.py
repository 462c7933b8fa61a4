"""Sinograms: what they hold, what a tomographic program makes of them, and what is refused."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.io import sinogram, write_sinogram
from napari_phase4d.simulation import Ellipsoid, phase_stack, with_noise

PAGE = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "tomography.md"
SIDE, PIXEL_UM, DELTA_N = 40, 0.3, 0.02
BODIES = [
    Ellipsoid((0.6, 0.0, 0.4), (3.0, 3.4, 2.4), DELTA_N),
    Ellipsoid((1.2, -0.9, 0.5), (1.0, 1.0, 1.0), DELTA_N / 2),
]


def turned(n: int = 60) -> xr.Dataset:
    """A phantom seen from all sides at one time."""
    angles = np.arange(n) * 360 / n
    return phase_stack(
        lambda _: BODIES, times_s=[0.0], angles_deg=list(angles), shape=(SIDE, SIDE),
        pixel_um=PIXEL_UM, optics=p4d.Optics(), attrs={},
    )  # fmt: skip


@pytest.mark.slow
def test_a_tomographic_program_finds_the_refractive_index(tmp_path: Path) -> None:
    odtbrain = pytest.importorskip("odtbrain", reason="the test peer is not installed")
    exact = with_noise(turned(), 0.05, seed=1)
    unwrapped = p4d.unwrap(exact["wrapped"], "angular")
    path = write_sinogram(tmp_path / "phantom", sinogram(unwrapped, time=0))
    with h5py.File(path) as file:
        scattered = odtbrain.backpropagate_3d(
            file["rytov"][:], file["angles"][:], file.attrs["resolution"],
            file.attrs["medium_index"], num_cores=1,
        )  # fmt: skip
        index = odtbrain.odt_to_ri(
            scattered, file.attrs["resolution"], file.attrs["medium_index"]
        ).real
    # ODTbrain's axes are z, y, x about the middle of the field.
    places = (np.arange(SIDE) - SIDE / 2) * PIXEL_UM
    z, y, x = np.meshgrid(places, places, places, indexing="ij")
    body, nucleus = (
        ((x - b.centre_um[0]) / b.semi_axes_um[0]) ** 2
        + ((y - b.centre_um[1]) / b.semi_axes_um[1]) ** 2
        + ((z - b.centre_um[2]) / b.semi_axes_um[2]) ** 2
        for b in BODIES
    )
    medium = p4d.Optics().medium_index
    inside = (body < 0.5) & (nucleus > 2)
    assert float(index[inside].mean()) - medium == pytest.approx(DELTA_N, rel=0.1)
    assert float(index[nucleus < 0.5].mean()) - medium == pytest.approx(1.5 * DELTA_N, rel=0.15)
    assert abs(float(index[body > 2.5].mean()) - medium) < 0.1 * DELTA_N


def test_fields_are_those_of_phase_and_amplitude() -> None:
    exact = turned(24)["phase"]
    size = exact.copy(data=2 - 0.5 * (exact.values > 1).astype(np.float32))
    found = sinogram(exact, size, time=0, optics=p4d.Optics(medium_index=1.4))
    np.testing.assert_allclose(
        np.angle(found["field"][0]), np.angle(np.exp(1j * exact[0, 0])), atol=1e-5
    )
    np.testing.assert_allclose(found["rytov"].values.imag, exact.values[0], atol=1e-5)
    # Relative to the empty field, whose amplitude is 2 here.
    np.testing.assert_allclose(np.abs(found["field"].values), size.values[0] / 2, rtol=1e-5)
    np.testing.assert_allclose(np.rad2deg(found["angle"]), np.arange(24) * 15, atol=1e-9)
    assert found.attrs["resolution"] == pytest.approx(0.6328 / PIXEL_UM)
    assert found.attrs["medium_index"] == 1.4


def test_times_of_a_turning_object_are_projections() -> None:
    views = turned(24)["phase"]
    over_time = xr.DataArray(
        views.values.transpose(1, 0, 2, 3),
        dims=views.dims,
        coords={"time": np.arange(24.0), "angle": [0.0], "y": views["y"], "x": views["x"]},
        attrs=views.attrs,
    )
    found = sinogram(over_time, view=0, angles_deg=views["angle"].values)
    xr.testing.assert_allclose(found["field"], sinogram(views, time=0)["field"])


def test_few_views_are_said_to_give_no_tomogram() -> None:
    sample = p4d.simulation.swimming_euglena((32, 40), 3, peak_rad=5)["phase"]
    with pytest.warns(UserWarning, match="2 views over 28 degrees give no tomogram"):
        sinogram(sample, time=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sinogram(turned(24)["phase"], time=0)


def test_amplitude_is_found_by_its_coordinates_and_counts_from_the_empty_field() -> None:
    exact = turned(24)["phase"]
    rows = np.linspace(1, 2, SIDE, dtype=np.float32)[:, None]
    size = exact.copy(data=np.broadcast_to(rows, exact.shape).copy())
    there = sinogram(exact, size, time=0)
    flipped = sinogram(exact, size.isel(angle=slice(None, None, -1)), time=0)
    xr.testing.assert_allclose(there["field"], flipped["field"])
    # A cell that takes half of the light, over most of the frame.
    large = np.abs(exact.values) > 0.5
    small = sinogram(exact, size.copy(data=np.where(large, 0.5, 1).astype(np.float32)), time=0)
    assert np.median(np.abs(small["field"].values[~large[0]])) == pytest.approx(1, rel=1e-3)
    with pytest.raises(ValueError, match="shows no empty field"):
        sinogram(exact + 5, size, time=0)


def test_single_pixels_that_are_not_known_count_as_empty_field() -> None:
    exact = turned(24)["phase"].copy()
    exact.values[0, :, 3, 3] = np.nan
    with pytest.warns(UserWarning, match="24 pixels that are not known count as empty field"):
        found = sinogram(exact, time=0)
    np.testing.assert_allclose(found["field"][:, 3, 3], 1)
    exact.values[:] = np.nan
    with pytest.raises(ValueError, match="nothing but NaN"):
        sinogram(exact, time=0)


def test_angles_and_pixels_are_not_invented() -> None:
    plain = turned(24)["phase"].drop_vars(["angle", "y", "x"])
    with pytest.raises(ValueError, match="no coordinates along angle, y, x"):
        sinogram(plain, time=0)


def test_lost_projections_are_left_out_and_said() -> None:
    exact = turned(24)["phase"].copy()
    exact.values[0, 3] = np.nan
    with pytest.warns(UserWarning, match="projections 3 are left out"):
        found = sinogram(exact, time=0)
    assert found.sizes["projection"] == 23


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        ({}, "give time="),
        ({"time": 0, "view": 0}, "give time="),
        ({"view": 0}, "angles_deg must say how far"),
        ({"time": 5}, "there is no time 5; there are 1"),
        ({"time": True}, "must be the number of a time"),
        ({"time": 0, "angles_deg": [1, 2]}, "must be 24 numbers"),
        ({"time": 0, "angles_deg": [1.0] * 24}, "different from each other"),
        ({"time": 0, "amplitude": np.ones((24, 3))}, "amplitude"),
    ],
)
def test_what_can_not_be_is_refused(wanted: dict[str, object], sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        sinogram(turned(24)["phase"], **wanted)  # type: ignore[arg-type]


def test_files_are_whole_or_not_there(tmp_path: Path) -> None:
    found = sinogram(turned(24)["phase"], time=0)
    assert write_sinogram(tmp_path / "a", found) == tmp_path / "a.h5"
    with pytest.raises(ValueError, match=r"written as \.h5"):
        write_sinogram(tmp_path / "a.tif", found)
    with pytest.raises(ValueError, match="is no sinogram"):
        write_sinogram(tmp_path / "b", found.drop_vars("rytov"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("odtbrain", reason="the test peer is not installed")
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)
    index = names["index"]
    assert isinstance(index, np.ndarray)
    assert index.shape == (40, 40, 40)
    assert index[20, 20, 20] - 1.333 == pytest.approx(0.02, rel=0.1)
