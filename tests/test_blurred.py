"""Wrapped phase that was smoothed, resized, turned or averaged has lost turns: it is said."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d.stacks.numbers import share_of_blurred

SAID = "takes several pixels from pi to -pi"
Filter = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def binned(stack: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of two by two pixels."""
    return (stack[..., ::2, :] + stack[..., 1::2, :])[..., ::2] / 4 + (
        stack[..., ::2, :] + stack[..., 1::2, :]
    )[..., 1::2] / 4


#: What users do to pictures, along y and x or along time.
FILTERS: dict[str, Filter] = {
    "smoothed a little": lambda w: ndimage.gaussian_filter(w, (0, 0, 0.7, 0.7)),
    "smoothed": lambda w: ndimage.gaussian_filter(w, (0, 0, 1.0, 1.0)),
    "mean of 3 x 3": lambda w: ndimage.uniform_filter(w, (1, 1, 3, 3)),
    "enlarged": lambda w: ndimage.zoom(w, (1, 1, 1.5, 1.5), order=1),
    "enlarged by splines": lambda w: ndimage.zoom(w, (1, 1, 2.0, 2.0), order=3),
    "binned": binned,
    "turned": lambda w: ndimage.rotate(w, 10, axes=(2, 3), reshape=False, order=1, mode="nearest"),
    "shifted by a part of a pixel": lambda w: ndimage.shift(
        w, (0, 0, 0.4, 0.3), order=1, mode="nearest"
    ),
    "mean of two frames": lambda w: (w[1:] + w[:-1]) / 2,
}


def cell(noise: float) -> NDArray[np.float64]:
    """Wrapped phase of a cell that swims, with noise of so many radians."""
    exact = p4d.simulation.swimming_euglena((96, 128), 4, peak_rad=20)["phase"].values
    rng = np.random.default_rng(3)
    return wrap(exact + noise * rng.standard_normal(exact.shape)).astype(np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("name", FILTERS)
def test_wrapped_phase_that_was_worked_on_as_a_picture_is_said(name: str, noise: float) -> None:
    with pytest.warns(UserWarning, match=SAID):
        p4d.unwrap(np.clip(FILTERS[name](cell(noise)), -np.pi, np.pi), "spatial-2d")


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTERS)
def test_what_is_advised_is_right(name: str) -> None:
    """The same done to complex numbers keeps the turns, and nothing is said."""
    phasors = np.exp(1j * cell(0.2))
    worked = np.angle(FILTERS[name](phasors.real) + 1j * FILTERS[name](phasors.imag))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.unwrap(worked, "spatial-2d")


def test_a_turn_from_zero_on_is_looked_at_too() -> None:
    turn = np.mod(cell(0.2), 2 * np.pi)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.unwrap(turn, "spatial-2d")
    with pytest.warns(UserWarning, match=SAID):
        p4d.unwrap(ndimage.uniform_filter(turn, (1, 1, 3, 3)), "spatial-2d")


@pytest.mark.parametrize("noise", [0.0, 0.3, 0.5, 0.7, 1.0])
@pytest.mark.parametrize("slope", [0.1, 0.5, 1.0, 2.0, 3.0])
def test_slopes_and_noise_are_not_taken_for_it(slope: float, noise: float) -> None:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:128, :160]
    cone = slope * np.maximum(0, 50 - np.hypot(y - 64, x - 80))
    for exact in (slope * x + 0.01 * y, cone, 2.0 * cone + 3.1):
        frame = wrap(exact + noise * rng.standard_normal(exact.shape))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            p4d.unwrap(frame[None, None], "spatial-2d")


def honest() -> dict[str, NDArray[np.float64]]:
    """Return phase with rims between gentle parts: at some levels they look like jumps."""
    y, x = np.mgrid[:128, :128]
    disc = (np.hypot(y - 64, x - 64) < 35).astype(np.float64)
    scenes = {
        f"plate of {height} rad, edge {edge}": ndimage.gaussian_filter(height * disc, edge)[None]
        for height in (4.8, 6.0, 7.0)
        for edge in (0.7, 1.5)
    }
    scenes["yeast"] = p4d.simulation.budding_yeast(n_times=3)["phase"].values
    for peak in (4.5, 6.0, 12.0, 20.0):
        sample = p4d.simulation.swimming_euglena((96, 128), 2, peak_rad=peak)
        scenes[f"cell of {peak} rad"] = sample["phase"].values
    for shape in p4d.simulation.HARD_SHAPES:
        scenes[shape] = p4d.simulation.hard_shape(shape)["phase"].values
    return scenes


@pytest.mark.thorough
def test_rims_at_any_level_of_the_field_are_hardly_ever_taken_for_it() -> None:
    """At 2.2 to 2.8 rad a rim goes from near one end of the turn to near the other one."""
    rng, said = np.random.default_rng(7), []
    for exact in honest().values():
        for level in np.arange(-3.1, 3.2, 0.2):
            for noise in (0.0, 0.1, 0.2, 0.3):
                noisy = exact + level + noise * rng.standard_normal(exact.shape)
                said.append(share_of_blurred(wrap(noisy).ravel()) > 0)
    assert np.mean(said) < 0.004


def test_nothing_but_noise_is_not_taken_for_it() -> None:
    noise = np.random.default_rng(6).uniform(-np.pi, np.pi, (2, 1, 128, 128))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.unwrap(noise, "spatial-2d")


@pytest.mark.slow
def test_the_verdict_says_so_and_calls_no_result_safe() -> None:
    """It was WL1 with less than 0.01 % in doubt, of which a fifth of the cell was wrong."""
    smoothed = FILTERS["mean of 3 x 3"](cell(0.2))
    with pytest.warns(UserWarning, match=SAID):
        comparison = p4d.compare(smoothed, ["directional-l1", "spatial-2d"])
    verdict = comparison.verdict
    assert verdict.startswith("No result is safe: the wrapped phase seems to have been smoothed")
    assert not verdict.is_safe
    assert verdict.blurred_percent > 99
    assert p4d.compare(cell(0.2), ["directional-l1", "spatial-2d"]).verdict.blurred_percent == 0


def test_measured_phase_is_told_from_the_same_smoothed() -> None:
    with np.load(measured("unwrap/pyrate_cropA_shared.npz"), allow_pickle=False) as arrays:
        phase = np.where(arrays["valid"], arrays["wrapped"].astype(np.float64), np.nan)[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.unwrap(phase, "spatial-2d", mask=np.isfinite(phase))
    smoothed = ndimage.uniform_filter(np.nan_to_num(phase), (1, 1, 3, 3))
    with pytest.warns(UserWarning, match=SAID):
        p4d.unwrap(smoothed, "spatial-2d")
