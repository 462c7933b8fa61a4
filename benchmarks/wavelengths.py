"""Wrong cycles and phase error against noise, with one, two and three wavelengths.

``python benchmarks/wavelengths.py`` prints the tables of `docs/how-to/wavelengths.md`; give names
of cases, or "optics" or "confidence", to print only these.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator

import numpy as np
import xarray as xr
from regimes import OWN_PHANTOMS, object_
from scipy import ndimage
from tables import heading, line
from trusting import Tally, slips

import napari_phase4d as p4d
from napari_phase4d import simulation
from napari_phase4d.analysis import slipped_frames
from napari_phase4d.unwrapping import methods_for

METHOD = "synthetic-wavelength"
TWO, THREE, LONG = (0.532, 0.6328), (0.532, 0.561, 0.6328), (0.532, 0.6238, 0.6328)
NOISE_RAD = (0.0, 0.1, 0.2, 0.3, 0.5)
SEEDS = (1, 2, 3)
#: Microns of path of the plates.
LOW, HIGH = (0.25, 0.4, 0.6, 0.9, 1.2, 1.5), (0.25, 0.6, 1.5, 4.0, 9.0, 20.0)
#: The ways to use several wavelengths, beside the methods of one.
WAYS = {
    "Synthetic, each pixel by itself": {"settle": False},
    "Synthetic": {},
    "Synthetic, beat by T/A": {"beat": "temporal-angular"},
    "Synthetic, beat by WL1": {"beat": "directional-l1"},
}


def steps(paths_um: tuple[float, ...]) -> xr.Dataset:
    return simulation.step_phantom(paths_um=paths_um, n_times=3, angles_deg=(-7.0, 21.0))


def cell(peak_rad: float) -> xr.Dataset:
    """Return a thick cell that swims, seen from two angles."""
    data = simulation.swimming_euglena((96, 128), 40, peak_rad=peak_rad, pixel_um=0.35)
    return data.isel(time=slice(None, None, 8))


#: Name -> what is seen, and its wavelengths.
CASES = {
    "steps up to 1.5 um, two wavelengths": (lambda: steps(LOW), TWO),
    "steps up to 1.5 um, three wavelengths": (lambda: steps(LOW), THREE),
    "steps up to 20 um, three wavelengths": (lambda: steps(HIGH), LONG),
    "a swimming cell of 25 rad, two wavelengths": (lambda: cell(25), TWO),
    "a swimming cell of 80 rad, two wavelengths": (lambda: cell(80), TWO),
    "a swimming cell of 80 rad, three wavelengths": (lambda: cell(80), THREE),
}


def scores(found: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Return wrong cycles in percent, and the rms error in rad."""
    off = found - exact
    return 100 * float((np.abs(off) > np.pi).mean()), float(np.sqrt((off**2).mean()))


def against_noise(name: str) -> None:
    """Print how many cycles of a case are wrong, for each method and noise."""
    make, wavelengths = CASES[name]
    exact = simulation.at_wavelengths(make(), wavelengths)
    rows: dict[str, list[tuple[float, float]]] = {}
    for noise in NOISE_RAD:
        got: dict[str, list[tuple[float, float]]] = {}
        for seed in SEEDS if noise else SEEDS[:1]:
            data = simulation.with_noise(exact, noise, 0.2, seed)
            for label, method, options in ways():
                found = p4d.unwrap(data["wrapped"], method, (0, 0), **options).values
                got.setdefault(label, []).append(scores(found, data["phase"].values))
        for label, each in got.items():
            wrong, error = np.mean(each, axis=0)
            rows.setdefault(label, []).append((float(wrong), float(error)))
    columns = " ".join(f"{noise:g}" for noise in NOISE_RAD)
    heading(
        f"{name}: wrong cycles in % / rms error in rad beyond the noise, at a noise in rad of",
        f"method {columns}",
    )
    one = [rows[p4d.METHODS[m].label] for m in methods_for(None)]
    rows["best of these"] = [min(own) for own in zip(*one, strict=True)]
    for label in sorted(rows, key=lambda label: label in WAYS):
        each = rows[label]
        line(label, *(f"{wrong:.3g} / {error:.2g}" for wrong, error in each))


def ways() -> list[tuple[str, str, dict[str, object]]]:
    """Return label, method and options of all that is compared."""
    one = [(p4d.METHODS[m].label, m, {}) for m in methods_for(None)]
    return [*one, *((label, METHOD, options) for label, options in WAYS.items())]


#: Carriers of two angles at two wavelengths, and the pupil at 632.8 nm.
CARRIERS = ((0.30, 0.10), (0.10, 0.30), (-0.10, 0.30), (-0.30, 0.10))
PUPIL, SIDE, ANGLES = 0.05, 512, (-7.0, 21.0)


def through_the_optics() -> None:
    """Print what is left of plates in holograms, by how much light the camera takes."""
    exact = simulation.at_wavelengths(
        simulation.step_phantom((SIDE, SIDE), (0.4, 0.9, 1.4), 2, angles_deg=ANGLES), TWO
    )
    heading(
        "Two angles x two wavelengths in one hologram, plates of 0.4, 0.9 and 1.4 um, three "
        "pixels from any wall: wrong cycles in %, by the electrons that a camera pixel holds",
        "electrons noise(rad) T/A WL1 Synthetic rms(rad)",
    )
    for electrons in (100, 300, 1000, 10_000):
        rec = simulation.multiplexed_video(
            exact["phase"], carriers=CARRIERS, pupil_radius=PUPIL, bits=12,
            full_well_electrons=electrons, read_noise_electrons=3, drift_rad=0.3,
        )  # fmt: skip
        data = p4d.reconstruct(rec, two_by_two())
        truth, flat = seen(exact["phase"].values, data["phase"].shape[2:])
        off = {
            m: p4d.unwrap(data["phase"], m).values - truth
            for m in ("temporal-angular", "directional-l1", METHOD)
        }
        wrong = [100 * float((np.abs(o[flat]) > np.pi).mean()) for o in off.values()]
        empty = flat & (truth == 0)
        right = flat & (np.abs(off[METHOD]) < np.pi)
        noise = float(data["phase"].values[empty].std())
        line(electrons, noise, *wrong, float(np.sqrt((off[METHOD][right] ** 2).mean())))


def seen(exact: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact phase on another grid, and which pixels are far from walls and edges."""
    rows, columns = (np.round((np.arange(n) + 0.5) * SIDE / n - 0.5).astype(int) for n in shape)
    truth = exact[:, :, rows][..., columns]
    near = (1, 1, 7, 7)
    flat = ndimage.maximum_filter(truth, near) - ndimage.minimum_filter(truth, near) < 1
    flat[..., :3, :] = flat[..., -3:, :] = flat[..., :3] = flat[..., -3:] = False
    return truth, flat


#: What is asked how far it is trusted, and what goes wrong in recordings of cells.
TRUSTED = ("spatial-2d", "temporal-angular", "directional-l1", METHOD)
AFTER = (None, "pause", "kick", "doubling")
#: A pixel with so much phase in radians belongs to the object.
THICK = 0.3


def cells(fault: str | None) -> Iterator[tuple[xr.Dataset, np.ndarray]]:
    """Yield cells seen at two wavelengths, from one angle, and where they are."""
    for seed, name in enumerate(OWN_PHANTOMS):
        own = object_(name).isel(angle=[0])
        own = own if fault is None else simulation.with_fault(own, fault, seed=seed)
        own["phase"].attrs["wavelength_um"] = 0.6328
        data = simulation.with_noise(simulation.at_wavelengths(own, TWO), 0.3, seed=seed)
        yield data, np.abs(data["phase"].values) > THICK


def walls(noise: float) -> Iterator[tuple[xr.Dataset, np.ndarray]]:
    """Yield plates whose steps the wavelengths tell, and where they are."""
    for seed, (paths, lights) in enumerate(((LOW, TWO), (LOW, THREE), (HIGH, LONG))):
        data = simulation.with_noise(
            simulation.at_wavelengths(steps(paths), lights), noise, 0.2, seed
        )
        yield data, np.abs(data["phase"].values) > THICK


def swimming(peak_rad: float, electrons: float) -> Iterator[tuple[xr.Dataset, np.ndarray]]:
    """Yield cells in holograms of two angles and wavelengths, and where they are."""
    for seed in range(3):
        cell = simulation.swimming_euglena(
            (SIDE, SIDE), 6, peak_rad=peak_rad, pixel_um=0.09, angles_deg=ANGLES
        )
        exact = simulation.at_wavelengths(cell, TWO)["phase"]
        rec = simulation.multiplexed_video(
            exact, carriers=CARRIERS, pupil_radius=PUPIL, bits=12, drift_rad=0.3, seed=seed,
            full_well_electrons=electrons, read_noise_electrons=3,
        )  # fmt: skip
        data = p4d.reconstruct(rec, two_by_two())
        truth, _ = seen(exact.values, data["phase"].shape[2:])
        together = xr.Dataset({"wrapped": data["phase"], "phase": data["phase"].copy(data=truth)})
        yield together, np.abs(truth) > THICK


def two_by_two() -> list[p4d.Lobe]:
    """Return the lobes of two angles and wavelengths."""
    views = [(angle, light) for angle in ANGLES for light in TWO]
    return [
        p4d.Lobe(carrier, PUPIL * 0.6328 / light, angle, wavelength_um=light)
        for carrier, (angle, light) in zip(CARRIERS, views, strict=True)
    ]


def confidence() -> None:
    """Print how well confidence finds wrong pixels and slipped objects at several wavelengths."""
    heading(
        "Confidence at several wavelengths: area under the curve, mean and worst; wrong of the "
        "pixels that are given less than 1 %; frames in which most of an object is wrong that are "
        "warned of, and false alarms",
        "recordings method mean worst wrong(%) found slipped false-alarms right-frames",
    )
    every = {f"cells, {fault or 'no fault'}, 0.3 rad": cells(fault) for fault in AFTER}
    every |= {f"plates, {noise} rad": walls(noise) for noise in (0.2, 0.3)}
    every |= {
        f"cells of {peak} rad through the optics": swimming(peak, electrons)
        for peak, electrons in ((14, 10_000), (22, 600))
    }
    for words, recordings in every.items():
        tallies: dict[str, Tally] = {}
        for data, inside in recordings:
            compared = p4d.compare(data["wrapped"], list(TRUSTED))
            for method, trust in compared.confidences().items():
                turns = np.round((compared.results[method] - data["phase"]).values / (2 * np.pi))
                wrong = above_empty(turns, inside) != 0
                tally = tallies.setdefault(method, Tally())
                tally.add(1 - trust.values[inside], wrong[inside])
                said = slipped_frames(compared.problem, trust)
                tally.add_frames(said, slips(wrong, inside))
        for method, tally in tallies.items():
            chance, wrong = np.concatenate(tally.chances), np.concatenate(tally.outcomes)
            safe = chance < 0.01
            line(
                words,
                p4d.METHODS[method].label,
                statistics.mean(tally.areas) if tally.areas else "",
                min(tally.areas, default=""),
                f"{100 * wrong[safe].mean():.3f}" if safe.any() else "",
                tally.found,
                tally.slipped,
                tally.false,
                tally.right,
            )


def above_empty(turns: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return turns (time, view, y, x) above the median of each frame outside the object."""
    found = turns.copy()
    for frame in np.ndindex(*turns.shape[:2]):
        if not inside[frame].all():
            found[frame] -= np.median(turns[frame][~inside[frame]])
    return found


def main() -> None:
    """Print the tables."""
    began = time.perf_counter()
    chosen = [name for name in CASES if not sys.argv[1:] or any(w in name for w in sys.argv[1:])]
    for name in chosen:
        against_noise(name)
    if not sys.argv[1:] or "optics" in sys.argv[1:]:
        through_the_optics()
    if not sys.argv[1:] or "confidence" in sys.argv[1:]:
        confidence()
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
