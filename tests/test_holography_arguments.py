"""Arguments that make no sense are refused in one sentence."""

from __future__ import annotations

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe
from napari_phase4d.io import RawLayout

LOBES = [Lobe((0.2, 0.2), 0.15)]


def video() -> p4d.Recording:
    return p4d.open_recording(np.random.default_rng(0).integers(0, 99, (2, 48, 48), np.uint8))


@pytest.mark.parametrize("order", ["3", 2.7, True, None])
def test_order_is_a_whole_number(order: object) -> None:
    with pytest.raises(ValueError, match="background_order must lie between 1 and 8, a whole"):
        p4d.reconstruct(video(), LOBES, background="zernike", background_order=order)


@pytest.mark.parametrize("distance", [True, [1], "there", (2.0,)])
def test_distance_is_a_number(distance: object) -> None:
    with pytest.raises(ValueError, match="refocus_um must be a number of micrometres"):
        p4d.reconstruct(video(), LOBES, refocus_um=distance)


@pytest.mark.parametrize("height", ["5", 5.5, True])
def test_raw_sizes_are_whole_numbers(height: object) -> None:
    with pytest.raises(TypeError, match="height of raw frames must be a whole number, but is"):
        RawLayout(height, 5)
