"""The spectrum's axes say where in it the fringes are."""

from __future__ import annotations

import numpy as np
import pytest

import napari_phase4d as p4d


@pytest.mark.parametrize("shape", [(60, 80), (61, 81)])
@pytest.mark.parametrize("periods", [(12, 20), (-12, 20), (0, -30), (24, 0)])
def test_fringes_are_at_their_frequency(shape: tuple[int, int], periods: tuple[int, int]) -> None:
    y, x = np.indices(shape)
    frequency = periods[0] / shape[0], periods[1] / shape[1]
    fringes = 100 + 50 * np.cos(2 * np.pi * (frequency[0] * y + frequency[1] * x))
    power = p4d.power_spectrum(p4d.open_recording(fringes[np.newaxis]))
    at_fringes = power.sel(ky=frequency[0], kx=frequency[1], method="nearest")
    assert float(at_fringes) == pytest.approx(float(power.max()), rel=1e-4)
    for axis in ("ky", "kx"):
        assert (np.diff(power[axis]) > 0).all()
