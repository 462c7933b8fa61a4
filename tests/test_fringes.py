"""Pixels without fringes: the phase there is noise, and is marked as such."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import scipy.ndimage

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.holography import Lobe, fringe_mask, reconstruction_advice

LOBES = [Lobe((0.1875, 0.21875), 0.1)]
SHAPE = (320, 384)
#: Pixels by which the lobe blurs an edge, and the border, where the transform repeats itself.
BLUR = 4


def hologram(lit: np.ndarray, phase: np.ndarray | float = 0.0, noise: float = 3.0) -> np.ndarray:
    """Fringes on grey, as strong in each pixel as it is lit, with camera noise."""
    y, x = np.indices(SHAPE)
    ((ky, kx),) = (lobe.carrier for lobe in LOBES)
    fringes = np.cos(2 * np.pi * (ky * y + kx * x) + phase)
    grey = 100 + 60 * lit * fringes + np.random.default_rng(3).normal(0, noise, SHAPE)
    return np.clip(grey, 0, 255).round().astype(np.uint8)


def half(share: float) -> np.ndarray:
    return (np.arange(SHAPE[1]) >= share * SHAPE[1]) * np.ones(SHAPE)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_the_part_without_fringes_is_marked(share: float) -> None:
    rec = p4d.open_recording(hologram(half(share))[None])
    with pytest.warns(UserWarning, match=r"\d+ % of view 1 shows? no fringes"):
        data = p4d.reconstruct(rec, LOBES)
    seen = fringe_mask(data).values[0, 0]
    edge = share * seen.shape[1]
    most = 100 * 2 * BLUR / seen.shape[1]
    assert data.attrs["without_fringes_percent"][0] == pytest.approx(100 * share, abs=most)
    dark, lit = slice(BLUR, int(edge) - BLUR), slice(int(edge) + BLUR, -BLUR)
    assert not seen[:, dark].any()
    assert seen[:, lit].all()
    assert np.abs(data.phase.values[0, 0, :, lit]).max() < 0.5
    assert np.abs(data.phase.values[0, 0, :, dark]).max() > 2  # it is noise there
    assert len(reconstruction_advice(data.attrs)) == 1


@pytest.mark.parametrize("visibility", [1.0, 0.3, 0.1])
@pytest.mark.parametrize("tall_rad", [0.0, 6.0, 15.0])
def test_objects_and_weak_fringes_are_not(visibility: float, tall_rad: float) -> None:
    y, x = np.indices(SHAPE)
    cell = np.sqrt(np.clip(1 - ((y - 160) / 80) ** 2 - ((x - 180) / 110) ** 2, 0, None))
    rec = p4d.open_recording(hologram(np.full(SHAPE, visibility), tall_rad * cell, 1.0)[None])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = p4d.reconstruct(rec, LOBES)
    assert data.attrs["without_fringes_percent"][0] < 0.5


def test_a_dark_cell_is_still_measured() -> None:
    y, x = np.indices(SHAPE)
    cell = ((y - 160) / 80) ** 2 + ((x - 180) / 110) ** 2 < 1
    rec = p4d.open_recording(hologram(np.where(cell, 0.15, 1.0), 2.0 * cell, 1.0)[None])
    data = p4d.reconstruct(rec, LOBES)
    middle = tuple(n // 2 for n in data.phase.shape[2:])
    assert fringe_mask(data).values[(0, 0, *middle)]
    assert wrap(data.phase.values[(0, 0, *middle)] - 2.0) == pytest.approx(0, abs=0.1)


@pytest.mark.filterwarnings("ignore:.*1 frame of 4 left out as lost")
def test_lost_frames_show_none_and_the_mask_serves_to_unwrap() -> None:
    frame = hologram(half(0.3))
    rec = p4d.open_recording(np.stack([frame, frame, np.zeros_like(frame), frame]))
    with pytest.warns(UserWarning, match="shows? no fringes"):
        data = p4d.reconstruct(rec, LOBES)
    seen = fringe_mask(data)
    assert not seen[2].any()
    found = p4d.unwrap(data.phase, "spatial-2d", mask=seen)
    assert np.isnan(found.values[2]).all()
    assert (found.values[0][~seen.values[0]] == 0).all()
    lit = slice(int(0.3 * seen.shape[3]) + BLUR, -BLUR)
    assert np.abs(found.values[0, 0, :, lit]).max() < 0.5


@pytest.mark.parametrize("level", [6.0, 100.0])
def test_a_view_of_nothing_but_noise_shows_none(level: float) -> None:
    """Some of noise is bright as well, next to the rest of it."""
    noise = np.random.default_rng(1).normal(level, 2, (1, *SHAPE))
    rec = p4d.open_recording(np.clip(noise, 0, 255).round().astype(np.uint8))
    with pytest.warns(UserWarning, match="noise"):
        data = p4d.reconstruct(rec, LOBES)
    assert data.attrs["without_fringes_percent"] == [100.0]
    assert not fringe_mask(data).any()


def test_a_small_opening_shows_its_fringes() -> None:
    """Where most of the view is dark, what is not still counts."""
    rec = p4d.open_recording(hologram(half(0.8))[None])
    with pytest.warns(UserWarning, match=r"\d+ % of view 1 shows? no fringes"):
        data = p4d.reconstruct(rec, LOBES)
    seen = fringe_mask(data).values[0, 0]
    assert seen[:, int(0.85 * seen.shape[1]) : -BLUR].all()


@pytest.mark.parametrize(("apart", "peak_rad"), [(34, 8.0), (34, 6.0), (26, 5.0)])
def test_a_dense_layer_of_steep_cells_shows_its_fringes(apart: int, peak_rad: float) -> None:
    """They are no more alike to themselves some pixels on than noise is, but as bright."""
    y, x = np.indices(SHAPE)
    layer = np.zeros(SHAPE)
    for cy in range(8, SHAPE[0] + 20, apart):
        for cx in range(8, SHAPE[1] + 20, apart):
            far = ((y - cy) ** 2 + (x - cx) ** 2) / (0.55 * apart) ** 2
            layer += peak_rad * np.sqrt(np.maximum(1 - far, 0))
    layer = scipy.ndimage.gaussian_filter(layer, 2)
    rec = p4d.open_recording(hologram(np.ones(SHAPE), layer, 1.0)[None])
    with pytest.warns(UserWarning, match="little empty field is in view"):
        data = p4d.reconstruct(rec, LOBES)
    assert data.attrs["without_fringes_percent"][0] < 0.5
    assert not any("fringes" in words for words in reconstruction_advice(data.attrs))
