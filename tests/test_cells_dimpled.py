"""Red blood cells: thin in their middle, which is no gap; the gap between two of them is one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import napari_phase4d as p4d

SHAPE = (96, 128)


def discocyte(
    y: float, x: float, radius: float, dimple: float, stretch: float = 1.0
) -> np.ndarray:
    """Return the phase of a red blood cell, whose middle has such a share of what its rim has."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    r = np.hypot((rows - y) * stretch, (columns - x) / stretch) / radius
    inside = np.sqrt(np.clip(1 - r**2, 0, None))
    # The form of Evans and Fung, with the middle as thin as is asked for.
    form = inside * (dimple + 2.6 * r**2 - 1.6 * r**4)
    return 3.0 * form / form.max()


def count_of(phase: np.ndarray, noise: float, blur: float) -> int:
    """Return how many cells are found in each of some noisy frames, if it is the same in all."""
    counts = set()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        seen = ndimage.gaussian_filter(phase, blur) + rng.normal(0, noise, phase.shape)
        counts.add(int(p4d.find_cells(seen.astype(np.float32)[None, None]).max()))
    (count,) = counts
    return count


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("dimple", [0.1, 0.4, 1.0])
@pytest.mark.parametrize("stretch", [1.0, 1.25])
def test_a_dimple_is_no_gap(noise: float, dimple: float, stretch: float) -> None:
    assert count_of(discocyte(48, 64, 16, dimple, stretch), noise, 1.0) == 1


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("apart", [28, 31])
@pytest.mark.parametrize("dimple", [0.3, 1.0])
def test_two_that_touch_are_two(noise: float, apart: float, dimple: float) -> None:
    """Blurred and in a halo, they have one outline, which is hardly narrower between them."""
    both = np.maximum(discocyte(48, 48, 14, dimple), discocyte(48, 48 + apart, 14, dimple))
    halo = np.maximum(ndimage.gaussian_filter(both, 5.0), ndimage.gaussian_filter(both, 1.2))
    assert count_of(halo, noise, 0.0) == 2
