"""Zernike's polynomials against Noll's table, and what is taken off against known aberrations."""

from __future__ import annotations

import math

import imageio.v3 as iio
import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d.analysis.noise import empty_field, levelled
from napari_phase4d.holography import Lobe
from napari_phase4d.holography.aberrations import noll, surface_terms, zernike
from napari_phase4d.holography.background import fitted_surface
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

SHAPE = (160, 200)
#: Noll's table, j -> (n, m, polynomial of rho and theta), from his paper of 1976.
TABLE = {
    1: (0, 0, lambda r, t: 1 + 0 * r),
    2: (1, 1, lambda r, t: 2 * r * np.cos(t)),
    3: (1, -1, lambda r, t: 2 * r * np.sin(t)),
    4: (2, 0, lambda r, t: math.sqrt(3) * (2 * r**2 - 1)),
    5: (2, -2, lambda r, t: math.sqrt(6) * r**2 * np.sin(2 * t)),
    6: (2, 2, lambda r, t: math.sqrt(6) * r**2 * np.cos(2 * t)),
    7: (3, -1, lambda r, t: math.sqrt(8) * (3 * r**3 - 2 * r) * np.sin(t)),
    8: (3, 1, lambda r, t: math.sqrt(8) * (3 * r**3 - 2 * r) * np.cos(t)),
    9: (3, -3, lambda r, t: math.sqrt(8) * r**3 * np.sin(3 * t)),
    10: (3, 3, lambda r, t: math.sqrt(8) * r**3 * np.cos(3 * t)),
    11: (4, 0, lambda r, t: math.sqrt(5) * (6 * r**4 - 6 * r**2 + 1)),
    12: (4, 2, lambda r, t: math.sqrt(10) * (4 * r**4 - 3 * r**2) * np.cos(2 * t)),
    13: (4, -2, lambda r, t: math.sqrt(10) * (4 * r**4 - 3 * r**2) * np.sin(2 * t)),
    14: (4, 4, lambda r, t: math.sqrt(10) * r**4 * np.cos(4 * t)),
    15: (4, -4, lambda r, t: math.sqrt(10) * r**4 * np.sin(4 * t)),
}


def test_zernike_terms_are_those_of_nolls_table() -> None:
    rng = np.random.default_rng(0)
    rho, theta = rng.uniform(0, 1, 50), rng.uniform(-np.pi, np.pi, 50)
    for j, (n, m, polynomial) in TABLE.items():
        assert noll(j) == (n, m)
        np.testing.assert_allclose(zernike(j, rho, theta), polynomial(rho, theta), atol=1e-12)
    with pytest.raises(ValueError, match="counted from 1"):
        noll(0)


def test_zernike_terms_are_orthonormal_on_the_disk() -> None:
    """Exactly, by Gauss's quadrature along the radius and even steps round the circle."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    rho, theta = np.meshgrid((nodes + 1) / 2, np.arange(40) * np.pi / 20, indexing="ij")
    area = (weights / 2)[:, None] * rho * (np.pi / 20) / np.pi
    terms = np.stack([zernike(j, rho, theta) for j in range(1, 46)])
    np.testing.assert_allclose(
        np.einsum("apq,bpq,pq->ab", terms, terms, area), np.eye(45), atol=1e-10
    )


def known_aberration(scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Tilt, defocus, astigmatism, coma, trefoil and spherical aberration, in rad rms."""
    coefficients = np.zeros(15)
    coefficients[1:11] = [3, -2, 2, 1.5, -1, 1.2, 0.8, 0.5, -0.4, 0.9]
    coefficients *= scale
    return coefficients, np.tensordot(coefficients, surface_terms("zernike", 4, SHAPE), 1)


def a_cell() -> np.ndarray:
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return 6 * np.sqrt(np.maximum(1 - ((x - 0.1) / 0.4) ** 2 - ((y + 0.1) / 0.45) ** 2, 0))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["zernike", "polynomial"])
@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0])
def test_known_aberrations_come_off_and_the_cell_stays(kind: str, scale: float) -> None:
    """Up to 9 rad rms of tilt and 4.5 of astigmatism round a thick cell, noise 50 mrad.

    What is left of the aberration is below 5 mrad rms in the empty field, and changes the cell's
    phase by 15 mrad at most.
    """
    coefficients, aberration = known_aberration(scale)
    rng = np.random.default_rng(3)
    noise = 0.05 * (rng.normal(size=SHAPE) + 1j * rng.normal(size=SHAPE))
    cell = a_cell()
    field = (np.exp(1j * (aberration + cell + 0.7)) + noise).astype(np.complex64)
    surface, found = fitted_surface(field[None], 4, kind)
    error = surface - aberration
    error -= error[cell == 0].mean()
    assert error[cell == 0].std() < 0.005
    assert np.abs(error[cell > 0]).max() < 0.015
    if kind == "zernike":
        np.testing.assert_allclose(found[1:], coefficients[1:], atol=0.005)
    # Tilt and curvature are not enough.
    rest, _ = fitted_surface(field[None], 2, "powers")
    assert np.std((rest - aberration)[cell == 0]) > 0.2


def test_zernike_and_polynomial_of_one_order_span_the_same_surfaces() -> None:
    for order in (1, 3, 6):
        first, second = (
            surface_terms(kind, order, (40, 50)).reshape((order + 1) * (order + 2) // 2, -1)
            for kind in ("zernike", "polynomial")
        )
        mixed = np.linalg.lstsq(first.T, second.T, rcond=None)[0]
        np.testing.assert_allclose(first.T @ mixed, second.T, atol=1e-9)


@pytest.mark.parametrize(
    ("background", "order", "most"),
    [
        ("curvature", 4, 0.03),
        ("zernike", 2, 0.03),
        ("zernike", 4, 0.045),
        ("polynomial", 4, 0.045),
    ],
)
def test_reconstruction_takes_off_strong_curvature(
    background: str, order: int, most: float
) -> None:
    """Through optics and camera: 12 rad of defocus at the corner, and a cell that stays.

    Against the phase that a hologram without the cell gives as reference, in rad rms.
    """
    exact = swimming_euglena((256, 256), 2, pixel_um=0.175, peak_rad=4)["phase"]
    lobes = [Lobe((0.19, 0.21), 0.1), Lobe((-0.21, 0.19), 0.1, 1.0)]
    video, empty = (
        multiplexed_video(phase, curvature_rad=12.0, bits=12) for phase in (exact, exact[:1] * 0)
    )
    known = p4d.reconstruct(video, lobes, empty, background="none")["phase"].values
    data = p4d.reconstruct(video, lobes, background=background, background_order=order)
    error = wrap(data["phase"].values - known)[..., 3:-3, 3:-3]
    error -= np.median(error, axis=(2, 3), keepdims=True)  # its level is not looked at here
    assert np.sqrt(np.mean(error**2)) < most
    assert data.attrs.get("background_order") == (None if background == "curvature" else order)
    if background == "zernike":
        # 12 r^2, r = 1 at the frame's corner, is 6 + 6 (2 rho^2 - 1): 6 / sqrt(3) of defocus;
        # the circle goes through the middles of the outermost pixels of the coarser grid.
        rim = (1 - 1 / data.sizes["y"]) / (1 - 1 / 256)
        named = data.attrs["aberrations_rad"][0]
        assert named["defocus"] == pytest.approx(6 / math.sqrt(3) * rim**2, rel=0.03)
        assert abs(named["astigmatism 0°"]) < 0.1  # the cell hides much of the field


def test_orders_out_of_range_are_refused(small_video) -> None:
    lobes = p4d.find_lobes(small_video, 2)
    for order in (0, 9):
        with pytest.raises(ValueError, match="background_order must lie between 1 and 8"):
            p4d.reconstruct(small_video, lobes, background="zernike", background_order=order)
        with pytest.raises(ValueError, match="background_order"):
            p4d.Recipe().changed(background_order=order)


@pytest.mark.thorough
@pytest.mark.measured
@pytest.mark.filterwarnings("ignore:.* left in view")  # as it should be, with a tilt
@pytest.mark.parametrize(
    ("name", "most"),
    [("holobio_40x_Vortex.bmp", 0.7), ("pydhm_RBC.jpg", 0.86), ("holobio_20x_SHPC.bmp", 0.9)],
)
def test_measured_empty_fields_get_flatter(name: str, most: float) -> None:
    """Standard deviation of the empty field, the same pixels each time: order 4 against tilt.

    Vortex 268 to 183 mrad, red cells 221 to 187, 20x target 240 to 211.
    """
    frame = iio.imread(measured(f"offaxis/{name}"))
    rec = p4d.open_recording(frame[..., 0] if frame.ndim == 3 else frame)
    lobes = p4d.find_lobes(rec, 1)
    phases = {
        background: p4d.reconstruct(rec, lobes, background=background)["phase"].values[0, 0]
        for background in ("tilt", "curvature", "polynomial", "zernike")
    }
    empty = np.logical_and.reduce([empty_field(phase) for phase in phases.values()])
    assert empty.mean() > 0.2
    flat = {b: 1000 * float(levelled(p, empty)[empty].std()) for b, p in phases.items()}
    assert flat["zernike"] == pytest.approx(flat["polynomial"], rel=0.02)
    assert flat["zernike"] < most * flat["tilt"]
