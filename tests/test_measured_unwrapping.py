"""Unwrapping of measured wrapped phase: radar interferograms and magnetic resonance."""

from __future__ import annotations

import struct
from pathlib import Path

import kamui
import numpy as np
import pytest
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from helpers import measured

pytestmark = pytest.mark.measured
TURN = 2 * np.pi


def share_off(unwrapped: np.ndarray, published: np.ndarray, valid: np.ndarray) -> float:
    """Return the share of valid pixels that differ, each frame's own turns taken off."""
    off = 0
    for ours, theirs, inside in zip(unwrapped, published, valid, strict=True):
        turns = np.round((ours - theirs)[inside] / TURN)
        off += int((turns != np.median(turns)).sum())
    return off / int(valid.sum())


@pytest.fixture(scope="module")
def interferograms() -> dict[str, np.ndarray]:
    with np.load(measured("unwrap/pyrate_cropA_shared.npz")) as file:
        return {name: file[name] for name in ("wrapped", "unwrapped", "valid", "pairs")}


@pytest.mark.parametrize(("method", "most"), [("spatial-2d", 0.0004), ("network-flow", 0.0002)])
def test_radar_interferograms(
    method: str, most: float, interferograms: dict[str, np.ndarray]
) -> None:
    """Sentinel-1 pairs with published unwrapped phase."""
    valid = interferograms["valid"].astype(bool)
    wrapped = np.where(valid, interferograms["wrapped"], 0)
    found = p4d.unwrap(wrapped, method, mask=valid).values
    assert share_off(found, interferograms["unwrapped"], valid) <= most


# The paramecium and its blurred outline leave 27 % of the view that look empty.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:paramecium_oa_oof.npz. little empty field")
@pytest.mark.parametrize(
    "name", ["hologram_cell.npz", "single_holo.tif", "paramecium_oa_oof.npz", "pydhm_RBC.jpg"]
)
def test_phase_of_measured_holograms_is_unwrapped_as_by_scikit_image(name: str) -> None:
    """The same turns in every pixel inside the border."""
    rec = p4d.open_recording(measured(f"offaxis/{name}"))
    wrapped = p4d.reconstruct(rec, p4d.find_lobes(rec, 1)).phase.values[0, 0]
    ours = p4d.unwrap(wrapped, "spatial-2d").values
    turns = np.round((ours - unwrap_phase(wrapped, rng=0)) / (2 * np.pi))[1:-1, 1:-1]
    assert np.ptp(turns) == 0


def nifti(path: Path) -> np.ndarray:
    """Read an uncompressed float32 NIfTI-1 file, slowest axis first."""
    raw = path.read_bytes()
    dims = struct.unpack("<8h", raw[40:56])
    kind, start = struct.unpack("<h", raw[70:72])[0], int(struct.unpack("<f", raw[108:112])[0])
    slope, offset = struct.unpack("<2f", raw[112:120])
    assert kind == 16
    shape = dims[1 : dims[0] + 1][::-1]
    values = np.frombuffer(raw, "<f4", offset=start, count=int(np.prod(shape)))
    return values.reshape(shape) * slope + offset


@pytest.fixture(scope="module")
def head() -> np.ndarray:
    """Three echoes of a head as (time, angle, y, x): the slices stand for the angles."""
    values = nifti(measured("unwrap/romeo_small_Phase.nii")) / 0.0036743774 * np.pi
    return np.angle(np.exp(1j * values)).astype(np.float32)


def test_echoes_by_region_growing(head: np.ndarray) -> None:
    """The phase grows linearly with the echo time."""
    found = p4d.unwrap(head, "region-growing").values
    turns = (found - head) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)
    second = np.abs(found[2] - 2 * found[1] + found[0])
    assert (second < np.pi).mean() >= 0.9984


@pytest.mark.slow
@pytest.mark.parametrize("echo", [1, 2])
def test_slab_agrees_with_kamuis_volume(echo: int, head: np.ndarray) -> None:
    """kamui solves for the fewest turns in a volume, with another algorithm."""
    slab = head[echo, 10:18]
    ours = p4d.unwrap(slab[:, None], "spatial-3d").values[:, 0]
    theirs = kamui.unwrap_dimensional(slab.astype(np.float64))
    turns = np.round((ours - theirs) / TURN)
    assert (turns == np.median(turns)).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["directional-growing", "directional-l1"])
def test_own_methods_on_radar_interferograms(
    method: str, interferograms: dict[str, np.ndarray]
) -> None:
    """Each pair alone, since pairs are no time series; fewer pixels differ than by 2-D."""
    valid = interferograms["valid"].astype(bool)
    wrapped = np.where(valid, interferograms["wrapped"], 0)
    pairs = zip(wrapped, valid, strict=True)
    alone = np.stack([p4d.unwrap(frame, method, mask=inside).values for frame, inside in pairs])
    flat = p4d.unwrap(wrapped, "spatial-2d", mask=valid).values
    published = interferograms["unwrapped"]
    assert share_off(alone, published, valid) <= 0.00005 < share_off(flat, published, valid)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["directional-growing", "directional-l1"])
def test_own_methods_on_echoes(method: str, head: np.ndarray) -> None:
    found = p4d.unwrap(head, method).values
    second = np.abs(found[2] - 2 * found[1] + found[0])
    assert (second < np.pi).mean() >= 0.999
