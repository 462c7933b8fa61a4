"""Complex numbers and their phase, several times as fast as array operations.

Each loop goes over the numbers once and works on several at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized

__all__ = ["parts_of", "phase_of", "phasors", "to_polar", "turned", "write_polar"]

TURN = 2 * np.pi
PI = np.float32(np.pi)
HALF_PI = np.float32(np.pi / 2)
TINY = np.finfo(np.float32).tiny
#: Of arctan(q) / q in powers of q^2, for q from 0 to 1: wrong by at most 2e-8, a sixth of the
#: last digit of float32 (Abramowitz & Stegun, Handbook of Mathematical Functions, 4.4.49).
A2, A4 = np.float32(-0.3333314528), np.float32(0.1999355085)
A6, A8 = np.float32(-0.1420889944), np.float32(0.1065626393)
A10, A12 = np.float32(-0.0752896400), np.float32(0.0429096138)
A14, A16 = np.float32(-0.0161657367), np.float32(0.0028662257)
ONE = np.float32(1)

Fields = NDArray[np.complex64]
Image = NDArray[np.float32]


def phasors(phase: Image) -> Fields:
    """Return exp(i phase)."""
    z = np.empty(phase.shape, dtype=np.complex64)
    np.cos(phase, out=z.real)
    np.sin(phase, out=z.imag)
    return z


def phase_of(field: Fields) -> Image:
    """Return the phase in (-pi, pi] of a field of any shape, see `to_polar`."""
    phase = np.empty((1, field.size), dtype=np.float32)
    write_polar(parts_of(field).reshape(1, -1), np.empty_like(phase), phase)
    return phase.reshape(field.shape)


def to_polar(field: Fields, amplitude: Image, phase: Image) -> None:
    """Write the amplitude and the phase in (-pi, pi] of a field, all of shape (y, x).

    Both are as right as float32 can tell: within 5e-7 rad of `numpy.arctan2`.
    """
    write_polar(parts_of(field), amplitude, phase)


def parts_of(field: Fields) -> Image:
    """Return the real and imaginary parts of a field, which take turns along x."""
    return np.ascontiguousarray(field, dtype=np.complex64).view(np.float32)


@vectorized
def write_polar(parts: Image, amplitude: Image, phase: Image) -> None:
    """Write the amplitude and phase of real and imaginary parts that take turns along x."""
    height, width = amplitude.shape
    for y in range(height):
        for x in range(width):
            real, imag = parts[y, 2 * x], parts[y, 2 * x + 1]
            amplitude[y, x] = np.sqrt(real * real + imag * imag)
            a, b = abs(real), abs(imag)
            q = min(a, b) / max(max(a, b), TINY)
            s = q * q
            high = A8 + s * (A10 + s * (A12 + s * (A14 + s * A16)))
            angle = q * (ONE + s * (A2 + s * (A4 + s * (A6 + s * high))))
            angle = HALF_PI - angle if b > a else angle
            angle = PI - angle if real < 0 else angle
            phase[y, x] = -angle if imag < 0 else angle


def turned(phase: NDArray[np.floating]) -> Image:
    """Wrap phase into [-pi, pi]."""
    if phase.dtype != np.float32:
        result: Image = (phase - TURN * np.round(phase / TURN)).astype(np.float32)
        return result
    # Loops are compiled for arrays in order that may be written to.
    given = np.require(phase, np.float32, ["C", "W"])
    wrapped = np.empty(given.shape, dtype=np.float32)
    wrap(given.reshape(-1), wrapped.reshape(-1))
    return wrapped


@vectorized
def wrap(phase: Image, out: Image) -> None:
    """Write wrapped phases."""
    turn = np.float32(2 * np.pi)
    for i in range(len(phase)):
        out[i] = phase[i] - turn * np.rint(phase[i] / turn)
