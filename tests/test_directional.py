"""The project's own methods: their graph, their cuts, and what they find."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage, sparse
from scipy.sparse import csgraph

import napari_phase4d as p4d
from napari_phase4d.phasors import turned
from napari_phase4d.simulation import SHAPES, budding_yeast, moving_shape, with_noise
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED, Watch
from napari_phase4d.unwrapping.background import find_background
from napari_phase4d.unwrapping.directional import bunches, following
from napari_phase4d.unwrapping.directional.bunches import Bunch
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.graph import islands_by_node, number_islands
from napari_phase4d.unwrapping.directional.groups import PARTS, Edges, merged_edges
from napari_phase4d.unwrapping.directional.least_turns import (
    LeastTurns,
    Limit,
    graph_of_pairs,
    sink_side,
)
from napari_phase4d.unwrapping.directional.methods import median_of, prepared
from napari_phase4d.unwrapping.directional.registration import (
    Seen,
    coherence_of,
    follow_object,
    looks_at,
    most_coherent,
)
from napari_phase4d.unwrapping.directional.scene import Scene, seams
from napari_phase4d.unwrapping.directional.steps import Floors, roughness
from napari_phase4d.unwrapping.given import WithoutLost, as_given, noise_of, sampled_noise
from napari_phase4d.unwrapping.problem import Problem

pytestmark = pytest.mark.slow

TURN = 2 * np.pi
CYCLE = TURN**2
OWN = ("directional-growing", "directional-l1")
PAPER = ("spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal")


class Still:
    """Frames of an object that are level already; a scene asks them for no more."""

    def __init__(self, phase: np.ndarray, empty: np.ndarray, amplitude: object = None) -> None:
        self.shape, self.start = phase.shape, (0, 0)
        self.background = SimpleNamespace(noise=0.0)
        self._seen = phase, empty, np.ones(phase.shape, bool), amplitude

    def read(self, block: Block, *, amplitude: bool = False) -> Seen:
        own = slice(block.start, block.stop)
        return Seen(*(part if part is None else part[own] for part in self._seen))

    def read_free(self, block: Block) -> np.ndarray:
        return self.read(block).free


def turns_off(found: xr.DataArray, exact: xr.DataArray) -> np.ndarray:
    return np.round((found.values - exact.values) / TURN)


def squared_error(found: xr.DataArray, exact: xr.DataArray) -> float:
    return float(CYCLE * np.mean(turns_off(found, exact) ** 2))


# ---- what they find -------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 0.2, 0.5, 0.7])
@pytest.mark.parametrize("name", ["yeast", "dividing", "translating", "vacuole"])
def test_nearly_all_pixels_are_right(name: str, noise: float) -> None:
    exact = budding_yeast() if name == "yeast" else moving_shape(name)
    data = with_noise(exact, noise, drift_rad=0.2, seed=11)
    error = squared_error(p4d.unwrap(data["wrapped"], "directional-l1"), data["phase"])
    papers = [squared_error(p4d.unwrap(data["wrapped"], m), data["phase"]) for m in PAPER]
    assert error <= {0.0: 0.02, 0.2: 0.02, 0.5: 0.08, 0.7: 0.3}[noise]
    assert error <= min(papers)


@pytest.mark.parametrize("method", OWN)
def test_result_differs_from_the_input_by_whole_turns(method: str) -> None:
    data = with_noise(moving_shape("tumbling"), 0.3, drift_rad=0.5, seed=5)
    wrapped = data["wrapped"]
    before = wrapped.values.copy()
    turns = (p4d.unwrap(wrapped, method).values - wrapped.values) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)
    np.testing.assert_array_equal(wrapped.values, before)


@pytest.mark.thorough
@pytest.mark.parametrize("method", OWN)
def test_an_object_thinner_than_what_is_round_it(method: str) -> None:
    data = with_noise(moving_shape("swelling"), 0.3, seed=5)
    upright = p4d.unwrap(data["wrapped"], method).values
    mirrored = p4d.unwrap(-data["wrapped"], method).values
    np.testing.assert_allclose(mirrored, -upright, atol=1e-5)
    assert upright.max() > 20


def test_one_sided_mends_rims_only() -> None:
    """A rim of 5 rad beside a step that is too steep is taken for 5 - 2 pi without it."""
    data = budding_yeast()
    plain = p4d.unwrap(data["wrapped"], "directional-l1", one_sided=False)
    better = p4d.unwrap(data["wrapped"], "directional-l1")
    off, less = turns_off(plain, data["phase"]), turns_off(better, data["phase"])
    assert (off == -1).sum() > 2 * (less == -1).sum()
    assert (less != 0).sum() < (off != 0).sum()
    changed = plain.values != better.values
    assert 0 < changed.mean() < 0.005


def test_fading_amplitude_is_told_from_a_step() -> None:
    """A vortex pair in every frame, at which the field is zero; the amplitude shows where."""
    data = moving_shape("tumbling")
    field = np.exp(1j * data["phase"].values)
    y, x = np.mgrid[:64, :64]
    for sign, column in ((1, 28.5), (-1, 36.5)):
        z = (x - column) + 1j * sign * (y - 32.5)
        field = field * z / np.sqrt(np.abs(z) ** 2 + 6)
    wrapped = data["wrapped"].copy(data=np.angle(field).astype(np.float32))
    amplitude = wrapped.copy(data=np.abs(field).astype(np.float32))
    bright = amplitude.values > 0.5
    far = data["phase"].copy(data=np.angle(field * np.exp(-1j * data["phase"].values)))
    exact = data["phase"].values + far.values  # the phase of the pair, away from its cut

    def wrong(**more: object) -> int:
        found = p4d.unwrap(wrapped, "directional-l1", **more).values
        return int((np.abs(found - exact) > np.pi)[bright].sum())

    assert wrong(amplitude=amplitude) < 0.7 * wrong()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["swelling", "returning", "vacuole", "bending"])
def test_without_background_in_view(name: str) -> None:
    """The field lies inside the cell; the boundary frame gives the level."""
    exact = moving_shape(name, (96, 96))
    inside = (exact["phase"].values > 0.3).all((0, 1))
    rows, columns = np.nonzero(inside)
    half = min(np.ptp(rows), np.ptp(columns)) // 3
    y, x = int(rows.mean()), int(columns.mean())
    cut = exact.isel(y=slice(y - half, y + half), x=slice(x - half, x + half))
    data = with_noise(cut, 0.3, seed=3)
    found = p4d.unwrap(data["wrapped"], "directional-l1", boundary=(0, 0))
    flat = p4d.unwrap(data["wrapped"], "spatial-2d")
    off = turns_off(found, data["phase"])
    assert CYCLE * np.var(off) <= 0.02
    # Its level is that of the thin frame unwrapped by itself.
    assert np.median(found[0, 0] - flat[0, 0]) == 0


def test_a_plateau_taken_for_background_does_not_pull_the_cell_down() -> None:
    """The border of this crop runs through the cells, where they look as flat as the field."""
    exact = moving_shape("touching", (96, 96)).isel(y=slice(26, 71), x=slice(26, 71))
    data = with_noise(exact, 0.5, seed=2)
    taken = find_background(data["wrapped"].values).mask & (exact["phase"].values > 3)
    assert taken.sum() > 50
    assert squared_error(p4d.unwrap(data["wrapped"], "directional-l1"), data["phase"]) < 0.1


@pytest.mark.parametrize("method", OWN)
@pytest.mark.parametrize("sizes", [(1, 1), (1, 4), (2, 1), (2, 2), (20, 1), (20, 2)])
def test_few_times_and_few_angles(sizes: tuple[int, int], method: str) -> None:
    data = moving_shape("bending").isel(time=slice(sizes[0]), angle=slice(sizes[1]))
    found = p4d.unwrap(data["wrapped"], method)
    assert squared_error(found, data["phase"]) < 0.01


@pytest.mark.parametrize("method", OWN)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (3, 3)])
def test_tiny_frames(shape: tuple[int, int], method: str) -> None:
    w = np.random.default_rng(1).uniform(-np.pi, np.pi, (2, 2, *shape)).astype(np.float32)
    turns = (p4d.unwrap(w, method).values - w) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("method", OWN)
def test_what_is_alone_needs_no_other_methods_mask(method: str) -> None:
    """Run after others, with a mask to be found, it finds the same as alone."""
    data = with_noise(moving_shape("dividing"), 0.3, seed=4)["wrapped"]
    alone = p4d.unwrap(data, method, mask="auto")
    among = p4d.compare(data, ["temporal-angular", method], mask="auto").results[method]
    np.testing.assert_array_equal(alone.values, among.values)
    assert (alone.values == 0).mean() > 0.5


def test_parts_of_a_mask_keep_to_the_thin_frame() -> None:
    data = moving_shape("touching", n_times=8)
    mask = data["phase"].values > 1.5
    found = p4d.unwrap(data["wrapped"], "directional-l1", mask=mask)
    assert (found.values[~mask] == 0).all()
    off = turns_off(found, data["phase"])[mask]
    assert (off != 0).mean() < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("mask", ["auto", "given"])
@pytest.mark.parametrize("outside", ["nan", "garbage"])
def test_what_lies_outside_an_aperture_does_not_count(outside: str, mask: str) -> None:
    data = with_noise(moving_shape("swelling"), 0.5, seed=2)
    y, x = np.mgrid[:64, :64] - 31.5
    inside = np.broadcast_to(np.hypot(y, x) < 0.46 * 64, data["phase"].shape)
    rng = np.random.default_rng(0)
    values = rng.uniform(-np.pi, np.pi, inside.shape) if outside == "garbage" else np.nan
    wrapped = data["wrapped"].copy(data=np.where(inside, data["wrapped"], values).astype("f4"))
    if mask == "auto" and outside == "garbage":
        pytest.skip("nothing tells garbage from phase")
    chosen = inside if mask == "given" else "auto"
    error = {}
    for method in (*OWN, "temporal-angular"):
        found = p4d.unwrap(wrapped, method, mask=chosen)
        off = np.where(found.values == 0, 0, turns_off(found, data["phase"]))
        error[method] = CYCLE * np.mean(off[inside] ** 2)
    assert error["directional-l1"] < 0.05
    assert error["directional-l1"] < error["temporal-angular"]


def test_thin_objects_are_kept() -> None:
    exact = moving_shape("tumbling")
    thin = exact["phase"] * (0.6 / exact["phase"].values.max())
    found = p4d.unwrap(thin, "directional-l1", mask="auto").values
    assert found[0, 0].sum() == pytest.approx(thin.values[0, 0].sum(), rel=0.02)


@pytest.mark.thorough
def test_useless_amplitude_does_no_harm() -> None:
    data = with_noise(moving_shape("dividing"), 0.2, seed=2)
    plain = p4d.unwrap(data["wrapped"], "directional-l1").values
    for value in (0.0, np.nan, np.inf):
        amplitude = np.full(plain.shape, value)
        with pytest.warns(UserWarning, match="0 or not known everywhere"):
            found = p4d.unwrap(data["wrapped"], "directional-l1", amplitude=amplitude).values
        np.testing.assert_array_equal(found, plain)
    some = np.where(np.random.default_rng(0).random(plain.shape) < 0.6, np.nan, 100.0)
    found = p4d.unwrap(data["wrapped"], "directional-l1", amplitude=some)
    assert squared_error(found, data["phase"]) < 0.2


def test_noise_is_taken_off_without_background_in_view() -> None:
    """Else no step is certain, and the graph is as large as the recording."""
    exact = moving_shape("swelling", (96, 96)).isel(y=slice(33, 63), x=slice(33, 63))
    problem = Problem(with_noise(exact, 0.2, seed=1)["wrapped"])
    field = prepared(problem, UNWATCHED)
    assert not problem.background().mask.any()
    assert field.regions.n < 0.01 * problem.wrapped.size


# ---- the empty field ------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.3, 0.6])
def test_noise_is_measured(noise: float) -> None:
    data = with_noise(moving_shape("tumbling"), noise, seed=1)
    assert noise_of(data["wrapped"].values) == pytest.approx(noise, rel=0.15)


def shared_noise(shape: tuple[int, ...], width: float) -> np.ndarray:
    """Return noise that neighbours share, as in views with more pixels than the pupil asks for."""
    white = np.random.default_rng(5).standard_normal(shape)
    noise = ndimage.gaussian_filter(white, (0, 0, width, width))
    return noise / noise.std()


def measured_noise(wrapped: np.ndarray) -> float:
    given = as_given(wrapped.astype(np.float32), None)
    return sampled_noise(WithoutLost(given, np.zeros(wrapped.shape[:2], dtype=bool)))


@pytest.mark.parametrize("width", [0.8, 1.5, 2])
@pytest.mark.parametrize("noise", [0.15, 0.5])
def test_noise_that_neighbours_share_is_measured(noise: float, width: float) -> None:
    exact = moving_shape("tumbling")["phase"].values
    wrapped = np.angle(np.exp(1j * (exact + noise * shared_noise(exact.shape, width))))
    assert measured_noise(wrapped) == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize("noise", [0, 0.3])
@pytest.mark.parametrize("name", list(SHAPES))
def test_no_slope_or_level_is_taken_for_noise(name: str, noise: float) -> None:
    exact = moving_shape(name)
    for factor in (1, 1.5):
        thick = exact.assign(phase=np.float32(factor) * exact["phase"])
        wrapped = with_noise(thick, noise, drift_rad=3.0, seed=2)["wrapped"].values
        assert measured_noise(wrapped) == noise_of(wrapped)


@pytest.mark.parametrize("side", [8, 12])
def test_views_too_small_to_tell_noise_from_slopes_keep_what_neighbours_say(side: int) -> None:
    y, x = np.mgrid[:side, :side] / side
    slopes = [3 * np.sin(3 * (x + y) + 0.8 * t) for t in range(6)]
    wrapped = np.angle(np.exp(1j * np.array(slopes)[:, None]))
    assert measured_noise(wrapped) == noise_of(wrapped.astype(np.float32))


@pytest.mark.parametrize("method", ["directional-l1", "directional-growing"])
def test_noise_that_neighbours_share_hides_no_empty_field(method: str) -> None:
    """A cell as flat as the medium, and a turn above it, lies elsewhere in the second view."""
    y, x = np.mgrid[-40:40, -40:40] + 0.5
    frames = [
        [
            6.6 * (np.hypot(y - down, x - right - 0.5 * t) < 10)
            for down, right in ((-7, -5), (1, 4))
        ]
        for t in range(8)
    ]
    exact = ndimage.gaussian_filter(np.array(frames), (0, 0, 1.5, 1.5))
    exact += 0.5 * shared_noise(exact.shape, 0.8)
    wrapped = np.angle(np.exp(1j * exact)).astype(np.float32)
    off = np.round((p4d.unwrap(wrapped, method).values - exact) / (2 * np.pi))
    assert np.count_nonzero(off - off[:, :, :1, :1]) == 0


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 0.3, 0.7])
@pytest.mark.parametrize("name", list(SHAPES))
def test_empty_field_is_found_and_nothing_else(name: str, noise: float) -> None:
    exact = moving_shape(name)
    data = with_noise(exact, noise, drift_rad=1.0, seed=7)
    found = find_background(data["wrapped"].values)
    empty = exact["phase"].values == 0
    assert found.mask[empty].mean() > 0.85
    assert not found.mask[exact["phase"].values > 3].any()
    level = np.median(np.where(empty, data["phase"].values, np.nan)[..., :2, :], axis=(2, 3))
    assert np.abs(np.angle(np.exp(1j * (found.level - level)))).max() < 0.1 + noise / 3


def test_islands_are_numbered_by_frame() -> None:
    empty = np.zeros((2, 1, 4, 6), dtype=bool)
    empty[0, 0, :, :2] = empty[0, 0, :, 3:] = True
    empty[1, 0] = True
    each = np.stack([ndimage.label(frame[0])[0] - 1 for frame in empty])[:, None]
    known: dict[tuple[int, int], np.ndarray] = {}
    count, fields = number_islands(each, 5, (5, 0, 1), known, 1, each[0, 0].size)
    numbers = islands_by_node(each, 5, known)
    assert (numbers[~empty] == 0).all()
    assert (numbers[0, 0, :, 3:] == 0).all()  # the one that is held
    own = {int(numbers[0, 0, 0, 0]), int(numbers[1, 0, 0, 0])}
    assert len(own) == 2
    assert own < set(range(1, count))
    # The largest of each other frame is the field.
    assert fields == [int(numbers[1, 0, 0, 0])]
    assert number_islands(np.full((1, 1, 2, 2), -1), 0, None, {}, 1, 4) == (1, [])


def test_a_moving_object_is_followed() -> None:
    frame = np.zeros((30, 30), dtype=np.float32)
    frame[10:16, 4:12] = np.random.default_rng(0).uniform(0.5, 2, (6, 8))
    ways = [(0, 0), (1, 1), (2, 2), (2, 4), (3, 5)]
    stack = np.stack([np.roll(frame, way, (0, 1)) for way in ways])[:, None]
    shifts = follow_object(Still(stack, stack == 0), Watch(1, ""))
    assert shifts[:, 0].tolist() == [[-dy, -dx] for dy, dx in ways]


@pytest.mark.parametrize("step", [(0, 0), (1, -2), (-9, 13)])
def test_coherence_is_the_mean_phasor_round_each_pixel(step: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    phase = rng.normal(0, 1, (2, 2, 23, 31)).astype(np.float32)
    empty = np.ones(phase.shape, dtype=bool)
    empty[..., 3:17, 9:28] = rng.random((2, 2, 14, 19)) < 0.2
    now, before = looks_at(Seen(phase, empty, np.ones_like(empty), None))
    total, count = coherence_of(now, before, np.array(step))
    moved = np.roll(phase[0], step, (1, 2)), np.roll(~empty[0], step, (1, 2))
    either = moved[1] | ~empty[1]
    phasor = np.exp(1j * (moved[0] - phase[1])) * either
    square = np.ones((1, 7, 7))
    number = np.maximum(ndimage.convolve(either.astype(float), square, mode="constant"), 1)
    mean = np.abs(ndimage.convolve(phasor, square, mode="constant")) / number
    assert count == either.sum()
    np.testing.assert_allclose(total, mean[either].sum(), rtol=1e-5)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_an_object_that_grows_fast_is_not_moved(noise: float) -> None:
    """A shift that lowers one rim would make up for some of what it grows by."""
    exact = moving_shape("returning")["phase"] * np.float32(1.5)
    rng = np.random.default_rng(1)
    phase = (exact + rng.normal(0, noise, exact.shape)).values.astype(np.float32)
    still = Still(turned(phase), exact.values < 0.05)
    still.background.noise = noise
    assert (follow_object(still, Watch(1, "")) == 0).all()


def test_to_move_must_be_worth_it() -> None:
    """By 0.03 and 0.005 a pixel, where there is no noise; by exp(-0.25) of it at 0.5 rad."""
    tried = [np.array(shift) for shift in ((0, 0), (0, 0), (1, -2))]
    for noise, worth in ((0.0, 0.045), (0.5, 0.045 * math.exp(-0.25))):
        for more, moved in ((0.001, True), (-0.001, False)):
            coherence = [0.5, 0.5, 0.5 + worth + more]
            found = most_coherent(tried, coherence, tried[0], noise)
            assert (found.tolist() == [1, -2]) == moved


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_a_thick_cell_that_moves_and_grows_is_followed(noise: float) -> None:
    y, x = np.mgrid[:70, :70]
    rng = np.random.default_rng(1)
    ways = [(0, 0), (2, 1), (4, 2), (6, 4), (8, 5), (9, 7)]
    height = [
        (18 + 4 * t) * np.sqrt(np.maximum(1 - ((y - 25 - dy) ** 2 + (x - 25 - dx) ** 2) / 225, 0))
        for t, (dy, dx) in enumerate(ways)
    ]
    phase = np.stack(height)[:, None]
    noisy = (phase + rng.normal(0, noise, phase.shape)).astype(np.float32)
    still = Still(turned(noisy), phase == 0)
    still.background.noise = noise
    found = follow_object(still, Watch(1, ""))[:, 0]
    assert found.tolist() == [[-dy, -dx] for dy, dx in ways]


def test_seams_part_what_came_from_the_other_side() -> None:
    shifts = np.array([[[1, 0]], [[0, -2]]])
    numbers = seams(shifts, (4, 5))
    assert numbers.shape == (2, 1, 4, 5)
    assert numbers[0, 0, 0, 0] != numbers[0, 0, 1, 0] == numbers[0, 0, 3, 0]
    assert numbers[1, 0, 0, 2] != numbers[1, 0, 0, 3]


# ---- steps and turns ------------------------------------------------------------------------


def test_roughness_by_its_formula() -> None:
    rng = np.random.default_rng(3)
    step = rng.normal(0, 1, (4, 3, 6, 5)).astype(np.float32)
    none = np.zeros(step.shape, dtype=bool)
    change = np.empty(step.shape)
    for index in np.ndindex(*step.shape):
        j, n = index[2], step.shape[2]
        ahead, behind = min(j + 1, n - 1), max(j - 1, 0)
        line = step[index[0], index[1], :, index[3]]
        after = abs(line[ahead] - line[j]) if ahead != j else abs(line[j] - line[behind])
        before = abs(line[j] - line[behind]) if behind != j else after
        change[index] = after + before
    mean = np.zeros(step.shape)
    for offset in itertools.product((-1, 0, 1), repeat=4):
        near = [
            np.pad(np.arange(n), 1, mode="symmetric")[1 + o : 1 + o + n]
            for n, o in zip(step.shape, offset, strict=True)
        ]
        mean += change[np.ix_(*near)] ** 2 / 81
    np.testing.assert_allclose(roughness(step, 2, ~none, 0.0), np.sqrt(mean), rtol=1e-4)
    floor = (change**2).mean()
    expected = np.sqrt(np.maximum(mean - floor, 0))
    np.testing.assert_allclose(roughness(step, 2, ~none, floor), expected, atol=1e-3)


@pytest.mark.parametrize("frames", [1, 2])
def test_steps_join_neighbours_only(frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "is_thin", lambda *_: False)  # so that all count the same
    rng = np.random.default_rng(4)
    phase = rng.uniform(-3, 3, (2, 2, 3, 3)).astype(np.float32)
    faint = np.full(phase.shape, 0.5, dtype=np.float32)
    rough = []
    for amplitude in (None, faint):
        still = Still(phase, np.zeros(phase.shape, bool), amplitude)
        scene = Scene(still, np.zeros((2, 2, 2), np.intp), (slice(0, 3), slice(0, 3)))
        floors = Floors(dict.fromkeys(range(4), 0.0), dict.fromkeys((2, 3), (0.0, 1.0)))
        parts = list(followed_steps(scene, floors, Watch(1, ""), frames=frames))
        for axis, count in enumerate((2 * 9, 2 * 9, 4 * 6, 4 * 6)):
            turns = np.concatenate([part.by_axis[axis].turns for part in parts])
            asked = -np.round(np.diff(phase, axis=axis) / TURN)
            assert turns.size == count
            np.testing.assert_array_equal(turns, asked)
        rough.append(np.concatenate([o.rough.ravel() for p in parts for o in p.by_axis.values()]))
    np.testing.assert_allclose(rough[1], rough[0] + 2, rtol=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["directional-l1", "directional-growing"])
def test_regions_may_be_solved_in_bunches(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What hangs together only through the empty field is solved apart, to the same turns."""
    data = with_noise(moving_shape("dividing"), 0.6, seed=4)["wrapped"]
    found = []
    for regions in (1, 10**9):
        monkeypatch.setattr(bunches, "BUNCH_REGIONS", regions)
        field = prepared(Problem(data), UNWATCHED)
        some = field.regions.bunches
        # Every region but the one that is held is in one bunch, with all its edges.
        assert sorted(some.members) == sorted({*range(field.regions.n)} - {some.held})
        found.append((len(some), sum(len(some.read(k).edges) for k in range(len(some)))))
        found.append(p4d.unwrap(data, method).values)
    assert found[0][0] > 10
    assert found[2][0] == 1
    assert found[0][1] == found[2][1]
    np.testing.assert_array_equal(found[1], found[3])


def test_bunches_do_not_depend_on_how_edges_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a long recording is cut decides how many edges are put together on the way."""
    monkeypatch.setattr(bunches, "BUNCH_REGIONS", 4)
    pairs = np.array([(1, 2), (0, 2), (3, 4), (0, 4), (5, 6), (6, 7), (8, 0)], dtype=np.int32)
    found = []
    for times in (1, 9):
        ends = np.repeat(pairs, times, axis=0) if times > 1 else pairs
        one = np.ones(len(ends), dtype=np.int64)
        edges = Edges(*ends.T, one.astype(np.int32), one, one, one.astype(np.float32))
        found.append(bunches.numbers_of_bunches(iter([edges]), 9, 0))
    np.testing.assert_array_equal(*found)
    assert found[0].tolist() == [-1, 0, 0, 0, 0, 1, 1, 1, 1]


def test_loose_parts_may_be_counted_from_anywhere() -> None:
    """A half between two turns is rounded to the same one."""
    for base in (0, 1, -7):
        said = np.array([(0, base + 2, 5), (0, base + 3, 5)])
        assert median_of(said) - base == 3


def test_cut_is_as_small_as_scipys() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        n = int(rng.integers(2, 25))
        pairs = [(a, b) for a in range(n) for b in range(a + 1, n) if rng.random() < 0.4]
        if not pairs:
            continue
        first, second = np.array(pairs, dtype=np.int32).T
        start, head, reverse, place = graph_of_pairs(first, second, n)
        capacity = np.zeros(2 * len(pairs))
        forth, back = rng.integers(0, 20, (2, len(pairs)))
        capacity[place[: len(pairs)]], capacity[place[len(pairs) :]] = forth, back
        source, sink = rng.integers(0, 20, (2, n))
        side = sink_side(start, head, reverse, capacity, source.astype(float), sink.astype(float))
        # What the cut costs is the largest flow.
        cost = source[side].sum() + sink[~side].sum()
        cost += forth[~side[first] & side[second]].sum() + back[side[first] & ~side[second]].sum()
        rows = [*first, *second, *[n] * n, *range(n)]
        columns = [*second, *first, *range(n), *[n + 1] * n]
        values = np.array([*forth, *back, *source, *sink], dtype=np.int32)
        graph = sparse.csr_array((values, (rows, columns)), shape=(n + 2, n + 2))
        assert cost == csgraph.maximum_flow(graph, n, n + 1).flow_value


def test_turns_of_least_cost_are_found() -> None:
    """Against all of them, on graphs so small that they can be counted."""
    rng = np.random.default_rng(7)
    n = 5
    for trial in range(12):
        pairs = np.array(list(itertools.combinations(range(n), 2)), dtype=np.int32)
        turns = rng.integers(-2, 3, len(pairs))
        weight = rng.uniform(0.1, 1, len(pairs))
        costs = np.round(PARTS * weight).astype(np.int64)
        edges = merged_edges(
            pairs[:, 0], pairs[:, 1], turns, costs, costs, weight.astype(np.float32)
        )
        bunch = Bunch(np.arange(n, dtype=np.int32), 0, 0, edges)
        limit = None
        if trial % 2:
            lowest = rng.integers(-1, 2, n)
            price = PARTS * rng.uniform(0, 2, n)
            limit = Limit(np.arange(n), lowest, price, int(rng.choice([-1, 1])))
        solver = LeastTurns(bunch, lambda: None)
        _, start = solver.start()
        assert start[0] == 0
        found = solver.descend(start, limit)
        costs = [
            solver.cost(np.array([0, *k])) for k in itertools.product(range(-4, 5), repeat=n - 1)
        ]
        assert found[0] == 0
        assert solver.cost(found) == pytest.approx(min(costs))
