"""What finding cells does faster than the libraries gives what they give, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from napari_phase4d.analysis.cell_frames import opened, without_holes
from napari_phase4d.analysis.cell_tracks import tracks_by_links
from napari_phase4d.unwrapping import median_of


@pytest.mark.parametrize("share", [0.02, 0.4, 0.6, 0.9, 0.999])
@pytest.mark.parametrize("shape", [(40, 57), (3, 9), (1, 5), (128, 128)])
def test_masks_are_opened_and_filled_as_scipy_does(share: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    for grain in (0.0, 1.5):
        field = ndimage.gaussian_filter(rng.normal(size=shape), grain)
        mask = field < np.quantile(field, share)
        np.testing.assert_array_equal(opened(mask), ndimage.binary_opening(mask))
        np.testing.assert_array_equal(without_holes(mask), ndimage.binary_fill_holes(mask))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 4095, 4096, 30_001, 30_002])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_median_is_that_of_numpy(size: int, dtype: type) -> None:
    rng = np.random.default_rng(size)
    values = rng.normal(size=size).astype(dtype)
    lopsided = np.sort(np.abs(values)) ** 3  # some of them say nothing of the others
    for given in (values, lopsided, np.round(values), np.zeros_like(values)):
        assert median_of(given) == float(np.median(given))
    values[size // 2] = np.nan
    assert np.isnan(median_of(values))


def test_tracks_end_where_a_cell_divides() -> None:
    #: 0 -> 2 -> 4 and 5; 1 -> 3; 5 -> 6 over a gap
    track, divisions = tracks_by_links(7, [(0, 2), (1, 3), (2, 4), (2, 5), (5, 6)])
    assert track.tolist() == [0, 1, 0, 1, 2, 3, 3]
    assert divisions == [(2, 0), (3, 0)]
