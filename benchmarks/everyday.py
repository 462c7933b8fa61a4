"""Scenes as labs record them: beads, red cells that tumble, layers, sheets, flow, beating, drying.

Exact phase (time, angle, y, x) in radians of two views, the second a few pixels aside of the
first. None of them was used to choose anything in the own methods, but the layer and the sheet.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Image = NDArray[np.float64]
#: What a scene looks like at a time (a number from 0) in a view that lies so many pixels aside.
At = Callable[[int, float], Image]

TIMES, HEIGHT, WIDTH = 32, 80, 96
#: How far the second view lies aside, in pixels.
ASIDE = 3.0
Y, X = np.mgrid[:HEIGHT, :WIDTH].astype(float)


def frames_of(at: At, n_views: int = 2) -> Image:
    """Return all frames of a scene."""
    views = ASIDE * np.arange(n_views)
    return np.stack([np.stack([at(t, aside) for aside in views]) for t in range(TIMES)])


def ball(y: float, x: float, radius: float, peak: float) -> Image:
    return peak * np.sqrt(np.maximum(1 - ((Y - y) ** 2 + (X - x) ** 2) / radius**2, 0))


def drop(y: float, x: float, radius: float, peak: float) -> Image:
    return peak * np.maximum(1 - ((Y - y) ** 2 + (X - x) ** 2) / radius**2, 0)


def body(y: float, x: float, tall: float, wide: float, peak: float, turn: float = 0.0) -> Image:
    """Return a soft ellipse, turned by some radians."""
    down, right = Y - y, X - x
    along = right * np.cos(turn) - down * np.sin(turn)
    across = down * np.cos(turn) + right * np.sin(turn)
    return peak * np.exp(-((across / tall) ** 2) - (along / wide) ** 2)


def beads() -> Image:
    draw = np.random.default_rng(1)
    places = [draw.uniform((15, 15, 6, -0.4, -0.4), (65, 80, 11, 0.4, 0.4)) for _ in range(4)]

    def at(t: int, aside: float) -> Image:
        found = [ball(y + v * t, x + u * t + aside, r, 1.1 * r) for y, x, r, v, u in places]
        return np.max(found, axis=0)

    return frames_of(at)


def red_cells_that_tumble() -> Image:
    def at(t: int, aside: float) -> Image:
        found = np.zeros_like(Y)
        for k, (y, x) in enumerate([(25, 25), (50, 60)]):
            open_ = 0.7 * abs(np.cos(0.15 * t + k)) + 0.3
            q = ((Y - y) / 14) ** 2 + ((X - x - aside) / (14 * open_)) ** 2
            found += 6 / open_ * np.sqrt(np.maximum(1 - q, 0)) * (0.25 + 0.9 * q)
        return ndimage.gaussian_filter(found, 0.7)

    return frames_of(at)


def many_small_cells() -> Image:
    draw = np.random.default_rng(2)
    least, most = (5, 5, 3.2, -0.5, -0.5, 3), (75, 90, 6.5, 0.5, 0.5, 6)
    places = [draw.uniform(least, most) for _ in range(40)]
    return frames_of(
        lambda t, aside: sum(
            (drop(y + v * t, x + u * t + aside, r, p) for y, x, r, v, u, p in places), 0 * Y
        )
    )


def layer_without_empty_field() -> Image:
    draw = np.random.default_rng(3)
    first, second = (
        ndimage.gaussian_filter(draw.normal(size=(HEIGHT, WIDTH + 10)), 7) for _ in "ab"
    )
    wide = [
        8 * (np.cos(0.06 * t) * first / first.std() + np.sin(0.06 * t) * second / second.std())
        for t in range(TIMES)
    ]
    return frames_of(lambda t, aside: wide[t][:, int(aside) : int(aside) + WIDTH])


def sheet_that_grows() -> Image:
    def at(t: int, aside: float) -> Image:
        return 15 / (1 + np.exp((X - aside - 10 - 2.2 * t - 6 * np.sin(Y / 9)) / 2.5))

    return frames_of(at)


def sheet_of(peak: float, width: float, grows: float, kind: str) -> Image:
    """Return a sheet that covers the view bit by bit.

    Parameters
    ----------
    peak : float
        Its phase in radians.
    width : float
        Of its rim, which is a logistic curve, in pixels.
    grows : float
        By so many pixels a frame.
    kind : str
        "front" comes from one side; so does "cell", where there is a cell on the other one;
        "wound" closes from both sides; "film" grows round from the middle.
    """

    def at(t: int, aside: float) -> Image:
        if kind == "wound":
            inside = (
                8
                + grows * t / 2
                + 3 * np.sin(Y / 9)
                - np.minimum(X - aside, WIDTH - 1 - X + aside)
            )
        elif kind == "film":
            uneven = 3 * np.sin(3 * np.arctan2(Y - 30, X - 40))
            inside = 10 + grows * t + uneven - np.hypot(Y - 30, X - aside - 40)
        else:
            inside = 10 + grows * t + 6 * np.sin(Y / 9) - (X - aside)
        found = peak / (1 + np.exp(-inside / width))
        return np.maximum(found, body(40, 80 + aside, 8, 8, 12)) if kind == "cell" else found

    return frames_of(at)


#: Sheets that are about whole turns high: peak, width of the rim, growth, kind.
SHEETS = (
    (6.3, 2.5, 2.2, "front"),
    (6.3, 2.5, 2.2, "cell"),
    (6.3, 0.9, 2.6, "cell"),
    (6.3, 0.8, 1.6, "film"),
    (12.6, 1.3, 1.6, "film"),
    (6.3, 0.7, 2.0, "wound"),
)


def cell_with_a_tail() -> Image:
    def at(t: int, aside: float) -> Image:
        found = ball(40, 20 + aside, 7, 9)
        for x in np.arange(26, 85, 0.5):
            y = 40 + 10 * np.sin(0.12 * (x - 20) - 0.5 * t) * (x - 20) / 60
            found = np.maximum(found, 2.5 * np.exp(-((Y - y) ** 2 + (X - x - aside) ** 2) / 2.2))
        return found

    return frames_of(at)


def blebs_that_come_and_go() -> Image:
    draw = np.random.default_rng(8)
    blebs = [(draw.integers(2, TIMES - 2), draw.uniform(0, 2 * np.pi)) for _ in range(14)]

    def at(t: int, aside: float) -> Image:
        found = body(40, 48 + aside, 14, 14, 13)
        for when, where in blebs:
            y, x = 40 + 13 * np.sin(where), 48 + aside + 13 * np.cos(where)
            found += ball(y, x, 5, 5 * max(0.0, 1 - abs(t - when) / 2))
        return found

    return frames_of(at)


def cell_with_granules() -> Image:
    draw = np.random.default_rng(7)
    grains = [draw.uniform((-12, -15, 0), (12, 15, 6)) for _ in range(8)]

    def at(t: int, aside: float) -> Image:
        found = body(40, 48 + aside, 16, 20, 10)
        for y, x, phase in grains:
            turn = 0.4 * t + phase
            found += ball(40 + y + 2 * np.sin(turn), 48 + x + aside + 2 * np.cos(turn), 3.5, 3.5)
        return found

    return frames_of(at)


def rounding_up(t: int, aside: float) -> Image:
    done = 1 / (1 + np.exp(-1.2 * (t - 12)))
    radius = 13 * (1.6 - 0.6 * done)
    return body(40, 48 + aside, radius, radius, 8 + 26 * done)


#: Name -> exact phase.
EVERYDAY: dict[str, Callable[[], Image]] = {
    "beads": beads,
    "red cells that tumble": red_cells_that_tumble,
    "many small cells": many_small_cells,
    "layer without empty field": layer_without_empty_field,
    "sheet that grows": sheet_that_grows,
    "cell with a tail": cell_with_a_tail,
    "blebs": blebs_that_come_and_go,
    "granules": cell_with_granules,
    "cell that beats": lambda: frames_of(
        lambda t, aside: body(40, 48 + aside, 14, 20, 22 * (1 + 0.5 * np.sin(1.7 * t)))
    ),
    "cell that rounds up": lambda: frames_of(rounding_up),
    "cell that spins": lambda: frames_of(
        lambda t, aside: body(40, 48 + aside, 7, 22, 16, turn=0.35 * t)
    ),
    "cell that lyses": lambda: frames_of(
        lambda t, aside: (
            body(28, 30 + aside, 10, 12, 18 if t < 14 else 6.3) + body(55, 65 + aside, 10, 10, 14)
        )
    ),
    "cells in a flow": lambda: frames_of(
        lambda t, aside: (
            body(40, (11 * t) % 130 - 15 + aside, 9, 11, 13)
            + body(40, (11 * t + 65) % 130 - 15 + aside, 7, 8, 9)
        )
    ),
    "cell that swims in": lambda: frames_of(
        lambda t, aside: body(40, 4 * t - 25 + aside, 11, 13, 18)
    ),
    "bubbles": lambda: (
        -frames_of(
            lambda t, aside: (
                drop(35 + 0.5 * t, 30 + 0.3 * t + aside, 16, 14)
                + ball(60 - 0.5 * t, 70 + aside, 9, 9)
            )
        )
    ),
    "drop that dries": lambda: frames_of(
        lambda t, aside: drop(40, 48 + aside, 30 - 0.3 * t, 38 * (1 - t / 34))
    ),
    "wave round a cell": lambda: frames_of(
        lambda t, aside: (
            body(40, 48 + aside, 9, 9, 10)
            + 5 * np.exp(-(((np.hypot(Y - 40, X - 48) - 2.2 * t) / 3) ** 2))
        )
    ),
    "cells at two depths": lambda: frames_of(
        lambda t, aside: body(28, 35 + 4 * aside + 0.3 * t, 9, 9, 14) + body(55, 55, 11, 13, 17),
        n_views=3,
    ),
    "texture": lambda: frames_of(
        lambda t, aside: (
            body(40, 48 + aside, 18, 22, 10)
            * (1 + 0.12 * np.sin(2 * np.pi * (X - aside + 0.5 * t) / 7))
        )
    ),
}
