"""The windows that cut a lobe out of the spectrum: their edges and their centre."""

from __future__ import annotations

import numpy as np
import pytest

from napari_phase4d.holography import WINDOWS, Demodulator, Lobe

#: At the middle, half way, a little inside the radius, at it, and a little outside; by formula.
VALUES = {
    "disk": (1, 1, 1, 1, 0),
    "smooth-disk": (1, 1, 0.841345, 0.5, 0.158655),  # the normal distribution at 1, 0 and -1
    "gaussian": (1, np.exp(-0.5), np.exp(-2 * 0.95**2), np.exp(-2), 0),
    "tukey": (1, 1, 0.5 * (1 + np.cos(np.pi * 0.8)), 0, 0),
}


@pytest.mark.parametrize("name", WINDOWS)
def test_windows_are_their_formulas(name: str) -> None:
    found = WINDOWS[name](np.array([0, 0.5, 0.95, 1, 1.05]))
    np.testing.assert_allclose(found, VALUES[name], atol=1e-6)


@pytest.mark.parametrize("name", WINDOWS)
@pytest.mark.parametrize("shape", [(96, 128), (97, 127)])
def test_windows_are_centred_on_the_carrier(name: str, shape: tuple[int, int]) -> None:
    """A wave as far above the carrier as another is below it is let through as much."""
    carrier = (24 / shape[0], 32 / shape[1])
    demodulate = Demodulator(shape, [Lobe(carrier, radius=0.1)], name)
    for axis in (0, 1):
        away = round(0.095 * shape[axis]) / shape[axis]
        step = np.eye(2)[axis] * away
        through = [strength(demodulate, carrier + sign * step, shape) for sign in (1, -1)]
        expected = 50 * WINDOWS[name](np.array([away / 0.1]))[0]
        np.testing.assert_allclose(through, expected, rtol=1e-3)


def strength(demodulate: Demodulator, frequency: np.ndarray, shape: tuple[int, int]) -> float:
    """Return how strong fringes of a whole number of periods come through."""
    y, x = np.indices(shape)
    fringes = 100 + 100 * np.cos(2 * np.pi * (frequency[0] * y + frequency[1] * x))
    return float(np.abs(demodulate(fringes)).mean())
