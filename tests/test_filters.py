"""Compiled filters and patches against SciPy's and NumPy's, bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.unwrapping.filters import (
    average,
    correlate_nine,
    extent,
    fill_holes,
    half_gaussian,
    median_of,
    middle_of,
    quantile_of,
    remove_specks,
    widened,
)
from napari_phase4d.unwrapping.frames import border_of, centre
from napari_phase4d.unwrapping.objects import object_mask

SHAPES = [(135, 165), (64, 1), (3, 90), (7, 5), (2, 3), (1, 1)]


def frames(shape: tuple[int, int]) -> list[np.ndarray]:
    """Noise, noise with many equal numbers, nothing, and patches of all sizes."""
    generator = np.random.default_rng(0)
    noise = 3 * generator.normal(size=shape)
    smooth = [9 * ndimage.gaussian_filter(noise, sigma) for sigma in (0.5, 1, 2, 4)]
    found = [noise, np.round(noise), np.zeros(shape), *smooth]
    return [frame.astype(np.float32) for frame in found]


@pytest.mark.parametrize("shape", SHAPES)
def test_filters_give_the_bits_of_scipy(shape: tuple[int, int]) -> None:
    for frame in frames(shape):
        found = np.empty_like(frame)
        correlate_nine(frame, np.float32(0), half_gaussian(), found)
        np.testing.assert_array_equal(found, ndimage.gaussian_filter(frame, 1.0))
        for size in (3, 5, 4):
            average(frame, size, found)
            np.testing.assert_array_equal(found, ndimage.uniform_filter(frame, size))


@pytest.mark.parametrize("shape", SHAPES)
def test_ranks_are_those_of_numpy(shape: tuple[int, int]) -> None:
    for frame in frames(shape):
        numbers = frame.ravel()
        for share in (0.995, 0.5, 0.1, 0.0, 1.0):
            exact = np.quantile(frame.astype(np.float64), share)
            rounded = np.spacing(np.abs(frame).max())  # float32; NumPy before 2.4 is off by more
            assert abs(quantile_of(numbers, share) - exact) <= rounded
            if np.lib.NumpyVersion(np.__version__) >= "2.4.0":
                assert quantile_of(numbers, share) == np.quantile(frame, share)
        assert middle_of(numbers) == np.median(frame)
        some = numbers[min(1, frame.size - 1) :]
        assert middle_of(some) == np.median(some)
        assert median_of(numbers.astype(">f4")) == np.median(frame)


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_patches_are_those_of_scipy(shape: tuple[int, int]) -> None:
    for frame in frames(shape):
        for mask in (frame > 0, frame > 1, frame < 9, frame > 99):
            top, bottom, left, right = extent(mask, 0)
            assert not mask.any() or mask[top:bottom, left:right].sum() == mask.sum()
            filled = mask.copy()
            fill_holes(filled)
            np.testing.assert_array_equal(filled, ndimage.binary_fill_holes(mask))
            large = mask.copy()
            remove_specks(large, 7)
            labels, _ = ndimage.label(mask)
            sizes = np.bincount(labels.ravel())
            np.testing.assert_array_equal(large, mask & (sizes >= 7)[labels])
            wider = ndimage.binary_dilation(mask, iterations=2)
            np.testing.assert_array_equal(widened(mask, 2), wider)


def plain_object_mask(unwrapped: np.ndarray) -> np.ndarray:
    """What `object_mask` does, in the words of SciPy."""
    edge = unwrapped[border_of(unwrapped.shape)]
    level = float(np.median(edge))
    noise = 1.4826 * float(np.median(np.abs(edge - level)))
    height = np.abs(ndimage.gaussian_filter(unwrapped - level, 1.0))
    above = height > max(0.1 * float(np.quantile(height, 0.995)), 4 * noise, 1e-3)
    above = ndimage.binary_fill_holes(above)
    labels, _ = ndimage.label(above)
    large = np.bincount(labels.ravel()) >= 0.002 * above.size
    above &= large[labels]
    if not above.any() or above[border_of(above.shape)].mean() > 0.5:
        return np.ones(above.shape, dtype=bool)
    return ndimage.binary_dilation(above, iterations=2)


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("shape", sorted(p4d.simulation.SHAPES))
def test_masks_are_those_of_scipy(shape: str, noise: float) -> None:
    exact = p4d.simulation.moving_shape(shape, (96, 128), 3)["phase"].values
    phase = exact + np.random.default_rng(0).normal(0, noise, exact.shape)
    found = 0
    for frame in phase.astype(np.float32).reshape(-1, 96, 128):
        mask = object_mask(frame)
        np.testing.assert_array_equal(mask, plain_object_mask(frame))
        found += not mask.all()
        y, x = np.nonzero(mask)
        expected = (np.nan, np.nan) if mask.all() else (y.mean(), x.mean())
        np.testing.assert_allclose(centre(mask), expected, rtol=1e-14)
    assert found  # there is an object in some


def test_a_single_frame_is_unwrapped_without_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def started(*_: object) -> None:
        msg = "a thread was started"
        raise AssertionError(msg)

    monkeypatch.setattr("threading.Thread.start", started)
    frame = wrap(frames((135, 165))[6])
    for method in ("spatial-2d", "temporal-angular"):
        assert p4d.unwrap(frame, method).shape == frame.shape
