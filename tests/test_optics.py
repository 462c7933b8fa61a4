from __future__ import annotations

import numpy as np
import pytest

from napari_phase4d import Optics


def test_pixel_is_the_cameras_over_the_magnification() -> None:
    assert Optics(camera_pixel_um=5.2, magnification=52).pixel_um == pytest.approx(0.1)


def test_one_turn_is_one_wavelength() -> None:
    optics = Optics(wavelength_um=0.5)
    assert optics.optical_path_um(2 * np.pi) == pytest.approx(0.5)
    assert optics.height_um(2 * np.pi, optics.medium_index + 0.1) == pytest.approx(5.0)


def test_dry_mass_of_a_slab() -> None:
    # 1 um of optical path over 18 um^2 at 0.18 um^3/pg is 100 pg.
    optics = Optics(wavelength_um=1.0)
    phase = np.full((3, 3), 2 * np.pi)
    assert optics.dry_mass_pg(phase, pixel_area_um2=2.0) == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wavelength_um", 0),
        ("camera_pixel_um", -1),
        ("magnification", np.nan),
        ("medium_index", 0.9),
    ],
)
def test_impossible_numbers_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Optics(**{name: value})


def test_height_needs_a_contrast() -> None:
    with pytest.raises(ValueError, match="object_index must differ"):
        Optics().height_um(1.0, Optics().medium_index)
