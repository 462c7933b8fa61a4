"""Regions, what is measured in them, and traces at one place, against exact truth."""

from __future__ import annotations

from typing import Any

import dask.array as da
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import measure, polygon_mask, region_masks, traces, traces_of
from napari_phase4d.task import Cancelled

OPTICS = p4d.Optics(wavelength_um=0.532, medium_index=1.337)
INDEX = 1.397
DIMS = ("time", "angle", "y", "x")
STEP_Y, STEP_X = 0.12, 0.1
#: Headings, in the order in which they are shown.
ALWAYS = ["region", "time (s)", "angle (deg)", "area (um^2)", "mean phase (rad)"]
OPD = "mean optical path difference (nm)"
HEIGHT = ["mean height (um)", "volume (um^3)"]


def stack_of(values: Any, **attrs: Any) -> xr.DataArray:
    values = np.asarray(values)
    coords = {
        "time": 0.25 * np.arange(values.shape[0]),
        "angle": -7 + 14.0 * np.arange(values.shape[1]),
        "y": STEP_Y * np.arange(values.shape[2]),
        "x": STEP_X * np.arange(values.shape[3]),
    }
    return xr.DataArray(values, dims=DIMS, coords=coords, attrs={"units": "rad", **attrs})


def sphere(radius_um: float, shape: tuple[int, int] = (90, 100)) -> np.ndarray:
    """Return the thickness of a sphere in micrometres along straight rays."""
    y, x = (np.arange(n) - n / 2 for n in shape)
    left = radius_um**2 - (STEP_Y * y[:, None]) ** 2 - (STEP_X * x) ** 2
    return 2 * np.sqrt(np.clip(left, 0, None))


def phase_of(thickness_um: np.ndarray) -> np.ndarray:
    return 2 * np.pi / 0.532 * (INDEX - 1.337) * thickness_um


def test_a_slab_is_measured_exactly() -> None:
    thickness = np.zeros((40, 50))
    thickness[10:20, 5:35] = 3.0
    stack = stack_of(phase_of(thickness)[None, None].astype(np.float32))
    regions = {"slab": thickness > 0, "field": np.ones((40, 50), bool)}
    table = measure(stack, regions, OPTICS, object_index=INDEX)
    assert list(table.columns) == [*ALWAYS, OPD, *HEIGHT, "dry mass (pg)"]
    slab, field = table.iloc[0], table.iloc[1]
    area = 300 * STEP_Y * STEP_X
    assert slab["area (um^2)"] == pytest.approx(area, rel=1e-9)
    assert slab[OPD] == pytest.approx(1000 * 0.06 * 3.0, rel=1e-6)
    assert slab["mean height (um)"] == pytest.approx(3.0, rel=1e-6)
    assert field["mean height (um)"] == pytest.approx(3.0 * 300 / 2000, rel=1e-6)
    for row in (slab, field):  # the empty field adds nothing
        assert row["volume (um^3)"] == pytest.approx(3.0 * area, rel=1e-6)
        assert row["dry mass (pg)"] == pytest.approx(0.06 * 3.0 * area / 0.18, rel=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_sphere_is_measured_exactly(dtype: type) -> None:
    thickness = sphere(4.0)
    inside = thickness > 0
    stack = stack_of(phase_of(thickness)[None, None].astype(dtype), wavelength_um=0.532)
    options = {"object_index": INDEX, "refraction_increment_ml_per_g": 0.2}
    row = measure(stack, {"cell": inside}, OPTICS, **options).iloc[0]
    volume = float(thickness.sum()) * STEP_Y * STEP_X
    assert row["mean height (um)"] == pytest.approx(thickness[inside].mean(), rel=1e-6)
    assert row["mean phase (rad)"] == pytest.approx(phase_of(thickness)[inside].mean(), rel=1e-6)
    assert row["volume (um^3)"] == pytest.approx(volume, rel=1e-6)
    assert row["dry mass (pg)"] == pytest.approx(volume * 0.06 / 0.2, rel=1e-6)
    # Pixels sample the sphere: its own volume and shadow are met less closely.
    assert row["volume (um^3)"] == pytest.approx(4 / 3 * np.pi * 4.0**3, rel=2e-3)
    assert row["area (um^2)"] == pytest.approx(np.pi * 4.0**2, rel=1e-2)


def test_every_region_time_and_angle_has_its_row() -> None:
    phase = np.random.default_rng(0).normal(3, 1, (4, 3, 12, 10))
    labels = np.zeros((4, 12, 10), dtype=np.int32)
    for t in range(4):
        labels[t, t : t + 5, 2:6] = 7  # moves
    labels[1:3, 10:, 8:] = 2  # comes and goes
    table = measure(stack_of(phase), region_masks(labels), OPTICS)
    assert list(table.columns) == [*ALWAYS, OPD, "dry mass (pg)"]
    assert list(table["region"]) == ["label 2"] * 12 + ["label 7"] * 12
    rows = iter(table.to_dict("records"))
    for number in (2, 7):
        for t in range(4):
            for a in range(3):
                row, picked = next(rows), phase[t, a][labels[t] == number]
                assert (row["time (s)"], row["angle (deg)"]) == (0.25 * t, -7 + 14 * a)
                assert row["area (um^2)"] == pytest.approx(picked.size * STEP_Y * STEP_X)
                if picked.size:
                    mass = picked.sum() * 0.532 / (2 * np.pi) * STEP_Y * STEP_X / 0.18
                    assert row["dry mass (pg)"] == pytest.approx(mass)
                    assert row["mean phase (rad)"] == pytest.approx(picked.mean())
                    assert row[OPD] == pytest.approx(picked.mean() * 532 / (2 * np.pi))
                else:
                    assert np.isnan(row["mean phase (rad)"])
                    assert np.isnan(row[OPD])
                    assert row["area (um^2)"] == 0
                    assert np.isnan(row["dry mass (pg)"])


def test_a_label_of_one_angle_counts_there_only() -> None:
    labels = np.zeros((2, 2, 6, 6), dtype=np.uint8)
    labels[:, 1, 2:4, 2:4] = 1
    table = measure(stack_of(np.ones(labels.shape)), region_masks(labels), OPTICS)
    pixels = table["area (um^2)"] / (STEP_Y * STEP_X)
    np.testing.assert_allclose(pixels, [0, 4, 0, 4])


def test_nan_pixels_are_outside() -> None:
    phase = np.full((2, 1, 8, 8), 2.0)
    phase[0, 0, :, :4] = np.nan
    phase[0, 0, 0, 7] = np.inf
    phase[1] = np.nan
    regions = {"all": np.ones((8, 8), bool)}
    some, none = measure(stack_of(phase), regions, OPTICS, object_index=INDEX).to_dict("records")
    assert some["area (um^2)"] == pytest.approx(31 * STEP_Y * STEP_X)
    assert some["mean phase (rad)"] == 2.0
    assert np.isnan([none["mean phase (rad)"], none[OPD], none["mean height (um)"]]).all()
    assert none["area (um^2)"] == 0
    assert np.isnan([none["volume (um^3)"], none["dry mass (pg)"]]).all()


def test_axes_may_be_missing_or_in_another_order() -> None:
    full = stack_of(np.random.default_rng(1).normal(size=(3, 2, 6, 7)))
    regions = {"part": np.arange(42).reshape(6, 7) % 3 == 0}
    expected = measure(full, regions, OPTICS)
    turned = measure(full.transpose("x", "time", "y", "angle"), regions, OPTICS)
    xr.testing.assert_allclose(xr.Dataset(turned), xr.Dataset(expected))
    one = measure(full[:, 1], regions, OPTICS)  # the angle is noted as a single number
    assert list(one["angle (deg)"]) == [7.0] * 3
    np.testing.assert_allclose(one["dry mass (pg)"], expected["dry mass (pg)"][1::2])
    bare = measure(full[0, 0].drop_vars(["time", "angle"]), regions, OPTICS)
    assert bare[["time (s)", "angle (deg)"]].isna().all().all()
    downward = measure(full.isel(y=slice(None, None, -1)), regions, OPTICS)
    np.testing.assert_allclose(downward["area (um^2)"], expected["area (um^2)"])


def test_measuring_says_what_is_wrong() -> None:
    stack = stack_of(np.ones((2, 3, 6, 7)), wavelength_um=0.532)
    frame = np.ones((6, 7), bool)
    regions = {"cell": frame}
    with pytest.raises(ValueError, match=r"wavelength of 0.532 um, but the optics say 0.6328 um"):
        measure(stack, regions, p4d.Optics())
    with pytest.raises(ValueError, match="there is no region to measure"):
        measure(stack, {}, OPTICS)
    with pytest.raises(TypeError, match="mask of cell is int64; .* region_masks"):
        measure(stack, {"cell": frame.astype(np.int64)}, OPTICS)
    for shape in ((7, 6), (1, 7), (3, 6, 7), (2, 2, 6, 7), (42,)):
        with pytest.raises(ValueError, match="mask of cell is .* does not fit the phase"):
            measure(stack, {"cell": np.ones(shape, bool)}, OPTICS)
    with pytest.raises(ValueError, match="object_index must differ from the medium"):
        measure(stack, regions, OPTICS, object_index=1.337)
    with pytest.raises(ValueError, match="object_index must lie between 1 and 5"):
        measure(stack, regions, OPTICS, object_index=np.nan)
    with pytest.raises(ValueError, match="refraction_increment_ml_per_g must be a number above 0"):
        measure(stack, regions, OPTICS, refraction_increment_ml_per_g=0)
    with pytest.raises(TypeError, match="DataArray with coordinates, but is ndarray"):
        measure(stack.values, regions, OPTICS)
    with pytest.raises(ValueError, match="no coordinates along y, x; give it"):
        measure(stack.drop_vars(["y", "x"]), regions, OPTICS)
    with pytest.raises(ValueError, match="x has no spacing"):
        measure(stack[..., :1], {"cell": frame[:, :1]}, OPTICS)
    with pytest.raises(ValueError, match="must be among time, angle, y, x"):
        measure(stack.rename(time="z"), regions, OPTICS)


def test_measuring_reports_and_stops() -> None:
    stack = stack_of(np.ones((2, 2, 6, 7)))
    regions = {name: np.ones((6, 7), bool) for name in "abc"}
    said: list[tuple[int, int, str]] = []
    with pytest.raises(Cancelled, match="after 2 of 3"):
        measure(stack, regions, OPTICS, progress=lambda *step: said.append(step),
                cancelled=lambda: len(said) == 2)  # fmt: skip
    assert said == [(n, 3, "measuring") for n in (1, 2)]


def test_labels_become_masks() -> None:
    for shape in ((5, 6), (2, 5, 6), (2, 3, 5, 6)):
        labels = np.random.default_rng(3).choice([0, 1, 12, 3], shape)
        masks = region_masks(labels)
        assert list(masks) == ["label 1", "label 3", "label 12"]
        assert all(m.dtype == np.bool_ and m.shape == shape for m in masks.values())
        assert sum(int(n.split()[1]) * m for n, m in masks.items()).tolist() == labels.tolist()
    with pytest.raises(ValueError, match="there are no labels"):
        region_masks(np.zeros((5, 5), int))
    with pytest.raises(ValueError, match="labels have 1 dimensions"):
        region_masks(np.ones(5, int))
    with pytest.raises(TypeError, match="whole numbers, but are float64"):
        region_masks(np.ones((5, 5)))


def test_a_polygon_holds_the_pixels_whose_centre_it_holds() -> None:
    box = polygon_mask([(1.5, 2.5), (1.5, 6.5), (4.5, 6.5), (4.5, 2.5)], (8, 9))
    by_hand = np.zeros((8, 9), bool)
    by_hand[2:5, 3:7] = True
    np.testing.assert_array_equal(box, by_hand)
    # A triangle whose edges pass no centre, against the signs of its edges.
    corners = np.array([(0.3, 0.4), (10.7, 3.2), (2.1, 15.6)])
    y, x = np.mgrid[:12, :14]  # the last corner lies outside of the frame
    sides = [
        (b[0] - a[0]) * (x - a[1]) - (b[1] - a[1]) * (y - a[0])
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    found = polygon_mask(corners, (12, 14))
    np.testing.assert_array_equal(found, np.all([s > 0 for s in sides], axis=0))
    assert 50 < found.sum() < 100


@pytest.mark.parametrize(
    ("corners", "sentence"),
    [
        ([(0, 0), (3, 3)], "three or more corners"),
        ([(0, 0, 0), (3, 3, 3), (1, 2, 3)], "three or more corners"),
        ([(0, 0), (3, np.nan), (3, 3)], "finite"),
        (
            [(-9, 1), (-4, 1), (-4, 5)],
            r"y -9 to -4, x 1 to 5 pixels\) lies outside .* 8 x 9",
        ),
        ([(1, 20), (4, 20), (4, 30)], "lies outside of the frame"),
        ([(1.2, 1.2), (1.2, 1.4), (1.4, 1.4)], "no pixel of the frame in the polygon"),
    ],
)
def test_a_polygon_says_what_is_wrong(corners: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        polygon_mask(corners, (8, 9))


def test_traces_are_the_phase_at_a_place() -> None:
    values = {
        name: np.random.default_rng(i).normal(size=(5, 3, 8, 9)) for i, name in enumerate("ab")
    }
    values["b"][2, 1, 3:, 4:] = np.nan
    results = {name: stack_of(v) for name, v in values.items()}
    at_pixel = traces(results, (2, 1), (3, 4))
    np.testing.assert_array_equal(at_pixel.times_s, 0.25 * np.arange(5))
    np.testing.assert_array_equal(at_pixel.angles_deg, [-7, 7, 21])
    mask = np.zeros((8, 9), bool)
    mask[2:5, 4] = mask[7, 8] = True
    over_mask = traces(results, (2, 1), mask)
    assert over_mask.frame == (2, 1)
    for name, v in values.items():
        np.testing.assert_array_equal(at_pixel.over_time[name], v[:, 1, 3, 4])
        np.testing.assert_array_equal(at_pixel.over_angle[name], v[2, :, 3, 4])
        by_time = [np.nanmean(v[t, 1][mask]) for t in range(5)]
        np.testing.assert_allclose(over_mask.over_time[name], by_time)
        by_angle = [np.nanmean(v[2, a][mask]) for a in range(3)]
        np.testing.assert_allclose(over_mask.over_angle[name], by_angle)
    assert np.isnan(at_pixel.over_time["b"][2])
    assert np.isfinite(over_mask.over_time["b"]).all()


def test_traces_of_results_on_disk_read_the_blocks_of_the_place() -> None:
    values = np.random.default_rng(0).normal(size=(40, 2, 8, 9)).astype(np.float32)
    values[3, 1, 4, 5] = np.nan
    read: set[tuple[int, ...]] = set()

    def block(block_info: dict) -> np.ndarray:
        place = block_info[None]["array-location"]
        read.add(tuple(first for first, _ in place))
        return values[tuple(slice(*one) for one in place)]

    chunks = ((2,) * 20, (1, 1), (4, 4), (9,))
    lazy = da.map_blocks(block, chunks=chunks, dtype=np.float32, meta=values[:0])
    stack = xr.DataArray(lazy, dims=("time", "angle", "y", "x"))
    mask = np.zeros((8, 9), dtype=bool)
    mask[4:6, 3:7] = True
    for where in ((4, 5), mask):
        read.clear()
        found = traces_of({"a": stack}, (4, 1), where)
        assert read == {(t, 1, 4, 0) for t in range(0, 40, 2)} | {(4, 0, 4, 0)}
        expected = traces_of({"a": xr.DataArray(values, dims=stack.dims)}, (4, 1), where)
        np.testing.assert_array_equal(found.over_time["a"], expected.over_time["a"])
        np.testing.assert_array_equal(found.over_angle["a"], expected.over_angle["a"])
    read.clear()
    again = traces_of({"a": stack}, (9, 1), mask, known=found)
    assert read == {(8, 0, 4, 0), (8, 1, 4, 0)}
    assert again.over_time is found.over_time
    asked = iter(range(100))
    with pytest.raises(p4d.Cancelled):
        traces_of({"a": stack}, (4, 1), mask, cancelled=lambda: next(asked) > 1)


def test_traces_of_phase_without_an_angle() -> None:
    full = stack_of(np.random.default_rng(1).normal(size=(4, 2, 6, 7)))
    expected = traces({"a": full}, (3, 1), (2, 5))
    for part in (full[:, 1], full[:, 1].transpose("x", "y", "time")):
        found = traces({"a": part}, (3, 0), (2, 5))
        np.testing.assert_array_equal(found.over_time["a"], expected.over_time["a"])
        np.testing.assert_array_equal(found.over_angle["a"], expected.over_angle["a"][1:])
        assert found.angles_deg.tolist() == [7.0]


def test_traces_say_what_is_wrong() -> None:
    results = {"a": stack_of(np.ones((5, 3, 8, 9)))}
    with pytest.raises(ValueError, match="there are no results yet"):
        traces({}, (0, 0), (1, 1))
    with pytest.raises(ValueError, match="differ in shape"):
        traces(results | {"b": stack_of(np.ones((4, 3, 8, 9)))}, (0, 0), (1, 1))
    for frame in ((5, 0), (0, 3), (-1, 0)):
        with pytest.raises(ValueError, match="the frame .* does not exist"):
            traces(results, frame, (1, 1))
    for pixel in ((8, 0), (0, 9), (-1, 0)):
        with pytest.raises(ValueError, match="lies outside of the frame of 8 x 9"):
            traces(results, (0, 0), pixel)
    for mask in (np.ones((9, 8), bool), np.zeros((8, 9), bool)):
        with pytest.raises(ValueError, match="it must mark some of"):
            traces(results, (0, 0), mask)
    with pytest.raises(ValueError, match=r"a pixel \(y, x\) or a mask"):
        traces(results, (0, 0), (1.5, 2))


@pytest.mark.parametrize(
    "dims", [("time", "angle", "x", "y"), ("angle", "time", "y", "x"), ("angle", "y", "x")]
)
@pytest.mark.parametrize("as_list", [False, True])
def test_plain_labels_have_the_axes_of_the_phase(dims: tuple[str, ...], *, as_list: bool) -> None:
    """Square frames, and as many times as angles: nothing but their order tells the axes."""
    phase = p4d.simulation.swimming_cells((40, 40), 2, 1, divisions=0, leaving=0, entering=0)
    exact = phase["phase"].assign_coords(time=[0.0, 1.0])
    cells = p4d.find_cells(exact)
    gone = {dim: 0 for dim in exact.dims if dim not in dims}
    expected = p4d.measure(exact.isel(gone), cells.isel(gone), p4d.Optics())
    plain = cells.isel(gone).transpose(*dims).values
    given = plain.tolist() if as_list else plain
    found = p4d.measure(exact.isel(gone).transpose(*dims), given, p4d.Optics())
    pd.testing.assert_frame_equal(found, expected)
