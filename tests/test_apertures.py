"""Light within a round aperture: what is beyond it is noise, and no part of the field."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe
from napari_phase4d.holography.background import Surface
from napari_phase4d.simulation import multiplexed_video

SIDE, LOBE = 192, Lobe((0.19, 0.21), 0.09)
#: Radii as shares of half a side; they leave 50, 40 and 30 % of the frame lit.
RADII = (0.8, 0.71, 0.62)
#: Where the cell is, and how large, in half sides.
ROW, COLUMN, REACH = 0.1, -0.12, 0.22
pytestmark = pytest.mark.filterwarnings("ignore:.*shows? no fringes:UserWarning")

Array = np.ndarray


def places(side: int) -> tuple[Array, Array]:
    """Return the rows and columns of so many pixels a side, from -1 to 1."""
    line = (np.arange(side) + 0.5) / side * 2 - 1
    return line[:, None], line[None, :]


def cell(side: int) -> Array:
    """Return the exact shape of a round cell of height 1."""
    y, x = places(side)
    return np.sqrt(np.clip(1 - ((y - ROW) ** 2 + (x - COLUMN) ** 2) / REACH**2, 0, None))


def through(radius: float, peak_rad: float, curvature_rad: float = 0.0) -> p4d.Recording:
    """Record a cell through an aperture with a camera that counts 5 in the dark."""
    phase = xr.DataArray(
        np.broadcast_to(peak_rad * cell(SIDE), (2, 1, SIDE, SIDE)),
        dims=("time", "angle", "y", "x"),
        coords={"time": [0.0, 1.0], "angle": [0.0]},
        attrs={"units": "rad"},
    )
    video = multiplexed_video(phase, carriers=[LOBE.carrier], curvature_rad=curvature_rad)
    light = video.holograms.values * (np.hypot(*places(SIDE)) < radius)
    noise = np.random.default_rng(0).normal(5, 1, light.shape)
    frames = np.clip(np.round(light + noise), 0, 255).astype(np.uint8)
    return p4d.open_recording(frames, optics=video.optics)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*may be the object's:UserWarning")
@pytest.mark.parametrize("referenced", [False, True])
@pytest.mark.parametrize("background", ["curvature", "polynomial", "zernike"])
@pytest.mark.parametrize("radius", RADII)
def test_noise_beyond_an_aperture_bends_no_background(
    radius: float, background: str, referenced: bool
) -> None:
    rec = through(radius, 3.0, curvature_rad=3.0)
    reference = through(radius, 0.0, curvature_rad=3.0).raw_frame(0) if referenced else None
    data = p4d.reconstruct(rec, [LOBE], reference, background=background)
    found = data["phase"].values[0, 0]
    exact = cell(len(found))
    inside = np.hypot(*places(len(found))) < 0.85 * radius
    y, x = places(len(found))
    empty = inside & (np.hypot(y - ROW, x - COLUMN) > 1.3 * REACH)
    off = np.angle(np.exp(1j * (found - 3.0 * exact)))
    assert off[empty].std() < 0.06
    top = exact > 0.9
    assert np.median(off[top]) - np.median(off[empty]) == pytest.approx(0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [2.0, *RADII])
@pytest.mark.parametrize("peak_rad", [2.0, 4.0, 6.0])
def test_noise_beyond_an_aperture_turns_no_sign(radius: float, peak_rad: float) -> None:
    for sign in (1, -1):  # a vacuole is thinner than what is round it
        (lobe,) = p4d.find_lobes(through(radius, sign * peak_rad), 1, radius=LOBE.radius)
        assert lobe.flip == (sign < 0)


def test_a_reference_that_is_given_is_not_asked_for() -> None:
    y, x = places(SIDE)
    rough = 9 * np.sin(5 * y + 3 * np.sin(4 * x)) * np.cos(6 * x)  # no empty field anywhere
    phase = xr.DataArray(
        np.broadcast_to(rough, (1, 1, SIDE, SIDE)),
        dims=("time", "angle", "y", "x"),
        coords={"time": [0.0], "angle": [0.0]},
        attrs={"units": "rad"},
    )
    rec = multiplexed_video(phase, carriers=[LOBE.carrier])
    reference = multiplexed_video(phase * 0, carriers=[LOBE.carrier], seed=1)
    for given, sentence in (
        (None, "use a reference hologram or background"),
        (reference, "use b"),
    ):
        with pytest.raises(ValueError, match=f"curvature can't be fitted to view 1 .*{sentence}"):
            p4d.reconstruct(rec, [LOBE], given, background="curvature")


@pytest.mark.parametrize("order", [1, 2])
def test_a_beam_that_fades_is_lit_to_its_border(order: int) -> None:
    """The dim border is the empty field there; it hangs together, as noise does not."""
    y, x = np.mgrid[-1:1:128j, -1:1:128j]
    slope = 5 * y - 3 * x + (4 * (y**2 + x**2) if order == 2 else 0)
    cell = 5 * np.exp(-(y**2 + (x - 0.1) ** 2) / 0.3**2)
    rng = np.random.default_rng(0)
    noise = 0.003 * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape))
    field = np.exp(-(y**2 + x**2) / 0.5**2) * np.exp(1j * (slope + cell)) + noise
    fit = Surface("powers", order, y.shape).fit(field.astype(np.complex64))
    assert np.std(fit.surface - slope) < 0.12
