"""How right each method is: errors against exact truth, which is used for scoring only.

Prints one table for each question. Name some of them to print only those:
``python3 dev.py accuracy ideal optics``.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from cells import cells, cells_long
from layouts import layouts
from levelling import levelling
from regimes import regimes
from tables import heading, line
from trusting import confidence, elsewhere, sheets

import napari_phase4d as p4d
from napari_phase4d.simulation import (
    SHAPES,
    budding_yeast,
    moving_shape,
    multiplexed_video,
    pixels_of,
    swimming_euglena,
    with_noise,
)

TURN = 2 * np.pi
#: What one pixel that is a turn off adds to the squared error, rad^2.
CYCLE = TURN**2
PAPER = ("spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal")
OWN = ("directional-growing", "directional-l1")
NOISES = (0.0, 0.2, 0.5, 0.7)
#: Drift in radians and seed of the noise.
CASES = ((0.0, 1), (0.3, 1), (0.0, 2), (0.0, 3))


def phantoms() -> Iterator[tuple[str, xr.Dataset]]:
    for size in (48, 64, 96):
        yield f"yeast {size}", budding_yeast((size, size))
    yield "euglena 64", swimming_euglena((64, 64), 40, pixel_um=44 / 64)
    for name in SHAPES:
        yield f"{name} 64", moving_shape(name)


def turns_off(result: xr.DataArray, exact: xr.DataArray) -> np.ndarray:
    return np.round((result.values - exact.values) / TURN)


def error(result: xr.DataArray, exact: xr.DataArray) -> float:
    """Return the squared error in rad^2 that wrong turns make; exact phase has the same noise."""
    return float(CYCLE * np.mean(turns_off(result, exact) ** 2))


def ideal() -> None:
    """Wrapped phase without any optics, by noise and drift."""
    heading(
        "Ideal wrapped phase: squared error (rad^2)",
        "phantom noise drift seed RGd WL1 paper's-best",
    )
    own: dict[tuple[float, float], list[float]] = {}
    worse = 0
    for name, exact in phantoms():
        for noise in NOISES:
            for drift, seed in CASES if noise else CASES[:2]:
                data = with_noise(exact, noise, drift, seed)
                found = {
                    m: error(p4d.unwrap(data["wrapped"], m), data["phase"]) for m in PAPER + OWN
                }
                best = min(PAPER, key=lambda m: found[m])
                worse += found["directional-l1"] > found[best] + 1e-4
                own.setdefault((noise, drift), []).append(found["directional-l1"])
                words = f"{p4d.METHODS[best].label} {found[best]:.4f}"
                line(name, noise, drift, seed, *(found[m] for m in OWN), words)
    heading("WL1 over all phantoms", "noise drift mean worst")
    for (noise, drift), values in own.items():
        line(noise, drift, statistics.mean(values), max(values))
    print(f"\nWL1 worse than the best of the paper's five: {worse} cases")


def through_optics(
    exact: Callable[..., xr.Dataset], n_times: int, angles: tuple[float, ...], **camera: Any
) -> tuple[xr.Dataset, np.ndarray]:
    """Return what is reconstructed from the hologram video of an object, and its exact phase."""
    optics = p4d.Optics()
    radius = camera.get("pupil_radius", 0.089)
    object_ = exact((512, 512), n_times, angles_deg=angles, pixel_um=optics.pixel_um)
    video = multiplexed_video(object_["phase"], optics, **camera)
    lobes = [
        p4d.Lobe(k, radius, angle)
        for k, angle in zip(video.holograms.attrs["carriers"], angles, strict=True)
    ]
    data = p4d.reconstruct(video, lobes)
    shape = data.sizes["y"], data.sizes["x"]
    truth = exact(shape, n_times, angles_deg=angles, **pixels_of(data["phase"]))["phase"]
    return data, truth.values


def optics_line(name: str, data: xr.Dataset, truth: np.ndarray) -> None:
    amplitude = data["amplitude"].values
    bright = amplitude > np.median(amplitude) / 5
    cells: list[object] = []
    for method in (*PAPER[:1], "temporal", "temporal-angular", *OWN):
        found = p4d.unwrap(data["phase"], method, amplitude=data["amplitude"]).values
        wrong = np.round((found - truth) / TURN) != 0
        cells.append(f"{100 * wrong[bright].mean():.3f} ({np.mean((found - truth) ** 2):.3f})")
    line(name, *cells)


def yeast_in_field(
    shape: tuple[int, int],
    n_times: int,
    *,
    angles_deg: tuple[float, ...],
    pixel_um: float | tuple[float, float],
    first_um: float | tuple[float, float] = 0.0,
) -> xr.Dataset:
    """Return the budding yeast in the field of a camera."""
    field_um = float(np.max(pixel_um)) * shape[0]
    return budding_yeast(
        shape, n_times, angles_deg=angles_deg, field_um=field_um, first_um=first_um
    )


def optics() -> None:
    """Hologram videos: 8 bit, shot noise, drift, a pupil as large as the lobe."""
    heading(
        "Through the optics: % of pixels wrong by a cycle, of those with an amplitude above a "
        "fifth of the median (in brackets: mean squared error of all pixels, rad^2)",
        "object 2-D Temporal T/A RGd WL1",
    )
    doubled = {"full_well_electrons": 2500, "read_noise_electrons": 8.0, "drift_rad": 0.4}
    for peak in (7, 12, 17, 21):

        def euglena(*args: Any, peak: float = peak, **more: Any) -> xr.Dataset:
            return swimming_euglena(*args, peak_rad=peak, **more)

        for words, camera in (("", {"drift_rad": 0.2}), (", twice noise and drift", doubled)):
            data, truth = through_optics(euglena, 40, (-7.0, 21.0), **camera)
            optics_line(f"euglena {peak} rad{words}", data, truth)
    for words, camera in (("", {"drift_rad": 0.2}), (", twice noise and drift", doubled)):
        pairs = [
            through_optics(yeast_in_field, 19, angles, seed=i, **camera)
            for i, angles in enumerate(((0.0, 5.0), (10.0, 15.0), (20.0, 25.0)))
        ]
        data = xr.concat([p[0] for p in pairs], "angle")
        optics_line(
            f"yeast, two lobes at a time{words}", data, np.concatenate([p[1] for p in pairs], 1)
        )
    ring = [(0.33 * np.sin(a), 0.33 * np.cos(a)) for a in np.deg2rad((4, 34, 64, 94, 124, 154))]
    data, truth = through_optics(
        yeast_in_field,
        19,
        (0.0, 5.0, 10.0, 15.0, 20.0, 25.0),
        carriers=ring,
        pupil_radius=0.06,
        drift_rad=0.2,
        bits=8,
    )
    optics_line("yeast, six lobes at once", data, truth)


def crops() -> None:
    """No background in view: the middle of the cell, cut out."""
    heading(
        "No background in view, boundary frame (0, 0): squared error (rad^2), each result's best "
        "whole number of turns taken off",
        "phantom pixels noise empty-% RGd WL1 paper's-best",
    )
    n_good = n_worse = n_cases = 0
    for name, exact in phantoms():
        inside = (exact["phase"].values > 0.3).mean((0, 1)) > 0.9
        if not inside.any():
            continue
        rows, columns = np.nonzero(inside)
        half = min(np.ptp(rows), np.ptp(columns)) // 2
        for share in (0.7, 1.0, 1.3):
            reach = max(int(half * share), 5)
            y, x = int(rows.mean()), int(columns.mean())
            cut = exact.isel(
                y=slice(max(y - reach, 0), y + reach + 1),
                x=slice(max(x - reach, 0), x + reach + 1),
            )
            for noise in (0.0, 0.5):
                data = with_noise(cut, noise, seed=2)
                found = {}
                for method in PAPER + OWN:
                    off = turns_off(p4d.unwrap(data["wrapped"], method), data["phase"])
                    found[method] = float(CYCLE * np.mean((off - np.median(off)) ** 2))
                best = min(PAPER, key=lambda m: found[m])
                ours = found["directional-l1"]
                n_cases, n_good = n_cases + 1, n_good + (ours <= 0.1)
                n_worse += ours > found[best] + 1e-4
                empty = 100 * float((cut["phase"].values == 0).mean())
                words = f"{p4d.METHODS[best].label} {found[best]:.4f}"
                line(name, 2 * reach + 1, noise, f"{empty:.0f}", *(found[m] for m in OWN), words)
    print(
        f"\nWL1: {n_good} of {n_cases} at most 0.1; worse than the best of the paper's five: "
        f"{n_worse}"
    )


def harder(exact: xr.Dataset) -> Iterator[tuple[str, xr.Dataset]]:
    """The same object; half as thick again; without the half of the times in which it is thin."""
    yield "", exact
    yield ", thick", exact.assign(phase=np.float32(1.5) * exact["phase"])
    yield ", late", exact.isel(time=slice(exact.sizes["time"] // 2, None))


def boundaries() -> None:
    """Whether the safest frame is one that 2-D unwraps with the fewest wrong pixels."""
    heading("Boundary frame: pixels wrong in it", "phantom noise fewest safest first")
    shares: dict[float, list[bool]] = {}
    for name, plain in phantoms():
        for more, exact in harder(plain):
            for noise in NOISES[:3]:
                data = with_noise(exact, noise, seed=4)
                inside = exact["phase"].values > 0.05
                flat = p4d.unwrap(data["wrapped"], "spatial-2d")
                wrong = ((turns_off(flat, data["phase"]) != 0) & inside).sum((2, 3))
                pick = wrong[tuple(p4d.score_boundaries(data["wrapped"]).attrs["best"])]
                shares.setdefault(noise, []).append(bool(pick == wrong.min()))
                line(f"{name}{more}", noise, wrong.min(), pick, wrong[0, 0])
    right = [found for of_noise in shares.values() for found in of_noise]
    each = ", ".join(f"{sum(n)} of {len(n)} at noise {noise:g}" for noise, n in shares.items())
    share = 100 * sum(right) / len(right)
    print(f"\nFewest wrong pixels: {sum(right)} of {len(right)} ({share:.1f} %); {each}")


QUESTIONS = (
    ideal,
    optics,
    crops,
    confidence,
    elsewhere,
    sheets,
    boundaries,
    regimes,
    layouts,
    levelling,
    cells,
    cells_long,
)


def main() -> None:
    asked = sys.argv[1:]
    for question in QUESTIONS:
        if not asked or question.__name__ in asked:
            question()


if __name__ == "__main__":
    main()
