"""What holds for any phase: properties of unwrapping, on examples that hypothesis makes up.

Two kinds of phase are used. *Noise* has no right answer, but rules of arithmetic hold on it: whole
turns, nothing outside the mask, the same answer for the same numbers in another form. A *gentle*
phase is steep, but nowhere rises by more than half a turn from one sample to the next along any
axis (Itoh's condition): its unwrapped phase is known but for one multiple of 2 pi. Flips,
transposes, reversals and phases plus a constant are gentle as well, so that an exact answer on all
of them is invariance under all of these. The own methods take what is flat at the border for empty
field, and are asked for a gentle *cell*, which lies in one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import napari_phase4d as p4d
from helpers import wrap
from made_up import (
    EXAMPLES,
    Case,
    gentle,
    gentle_cell,
    noise,
    quick,
    same_but_for_one_number,
    turns_between,
)
from napari_phase4d.unwrapping import methods_for

#: Some noise that is made up here looks as if it had been cut out, or were of other units.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:phase (is just|jumps by)"),
]

TURN = 2 * np.pi
DIMS = ("time", "angle", "y", "x")
METHODS = tuple(methods_for(None))
#: The raw estimate of LBE differs from the wrapped phase by other than whole turns, as documented.
CONGRUENT = tuple(m for m in METHODS if m != "laplacian")
#: DE leaves the boundary frame wrapped, as published, so that it has to be thin; LBE estimates.
EXACT_WHEN_GENTLE = tuple(m for m in CONGRUENT if m != "dilate-erode")
OWN = ("directional-growing", "directional-l1")
CHAINED = ("angular", "temporal", "temporal-angular", "angular-temporal")
TIME, ANGLE, Y, X = range(4)


@pytest.mark.thorough
@pytest.mark.parametrize("method", CONGRUENT)
@quick
@given(case=noise(), kept=st.sampled_from([1.0, 0.9, 0.5, 0.1]))
def test_result_is_whole_turns_inside_the_mask_and_zero_outside(
    method: str, case: Case, kept: float
) -> None:
    mask = np.random.default_rng(case.seed).random(case.phase.shape) < kept
    assume(mask.any())
    found = p4d.unwrap(case.phase, method, case.boundary, mask=mask)
    assert found.dtype == np.float32
    assert found.dims == DIMS
    turns_between(found.values[mask], case.phase[mask])
    assert (found.values[~mask] == 0).all()


@pytest.mark.parametrize("variant", ["laplacian", "region-growing", "dilate-erode"])
@quick
@given(case=noise())
def test_variants_are_congruent_too(variant: str, case: Case) -> None:
    options = {
        "laplacian": {"rounded": True, "variant": "phasetools"},
        "region-growing": {"variant": "phasetools"},
        "dilate-erode": {"variant": "phasetools", "max_window": 1},
    }
    found = p4d.unwrap(case.phase, variant, case.boundary, **options[variant])
    turns_between(found.values, case.phase)


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@quick
@given(case=noise(), masked=st.booleans(), faded=st.booleans())
def test_nothing_that_is_given_is_changed(
    method: str, case: Case, masked: bool, faded: bool
) -> None:
    """Read-only arrays would raise where anything is written; their numbers are compared too."""
    rng = np.random.default_rng(case.seed)
    given_arrays: dict[str, Any] = {"phase": case.phase}
    if masked:
        given_arrays["mask"] = rng.random(case.phase.shape) < 0.9
        given_arrays["mask"][0, 0, 0, 0] = True
    if faded:
        given_arrays["amplitude"] = rng.random(case.phase.shape).astype(np.float32)
    before = {name: array.copy() for name, array in given_arrays.items()}
    for array in given_arrays.values():
        array.flags.writeable = False
    found = p4d.unwrap(**given_arrays, method=method, boundary=case.boundary)
    for name, array in given_arrays.items():
        np.testing.assert_array_equal(array, before[name])
    assert not np.shares_memory(found.values, case.phase)


def in_other_forms(phase: np.ndarray) -> dict[str, Any]:
    """Return the same numbers in other types, layouts and orders."""
    wide = np.zeros((*phase.shape[:3], 2 * phase.shape[3]), phase.dtype)
    wide[..., ::2] = phase
    named = xr.DataArray(phase, dims=DIMS)
    return {
        "double": phase.astype(np.float64),
        "big-endian": phase.astype(">f4"),
        "Fortran": np.asfortranarray(phase),
        "every second": wide[..., ::2],
        "backwards": np.ascontiguousarray(phase[:, ::-1, :, ::-1])[:, ::-1, :, ::-1],
        "masked layout": np.ascontiguousarray(phase.transpose(3, 1, 0, 2)).transpose(2, 1, 3, 0),
        "named": named,
        "named in another order": named.transpose("x", "time", "y", "angle"),
        "lazy": named.chunk({"time": 1}),
    }


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@quick
@given(case=noise())
def test_same_numbers_give_the_same_result_in_any_form(method: str, case: Case) -> None:
    expected = p4d.unwrap(case.phase, method, case.boundary).values
    for form, phase in in_other_forms(case.phase).items():
        found = p4d.unwrap(phase, method, case.boundary)
        assert found.dims == (phase.dims if isinstance(phase, xr.DataArray) else DIMS)
        np.testing.assert_array_equal(found.transpose(*DIMS).values, expected, err_msg=form)


@pytest.mark.thorough
@quick
@given(case=noise(), dtype=st.sampled_from(["i1", "u1", ">i2", "u4", "i8", "f2"]))
def test_whole_numbers_are_radians(case: Case, dtype: str) -> None:
    phase = np.abs(case.phase).round().astype(dtype)
    for method in METHODS:
        found = p4d.unwrap(phase, method, case.boundary).values
        same = p4d.unwrap(phase.astype(np.float32), method, case.boundary).values
        np.testing.assert_array_equal(found, same)


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@quick
@given(case=noise(), faded=st.booleans())
def test_one_thread_gives_what_two_give(method: str, case: Case, faded: bool) -> None:
    amplitude = np.abs(case.phase) if faded else None
    found = [p4d.unwrap(case.phase, method, case.boundary, amplitude=amplitude) for _ in range(2)]
    xr.testing.assert_identical(*found)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("napari_phase4d.task.cores", lambda: 1)
        alone = p4d.unwrap(case.phase, method, case.boundary, amplitude=amplitude)
    xr.testing.assert_identical(alone, found[0])


@quick
@given(case=noise(), order=st.permutations(METHODS), count=st.integers(1, 5))
def test_methods_do_not_depend_on_what_else_is_compared(
    case: Case, order: list[str], count: int
) -> None:
    """They share their first steps, the memory of which may be used again."""
    comparison = p4d.compare(case.phase, order[:count], case.boundary)
    assert list(comparison.results) == order[:count]
    for method, found in comparison.results.items():
        xr.testing.assert_identical(found, p4d.unwrap(case.phase, method, case.boundary))


@pytest.mark.thorough
@pytest.mark.parametrize("cell", [False, True])
@pytest.mark.parametrize("method", EXACT_WHEN_GENTLE)
@settings(quick, max_examples=EXAMPLES + 4)
@given(data=st.data())
def test_gentle_phase_is_unwrapped_without_error(
    method: str, cell: bool, data: st.DataObject
) -> None:
    """Under Itoh's condition every way leads to the truth: no order, flip or constant counts.

    The level is that of the border: one multiple of 2 pi is open, for 3-D one of each angle.
    Waves have no centre that frames could be registered by; moved against each other they may
    not be gentle any more.
    """
    waves = not cell and method not in OWN
    case = data.draw(gentle() if waves else gentle_cell())
    wrapped = wrap(case.phase).astype(np.float32)
    options = {"registration": False} if waves and method in CHAINED else {}
    found = p4d.unwrap(wrapped, method, case.boundary, **options).values
    turns = np.round((found - case.phase) / TURN)
    if method == "spatial-3d":
        turns = turns - turns[:1, :, :1, :1]
    assert same_but_for_one_number(turns)
    # Half a turn, and what float32 and a median between two pixels may add. Volumes look at a rim
    # of one pixel, frames at one of two.
    width = 1 if method in ("region-growing", "spatial-3d") else 2
    rim = np.ones(found.shape[2:], dtype=bool)
    rim[width:-width, width:-width] = False
    assert np.abs(np.median(found[case.boundary][rim])) < np.pi + 1e-3


@settings(quick, max_examples=3 * EXAMPLES)
@given(case=gentle())
def test_carrying_on_from_a_thin_frame_is_exact(case: Case) -> None:
    """DE leaves the boundary frame wrapped, so that it is exact where that one is thin."""
    thin = case.phase - case.phase[case.boundary].mean()
    assume(np.abs(thin[case.boundary]).max() < np.pi)
    found = p4d.unwrap(wrap(thin), "dilate-erode", case.boundary).values
    np.testing.assert_allclose(found, thin, atol=1e-4 * (1 + np.abs(thin).max()))


MOVES = {
    "flip y": lambda p: np.flip(p, Y),
    "flip x": lambda p: np.flip(p, X),
    "transpose": lambda p: p.swapaxes(Y, X),
    "reverse time": lambda p: np.flip(p, TIME),
    "reverse angles": lambda p: np.flip(p, ANGLE),
}


def moved_boundary(case: Case, move: str) -> tuple[int, int]:
    time, angle = case.boundary
    if move == "reverse time":
        time = case.phase.shape[0] - 1 - time
    if move == "reverse angles":
        angle = case.phase.shape[1] - 1 - angle
    return time, angle


@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("method", ["spatial-2d", "region-growing", "spatial-3d"])
@quick
@given(case=noise(smallest=3, ties=False))
def test_reliability_sorting_has_the_symmetries_of_the_grid(
    method: str, move: str, case: Case
) -> None:
    """On pure noise too, with two exceptions, which are ties.

    Corners of frames have no reliability and no neighbour that has one, so that the order of the
    steps to them is open. And where values repeat, so do costs.
    """
    change = MOVES[move]
    expected = p4d.unwrap(case.phase, method, case.boundary).values
    there = p4d.unwrap(change(case.phase), method, moved_boundary(case, move)).values
    turns = turns_between(change(there), expected)
    turns[..., :: turns.shape[2] - 1, :: turns.shape[3] - 1] = np.nan
    parts = {"spatial-2d": (TIME, ANGLE), "spatial-3d": (ANGLE,), "region-growing": ()}[method]
    for index in np.ndindex(*(turns.shape[axis] for axis in parts)):
        at = dict(zip(parts, index, strict=True))
        part = turns[tuple(at.get(axis, slice(None)) for axis in range(4))]
        assert same_but_for_one_number(part[np.isfinite(part)])


@pytest.mark.parametrize("move", MOVES)
@quick
@given(case=noise())
def test_estimate_has_the_symmetries_of_the_grid(move: str, case: Case) -> None:
    change = MOVES[move]
    expected = p4d.unwrap(case.phase, "laplacian", case.boundary).values
    there = p4d.unwrap(change(case.phase), "laplacian", moved_boundary(case, move)).values
    np.testing.assert_allclose(change(there), expected, atol=2e-4)


@quick
@given(case=noise(), constant=st.floats(-10, 10))
def test_estimate_moves_with_a_constant(case: Case, constant: float) -> None:
    """LBE sees differences only; the constant is that of the wrapped border."""
    first = p4d.unwrap(case.phase, "laplacian", case.boundary).values
    second = p4d.unwrap(wrap(case.phase + constant), "laplacian", case.boundary).values
    off = second - first
    np.testing.assert_allclose(off, np.median(off), atol=2e-4)


@quick
@given(case=noise())
def test_frames_and_angles_by_themselves(case: Case) -> None:
    """2-D knows nothing of other frames, 3-D nothing of other angles."""
    flat = p4d.unwrap(case.phase, "spatial-2d", case.boundary).values
    deep = p4d.unwrap(case.phase, "spatial-3d", case.boundary).values
    time, angle = case.boundary
    alone = p4d.unwrap(case.phase[time, angle], "spatial-2d").values
    assert same_but_for_one_number(turns_between(flat[time, angle], alone))
    volume = p4d.unwrap(case.phase[:, angle : angle + 1], "spatial-3d", (time, 0)).values[:, 0]
    np.testing.assert_array_equal(deep[:, angle], volume)


@quick
@given(case=gentle())
def test_time_and_angle_can_change_places(case: Case) -> None:
    wrapped = wrap(case.phase).astype(np.float32)
    turned, boundary = wrapped.swapaxes(TIME, ANGLE), case.boundary[::-1]
    for one, other in (("temporal", "angular"), ("temporal-angular", "angular-temporal")):
        expected = p4d.unwrap(wrapped, one, case.boundary, registration=False).values
        found = p4d.unwrap(turned, other, boundary, registration=False).values
        np.testing.assert_array_equal(found.swapaxes(TIME, ANGLE), expected)
