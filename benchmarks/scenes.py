"""Wrapped phase to measure on: gentle and steep cells, noise, and frames made to be hard."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

TURN = 2 * np.pi
FRAMES = ((512, 512), (1024, 1280))
#: Kind -> noise in radians, peak in radians, blur in pixels.
KINDS = {
    "gentle": (0.3, 16.0, 4.0),
    "noise 0.5 rad": (0.5, 16.0, 4.0),
    "steep": (0.2, 50.0, 1.0),
    "noise 0.9 rad": (0.9, 16.0, 4.0),
}


def phase_of(kind: str, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Return exact phase of four cells on a tilt, with noise."""
    rng = np.random.default_rng(seed)
    noise, peak, blur = KINDS[kind]
    y, x = np.mgrid[: shape[0], : shape[1]]
    height = np.zeros(shape)
    for _ in range(4):
        cy, cx = rng.uniform(0.2, 0.8, 2) * shape
        ry, rx = rng.uniform(0.1, 0.2, 2) * shape[0]
        rho = ((y - cy) / ry) ** 2 + ((x - cx) / rx) ** 2
        cell = peak * rng.uniform(0.6, 1) * np.sqrt(np.clip(1 - rho, 0, None))
        height = np.maximum(height, cell)
    return gaussian_filter(height, blur) + 0.01 * x + rng.normal(0, noise, shape)


def four_balls_through_a_pupil(
    seed: int, steep: float, noise: float = 0.02, side: int = 1, bubble: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return exact phase, wrapped phase and amplitude of four balls that grow or shrink.

    The pupil cuts off what is steeper than it passes: rims are dark there.

    Parameters
    ----------
    seed : int
        Decides about sizes, heights, growth and noise.
    steep : float
        Height of the highest possible ball as a multiple of its radius, radians a pixel.
    noise : float, optional
        Of the light, as a share of it.
    side : int, optional
        1 if the balls are denser than the medium, -1 if they are thinner.
    bubble : float, optional
        If not 0, the first ball is half as large, as steep as this, and lies on the other side.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:64, :64]
    balls = [(rng.uniform(6, 11), rng.uniform(0.4, 1)) for _ in range(4)]
    balls = [(radius, steep * part) for radius, part in balls]
    if bubble:
        balls[0] = balls[0][0] / 2, -bubble
    grows = rng.uniform(-0.4, 0.4)
    phase = np.zeros((9, 1, 64, 64))
    for place, (radius, slope) in zip(np.ndindex(2, 2), balls, strict=True):
        far = ((y - 14 - 32 * place[0]) ** 2 + (x - 14 - 32 * place[1]) ** 2) / radius**2
        ball = side * slope * radius * np.sqrt(np.maximum(1 - far, 0))
        phase += ball * (1 + grows * np.arange(9) / 9)[:, None, None, None]
    phase = gaussian_filter(phase, (0, 0, 0.6, 0.6))
    ky, kx = np.fft.fftfreq(64)[:, None], np.fft.fftfreq(64)
    passes = ky**2 + kx**2 <= 0.25**2
    light = np.fft.ifft2(np.fft.fft2(np.exp(1j * phase)) * passes)
    light += noise * (rng.standard_normal(light.shape) + 1j * rng.standard_normal(light.shape))
    return phase, np.angle(light).astype(np.float32), np.abs(light).astype(np.float32)


def wrapped(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase)).astype(np.float32)


def frame(kind: str, shape: tuple[int, int], seed: int) -> np.ndarray:
    return wrapped(phase_of(kind, shape, seed))


def hard_frames(shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return frames made to need as much work as possible."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: shape[0], : shape[1]]
    vortices = sum(
        s * np.arctan2(y - cy, x - cx)
        for s, cy, cx in zip(
            np.tile([1, -1], 100), rng.uniform(0, shape[0], 200), rng.uniform(0, shape[1], 200),
            strict=True,
        )
    )  # fmt: skip
    checks = np.where((y + x) % 2, 3.0, -3.0)
    return {
        "noise 0.9 rad": frame("noise 0.9 rad", shape, 0),
        "pure noise": rng.uniform(-np.pi, np.pi, shape).astype(np.float32),
        "200 vortices": wrapped(vortices),
        "checks and noise": wrapped(checks + rng.normal(0, 0.4, shape)),
        "stripes of noise": wrapped(np.where(y % 8 < 4, rng.normal(0, 2, shape), 0.05 * x)),
        "steep ramp and noise": wrapped(2.9 * x + 2.8 * y + rng.normal(0, 0.4, shape)),
        "growing noise": wrapped(rng.normal(0, 1, shape) * x / shape[1] * 2),
    }


def moving_cells(n_times: int, n_angles: int, size: int, noise: float) -> np.ndarray:
    """Return wrapped phase (time, angle, y, x) of three cells that drift, turn and grow."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:size, :size]
    cells = [
        (*rng.uniform(0.3, 0.7, 2), *rng.uniform(0.12, 0.25, 2), *rng.normal(0, 0.6, 2))
        for _ in range(3)
    ]
    out = np.empty((n_times, n_angles, size, size), dtype=np.float32)
    for t, a in np.ndindex(n_times, n_angles):
        height = np.zeros((size, size))
        for cy, cx, ry, rx, vy, vx in cells:
            rho = ((y - cy * size - vy * t) / (ry * size)) ** 2
            rho += ((x - cx * size - vx * t) / (rx * size * (1 + 0.02 * a))) ** 2
            height = np.maximum(
                height, (8 + 6 * t / n_times + 0.7 * a) * np.sqrt(np.clip(1 - rho, 0, None))
            )
        out[t, a] = wrapped(gaussian_filter(height, 3) + rng.normal(0, noise, height.shape))
    return out
