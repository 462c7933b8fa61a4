"""Cells found, followed and weighed, against simulated cells whose labels and masses are exact."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pandas as pd
import pytest
import scipy
import skimage
import xarray as xr
from scipy.optimize import linear_sum_assignment

import napari_phase4d as p4d
from napari_phase4d.analysis import cells_in
from napari_phase4d.analysis.cell_table import perimeters_um
from napari_phase4d.simulation import Ellipsoid, phase_stack, swimming_cells

OPTICS = p4d.Optics()
#: Cells at first, shape, what happens.
RECORDINGS = {
    "few": (3, (160, 160), {}),
    "some": (7, (200, 256), {}),
    "many": (14, (288, 360), {"divisions": 2, "leaving": 2, "entering": 2}),
}


@lru_cache
def recording(name: str, noise: float, seed: int = 0) -> tuple[xr.Dataset, xr.DataArray]:
    count, shape, events = RECORDINGS[name]
    data = swimming_cells(shape, 40, count, seed=seed, **events)
    rng = np.random.default_rng(seed)
    noisy = data["phase"] + rng.normal(0, noise, data["phase"].shape).astype(np.float32)
    noisy.attrs = data["phase"].attrs
    return data, noisy


@lru_cache
def found_in(name: str, noise: float, seed: int = 0) -> xr.DataArray:
    return p4d.find_cells(recording(name, noise, seed)[1])


def overlaps(true: np.ndarray, found: np.ndarray) -> tuple[list[tuple[int, int]], int, int]:
    """Return the pairs of cells that overlap by half, and how many there are on either side."""
    n = int(found.max()) + 1
    joint = np.bincount((true.ravel() * n + found.ravel()), minlength=(true.max() + 1) * n)
    joint = joint.reshape(-1, n).astype(float)
    sizes = joint.sum(1), joint.sum(0)
    share = joint / (sizes[0][:, None] + sizes[1][None] - joint + 1e-9)
    share[0], share[:, 0] = 0, 0
    rows, columns = linear_sum_assignment(-share)
    pairs = [(i, j) for i, j in zip(rows, columns, strict=True) if share[i, j] >= 0.5]
    return pairs, int((sizes[0][1:] >= 30).sum()), int((sizes[1][1:] > 0).sum())


CASES = [(name, noise) for name in RECORDINGS for noise in (0.0, 0.3)]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "noise"), CASES)
def test_cells_are_found_and_keep_their_numbers(name: str, noise: float) -> None:
    data, _ = recording(name, noise)
    true, found = data["cells"].values, found_in(name, noise).values
    hits = wanted = given = switches = 0
    for angle in range(2):
        number: dict[int, int] = {}
        for time in range(len(true)):
            pairs, there, here = overlaps(true[time, angle], found[time, angle])
            hits, wanted, given = hits + len(pairs), wanted + there, given + here
            for cell, label in pairs:
                switches += number.setdefault(cell, label) != label
                number[cell] = label
    assert 2 * hits / (wanted + given) >= 0.98
    assert switches <= 1


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "noise"), CASES)
def test_divisions_are_found(name: str, noise: float) -> None:
    data, _ = recording(name, noise)
    found = found_in(name, noise)
    daughters = data["cell"].values[data["parent"].values > 0]
    assert len(found.attrs["parents"]) == len(daughters)
    number = {}
    for t in range(data.sizes["time"]):
        for cell, label in overlaps(data["cells"].values[t, 0], found.values[t, 0])[0]:
            number.setdefault(cell, label)
    parent = dict(found.attrs["parents"])
    for daughter in daughters:
        mother = int(data["parent"].sel(cell=daughter))
        assert parent[number[int(daughter)]] == number[mother]


@pytest.mark.slow
def test_both_views_have_the_same_numbers() -> None:
    data, _ = recording("some", 0.3)
    found = found_in("some", 0.3).values
    for t in (0, 12, 39):
        sides = []
        for angle in range(2):
            pairs, _, _ = overlaps(data["cells"].values[t, angle], found[t, angle])
            sides.append(dict(pairs))
        both = sides[0].keys() & sides[1].keys()
        assert len(both) >= 6
        assert all(sides[0][cell] == sides[1][cell] for cell in both)


def table_of(name: str, noise: float, seed: int) -> pd.DataFrame:
    """Measure a recording; add the true mass of each cell that is wholly in view."""
    data, noisy = recording(name, noise, seed)
    cells = found_in(name, noise, seed)
    table = p4d.measure(noisy, cells, p4d.Optics())
    times, angles = data["time"].values.tolist(), data["angle"].values.tolist()
    true = []
    for row in table.itertuples(index=False, name=None):
        t = int(np.argmin(np.abs(np.array(times) - row[2])))
        a = angles.index(row[3])
        of_cell = np.bincount(data["cells"].values[t, a][cells.values[t, a] == row[0]])
        of_cell[0] = 0
        cell = int(of_cell.argmax())
        true.append(float(data["dry_mass_pg"].sel(cell=cell)[t]) if of_cell.any() else np.nan)
    return table.assign(true=true).dropna(subset=["true"])


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.2, 0.5])
def test_masses_are_right_and_their_errors_cover(noise: float) -> None:
    table = pd.concat([table_of("some", noise, seed) for seed in (0, 1, 2)])
    off = table["dry mass (pg)"] - table["true"]
    assert (off.abs() / table["true"]).median() < 0.01
    covered = (off.abs() < table["dry mass error (pg)"]).mean()
    assert 0.6 < covered < 0.8
    # What mass is divided by the area, or by lengths, is off by the same share of it.
    share = table["dry mass error (pg)"] / table["dry mass (pg)"]
    density = table["mass density (pg/um^2)"], table["mass density error (pg/um^2)"]
    np.testing.assert_allclose(density[1] / density[0], share)


def test_a_disc_has_its_area_and_form() -> None:
    y, x = np.mgrid[:64, :64] - 31.5
    disc = np.where(y**2 + x**2 < 15**2, 2.0, 0.0).astype(np.float32)
    phase = xr.DataArray(
        disc[None, None].repeat(2, 0), dims=("time", "angle", "y", "x"),
        coords={"time": [0.0, 1.0], "angle": [0.0], "y": y[:, 0] / 2, "x": x[0] / 2},
    )  # fmt: skip
    optics = p4d.Optics()
    table = p4d.measure(phase, (phase.values > 1).astype(np.int32), optics, object_index=1.4)
    assert table["cell"].tolist() == [1, 1]
    assert table["area (um^2)"][0] == pytest.approx(np.pi * 7.5**2, rel=0.02)
    assert table["circularity"][0] > 0.95
    assert table["mean phase (rad)"][0] == pytest.approx(2.0)
    assert table["speed (um/s)"].tolist()[1] == 0
    height = optics.height_um(2.0, 1.4)
    assert table["volume (um^3)"][0] == pytest.approx(height * table["area (um^2)"][0])
    path = 1000 * optics.optical_path_um(2.0)
    for kind in ("mean", "largest"):
        assert table[f"{kind} optical path difference (nm)"][0] == pytest.approx(path)
    tilted = phase.assign_coords(angle=[60.0])
    cells = (phase.values > 1).astype(np.int32)
    half = p4d.measure(tilted, cells, optics, oblique=True)["dry mass (pg)"][0]
    assert half == pytest.approx(0.5 * table["dry mass (pg)"][0])


@pytest.mark.thorough
def test_pixels_in_doubt_make_the_error_larger() -> None:
    _, noisy = recording("few", 0.3)
    cells = found_in("few", 0.3)
    sure = p4d.measure(noisy, cells, p4d.Optics(), confidence=xr.ones_like(noisy))
    rather = p4d.measure(noisy, cells, p4d.Optics(), confidence=xr.ones_like(noisy) * 0.7)
    doubted = p4d.measure(noisy, cells, p4d.Optics(), confidence=xr.ones_like(noisy) * 0.6)
    name = "dry mass error (pg)"
    np.testing.assert_allclose(sure[name], p4d.measure(noisy, cells, p4d.Optics())[name])
    # 70 of 100 lie within one standard deviation as it is.
    np.testing.assert_allclose(rather[name], sure[name])
    pixel, area = p4d.Optics().dry_mass_pg(2 * np.pi, 1.0), sure["area (um^2)"]
    extra = np.sqrt(doubted[name] ** 2 - sure[name] ** 2)
    np.testing.assert_allclose(extra, 0.4 * area * pixel, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("views", [[0], [0, 1]])
def test_cells_keep_their_numbers_over_frames_that_are_lost(views: list[int]) -> None:
    """More of them than a cell may be missing in otherwise, as when a beam is blocked."""
    sample = swimming_cells((96, 128), 14, 3, divisions=0, leaving=0, entering=0, seed=3)
    phase = sample["phase"].copy(deep=True)
    whole = p4d.find_cells(phase)
    phase[4:9, views] = np.nan
    found = p4d.find_cells(phase)
    seen = np.isfinite(phase.values)
    assert found.values.max() == whole.values.max() == 3
    assert not found.values[~seen].any()
    np.testing.assert_array_equal(found.values[seen], whole.values[seen])


def test_cells_that_touch_are_kept_apart_over_a_lost_frame() -> None:
    """They have no neck then: they are known by the frame before the one that is lost."""
    y, x = np.mgrid[:48, :72]
    frames = [
        4.0 * ((np.hypot(y - 24, x - 36 + d) < 10) | (np.hypot(y - 24, x - 36 - d) < 10))
        for d in (13, np.nan, 7)
    ]
    frames[1][:] = np.nan
    phase = xr.DataArray(np.float32(frames)[:, None], dims=("time", "angle", "y", "x"))
    assert p4d.find_cells(phase[2]).values.max() == 1
    found = p4d.find_cells(phase).values[:, 0, 24]
    assert found[2, 25] == found[0, 20] > 0
    assert found[2, 47] == found[0, 52] > 0
    assert found.max() == 2


def discs(places: Sequence[Sequence[tuple[float, float, float]]]) -> xr.DataArray:
    """Return frames with discs (y, x, radius); one without any is lost."""
    y, x = np.mgrid[:64, :160]
    frames = [
        4.0 * np.any([np.hypot(y - cy, x - cx) < r for cy, cx, r in frame], axis=0)
        if frame
        else np.full(y.shape, np.nan)
        for frame in places
    ]
    return xr.DataArray(np.float32(frames)[:, None], dims=("time", "angle", "y", "x"))


def test_what_flows_is_not_taken_for_what_was_ahead_of_it() -> None:
    """Where the next cell has come to after lost frames, another one was before."""
    flow = [[(32, x + 5 * t, 9) for x in (15, 45, 75)] for t in range(4)]
    flow += [[]] * 5 + [[(32, x + 5 * t, 9) for x in (15, 45, 75)] for t in range(9, 13)]
    found = p4d.find_cells(discs(flow)).values[:, 0]
    assert set(np.unique(found[:4])) == {0, 1, 2, 3}
    assert not set(np.unique(found[9:])) & {1, 2, 3}


def test_a_few_that_flow_among_many_that_stand_are_known_by_their_own_steps() -> None:
    stand = [(12, x, 5) for x in range(8, 156, 14)] + [(52, x, 5) for x in range(8, 156, 14)]
    flow = [[(32, x + 5 * t, 9) for x in (15, 45)] for t in range(15)]
    frames = [stand + moved for moved in flow]
    frames[4:9] = [[]] * 5
    found = p4d.find_cells(discs(frames)).values[:, 0]
    before, after = (set(np.unique(found[part, 32])) - {0} for part in (slice(4), slice(9, 15)))
    assert len(before) == len(after) == 2
    assert not before & after
    for row in (12, 52):
        assert set(np.unique(found[:4, row])) == set(np.unique(found[9:, row]))


def test_cells_that_stand_are_followed_where_few_frames_are_known() -> None:
    cells = [(32, 40, 9), (32, 100, 9)]
    frames = [cells if t % 4 == 0 else [] for t in range(21)]
    assert p4d.find_cells(discs(frames)).values.max() == 2


@pytest.mark.parametrize("painted", [[7], list(range(4, 10))])
def test_labels_in_frames_that_are_lost_are_followed(painted: list[int]) -> None:
    cells = [(32, 40, 9), (32, 100, 9)]
    phase = discs([[] if 4 <= t < 10 else cells for t in range(14)])
    phase = phase.assign_coords({dim: np.arange(n) * 0.5 for dim, n in phase.sizes.items()})
    labels = p4d.find_cells(phase)
    labels[painted] = labels[0]
    again = cells_in(phase, OPTICS, labels=labels).labels
    np.testing.assert_array_equal(again, labels)


@pytest.mark.parametrize("gap", [0, 1, 2, 5])
def test_a_cell_may_be_missing_for_as_many_frames_as_the_gap_has(gap: int) -> None:
    cell = discs([[(32, 40, 9)]])[0] > 0
    for missing in range(1, 8):
        there = np.array([True] * 3 + [False] * missing + [True] * 3)
        labels = there[:, None, None, None] * cell.values[None].astype(np.int32)
        found = p4d.follow_cells(labels, gap=gap)
        assert found.values.max() == (1 if missing <= gap else 2)


def test_one_cell_is_not_cut_by_two_of_long_ago() -> None:
    two, one = [(32, 60, 9), (32, 84, 9)], [(32, 72, 18)]
    for lost, cells in ((1, 2), (9, 1)):
        phase = discs([two] * 3 + [[]] * lost + [one] * 3)
        assert len(np.unique(p4d.find_cells(phase).values[-1])) == 1 + cells


def test_cells_that_were_corrected_are_followed_over_lost_frames_too() -> None:
    phase = discs([[(32, 40, 9), (32, 100, 9)]] * 4 + [[]] * 6 + [[(32, 41, 9), (32, 99, 9)]] * 4)
    phase = phase.assign_coords({dim: np.arange(n) * 0.5 for dim, n in phase.sizes.items()})
    cells = p4d.find_cells(phase)
    assert cells.values.max() == 2
    again = cells_in(phase, OPTICS, labels=cells).labels
    np.testing.assert_array_equal(again, cells)


@pytest.mark.slow
def test_labels_of_another_program_are_followed() -> None:
    data, _ = recording("some", 0.0)
    labels = data["cells"].values.copy()
    rng = np.random.default_rng(0)
    for frame in labels.reshape(-1, *labels.shape[2:]):  # as found frame by frame
        frame[:] = np.append(0, rng.permutation(np.arange(1, 40)))[frame]
    followed = p4d.follow_cells(labels).values
    for angle in range(2):
        for cell in range(1, 8):
            numbers = np.unique(followed[:, angle][data["cells"].values[:, angle] == cell])
            assert len(numbers) == 1


@pytest.mark.slow
def test_sizes_and_the_border_are_minded() -> None:
    _, noisy = recording("few", 0.0)
    pixel = float(noisy["x"][1] - noisy["x"][0])
    area = np.bincount(p4d.find_cells(noisy[:1]).values[0, 0].ravel())[1:] * pixel**2
    assert p4d.find_cells(noisy[:1], largest_um2=area.min() * 0.9).values.max() == 0
    assert p4d.find_cells(noisy[:1], smallest_um2=area.max() * 1.5).values.max() == 0
    inside = p4d.find_cells(noisy, at_border=False).values
    assert not inside[..., 0].any()
    assert not inside[..., -1, :].any()


def test_a_cell_of_which_some_is_not_known_is_not_wholly_in_view() -> None:
    data, _ = recording("few", 0.0)
    phase, cells = data["phase"][:1, :1], data["cells"].values[:1, :1]
    numbers = [n for n in np.unique(cells) if n]
    where = np.argwhere(cells[0, 0] == numbers[0])
    known = phase.copy(deep=True)
    known.values[0, 0, *where[0]] = np.nan  # a dead pixel takes nothing away
    half = known.copy(deep=True)
    half.values[0, 0][:, : int(where[:, 1].mean())] = np.nan
    table = {
        name: p4d.measure(p, cells, p4d.Optics()).set_index("cell")
        for name, p in (("all", phase), ("dead pixel", known), ("half", half))
    }
    whole = {name: bool(rows.loc[numbers[0], "wholly in view"]) for name, rows in table.items()}
    assert whole == {"all": True, "dead pixel": True, "half": False}
    mass = table["half"].loc[numbers[0], "dry mass (pg)"]
    assert mass < 0.8 * table["all"].loc[numbers[0], "dry mass (pg)"]


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda p: p4d.find_cells(p, threshold_rad=-1), "threshold_rad must be a number above 0"),
        (lambda p: p4d.find_cells(p > 1), "bool, as masks are"),
        (lambda p: p4d.follow_cells(p), "labels must be whole numbers"),
        (lambda p: p4d.follow_cells(-np.ones((3, 9, 9), int)), "some are negative"),
        (lambda p: p4d.follow_cells(np.ones(9, int)), "two to four axes"),
        (lambda p: p4d.measure(p, np.ones((3, 3), int), p4d.Optics()), "does not fit the phase"),
        (lambda p: p4d.measure(p, p.values, p4d.Optics()), "cells must be whole numbers"),
        (lambda p: p4d.measure(p, np.zeros(p.shape, int), p4d.Optics()), "there are no cells"),
    ],
)
def test_what_can_not_be_is_said(call, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        call(recording("few", 0.0)[0]["phase"])


@pytest.mark.slow
def test_a_stack_on_disk_gives_the_same() -> None:
    _, noisy = recording("few", 0.3)
    cells = p4d.find_cells(noisy.chunk({"time": 4}))
    xr.testing.assert_identical(cells.drop_attrs(), found_in("few", 0.3).drop_attrs())


@pytest.mark.slow
def test_other_axes_give_the_same() -> None:
    _, noisy = recording("few", 0.0)
    turned = p4d.find_cells(noisy.transpose("x", "time", "angle", "y"))
    assert turned.dims == ("x", "time", "angle", "y")
    np.testing.assert_array_equal(turned.transpose(*noisy.dims), found_in("few", 0.0))
    one = p4d.find_cells(noisy.isel(time=0, angle=0))
    assert one.dims == ("y", "x")


def balls(
    places: Sequence[tuple[float, float]],
    pixel_um: tuple[float, float] = (0.3, 0.3),
    shape: tuple[int, int] = (200, 200),
) -> xr.DataArray:
    """Exact phase of balls of 5 micrometres, of one mass each."""
    bodies = [Ellipsoid((x, y, 0.0), (5.0, 5.0, 5.0), 0.03) for x, y in places]
    return phase_stack(
        lambda time: bodies, times_s=[0.0, 1.0], angles_deg=[0.0], shape=shape, pixel_um=pixel_um,
        optics=OPTICS, attrs={},
    )["phase"]  # fmt: skip


@pytest.mark.parametrize("left_out", [[], [3], [2, 3]])
@pytest.mark.parametrize("masked", [False, True])
def test_cells_without_a_label_are_no_empty_field(left_out: list[int], masked: bool) -> None:
    """Of a program that finds fewer, or because they are too small or at the border."""
    phase = balls([(-12, -12), (12, 12), (12, -12)])
    seen = phase + np.random.default_rng(0).normal(0, 0.2, phase.shape).astype(np.float32)
    if masked:
        seen = seen.where(phase > 0, 0)
        seen = seen.assign_attrs(mask="auto", drift_removed=True, background="tilt")
    cells = p4d.find_cells(phase)
    table = p4d.measure(seen, cells.where(~cells.isin(left_out), 0).astype(np.int32), OPTICS)
    alone = table[table["cell"] == 1]
    true = OPTICS.dry_mass_pg(2 * np.pi / OPTICS.wavelength_um * 0.03 * 4 / 3 * np.pi * 5**3, 1.0)
    np.testing.assert_allclose(alone["dry mass (pg)"], true, rtol=0.01)
    assert (alone["dry mass error (pg)"] < 0.01 * true).all()


@pytest.mark.parametrize("pixel_um", [(0.3, 0.3), (0.2, 0.4), (0.4, 0.2), (0.15, 0.45)])
def test_a_ball_is_round_in_any_pixels(pixel_um: tuple[float, float]) -> None:
    shape = (round(40 / pixel_um[0]), round(40 / pixel_um[1]))
    phase = balls([(-8, -6), (7, 7)], pixel_um, shape)
    table = p4d.measure(phase, p4d.find_cells(phase), OPTICS)
    assert (table["circularity"] > 0.96).all()


def test_outlines_in_squares_are_those_of_scikit_image() -> None:
    noise = scipy.ndimage.gaussian_filter(np.random.default_rng(0).normal(size=(80, 90)), 3)
    labels = skimage.measure.label(noise > 0.02).astype(np.int32)
    wanted = skimage.measure.regionprops_table(labels, properties=("perimeter_crofton",))
    found = perimeters_um(labels, (1.0, 1.0))[1:]
    np.testing.assert_allclose(found, wanted["perimeter_crofton"])
    # An ellipse of half axes 30 and 20 in pixels of 1 x 2, against Ramanujan's second formula.
    y, x = np.indices((80, 40)) - np.array([40, 20])[:, None, None]
    ellipse = ((y / 30) ** 2 + (2 * x / 20) ** 2 < 1).astype(np.int32)
    h = ((30 - 20) / (30 + 20)) ** 2
    exact = np.pi * 50 * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h)))
    assert perimeters_um(ellipse, (1.0, 2.0))[1] == pytest.approx(exact, rel=0.03)
