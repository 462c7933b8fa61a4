"""Cells found, followed and weighed, against simulated ones whose masses are exact."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import dask.array as da
import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage
from scipy.optimize import linear_sum_assignment
from tables import heading, line

import napari_phase4d as p4d
from napari_phase4d.simulation import multiplexed_video, pixels_of, swimming_cells, with_noise

#: Cells at first, field in pixels, and how many divide, leave and come in.
RECORDINGS = (
    (3, (160, 160), 1),
    (6, (192, 224), 1),
    (10, (224, 288), 2),
    (14, (288, 360), 2),
    (20, (320, 400), 3),
    (30, (384, 448), 4),
)
NOISES = (0.0, 0.3, 0.5)
#: Through the optics: cells, field of the camera in pixels, and its noise: electrons of a full
#: pixel and of reading.
HOLOGRAMS = (
    (3, (512, 512), (10000, 5.0)),
    (5, (512, 640), (10000, 5.0)),
    (8, (768, 768), (10000, 5.0)),
    (8, (768, 768), (2500, 8.0)),
)
FRAMES = 40
#: Cells smaller than this are barely in view, and count neither as found nor as missed.
LEAST_PIXELS, OVERLAP, NEAR = 30, 0.5, 3
METHOD = "directional-l1"
KEYS = ["cell", "time (s)", "angle (deg)"]
MASS, ERROR = "dry mass (pg)", "dry mass error (pg)"


@dataclass
class Score:
    """What was counted of a recording."""

    found: int = 0
    there: int = 0
    given: int = 0
    contacts: int = 0
    switched: dict[bool, int] = field(default_factory=lambda: {True: 0, False: 0})

    @property
    def f1(self) -> float:
        return 2 * self.found / max(self.there + self.given, 1)


def pairs_of(true: np.ndarray, found: np.ndarray) -> tuple[list[tuple[int, int]], int, int]:
    """Return the cells that overlap by half, how many there are, and how many were found."""
    n = int(found.max()) + 1
    joint = np.bincount(true.ravel() * n + found.ravel(), minlength=(int(true.max()) + 1) * n)
    joint = joint.reshape(-1, n).astype(float)
    sizes = joint.sum(1), joint.sum(0)
    share = joint / (sizes[0][:, None] + sizes[1][None] - joint + 1e-9)
    share[0], share[:, 0] = 0, 0
    rows, columns = linear_sum_assignment(-share)
    pairs = [
        (int(i), int(j)) for i, j in zip(rows, columns, strict=True) if share[i, j] >= OVERLAP
    ]
    large = sizes[0] >= LEAST_PIXELS
    hits = [(i, j) for i, j in pairs if large[i]]
    barely = {j for i, j in pairs if not large[i]}
    # What was found of a cell that is barely in view is no error either.
    small = {j for i in np.flatnonzero(~large[1:]) + 1 for j in np.flatnonzero(joint[i] > 0)}
    small -= {j for _, j in hits}
    numbers = set(np.flatnonzero(sizes[1][1:]) + 1) - barely - small
    return hits, int(large[1:].sum()), len(numbers)


def touching(true: np.ndarray) -> set[int]:
    """Return the cells that others come near to."""
    highest = ndimage.maximum_filter(true, 2 * NEAR + 1)
    lowest = ndimage.minimum_filter(np.where(true > 0, true, np.iinfo(np.int32).max), 2 * NEAR + 1)
    return set(np.unique(true[(true > 0) & ((highest != true) | (lowest != true))])) - {0}


def scored(data: xr.Dataset, labels: xr.DataArray) -> Score:
    """Hold labels against exact ones, frame by frame and view by view."""
    score = Score()
    true, found = data["cells"].values, labels.values
    for angle in range(true.shape[1]):
        number: dict[int, int] = {}
        met: dict[int, bool] = {}
        before: set[int] = set()
        for frame in range(len(true)):
            pairs, there, given = pairs_of(true[frame, angle], found[frame, angle])
            score.found += len(pairs)
            score.there += there
            score.given += given
            near = touching(true[frame, angle])
            score.contacts += len(near - before)
            before = near
            met |= dict.fromkeys(near, True)
            for cell, label in pairs:
                if number.setdefault(cell, label) != label:
                    score.switched[met.get(cell, False)] += 1
                number[cell] = label
                if cell not in near:
                    met[cell] = False
    score.contacts //= 2
    return score


def divisions(data: xr.Dataset, labels: xr.DataArray) -> tuple[int, int]:
    """Return how many daughters there are, and of how many the parent was found."""
    number: dict[int, int] = {}
    for frame in range(data.sizes["time"]):
        for cell, label in pairs_of(data["cells"].values[frame, 0], labels.values[frame, 0])[0]:
            number.setdefault(cell, label)
    parents = dict(labels.attrs["parents"])
    daughters = data["cell"].values[data["parent"].values > 0]
    right = 0
    for daughter in daughters:
        mother = number.get(int(data["parent"].sel(cell=daughter)))
        right += mother is not None and parents.get(number.get(int(daughter), 0)) == mother
    return len(daughters), int(right)


def weighed(
    data: xr.Dataset, phase: xr.DataArray, labels: xr.DataArray, trust: xr.DataArray
) -> pd.DataFrame:
    """Return the masses of cells wholly in view, with the true ones."""
    table = p4d.measure(phase, labels, p4d.Optics(), confidence=trust)
    table = table[table["wholly in view"]]
    times, angles = data["time"].values, data["angle"].values
    true = []
    for cell, seconds, degrees in table[["cell", "time (s)", "angle (deg)"]].itertuples(
        index=False
    ):
        t, a = int(np.argmin(abs(times - seconds))), int(np.argmin(abs(angles - degrees)))
        pairs, _, _ = pairs_of(data["cells"].values[t, a], labels.values[t, a])
        number = {label: i for i, label in pairs}.get(cell)
        true.append(np.nan if number is None else float(data["dry_mass_pg"].sel(cell=number)[t]))
    return table.assign(true=true).dropna(subset=["true"])


def between_views(table: pd.DataFrame) -> float:
    """Return of how many cells and times the masses of two views agree within their error."""
    wide = table.pivot_table(
        index=["cell", "time (s)"],
        columns="angle (deg)",
        values=[MASS, ERROR],
    ).dropna()
    masses, errors = wide[MASS].to_numpy(), wide[ERROR].to_numpy()
    return float((abs(np.diff(masses)[:, 0]) <= np.hypot(*errors.T)).mean())


def row(
    name: str, noise: str, data: xr.Dataset, phase: xr.DataArray, trust: xr.DataArray
) -> pd.DataFrame:
    """Find, follow and weigh; print a line."""
    labels = p4d.find_cells(phase)
    score, (daughters, right) = scored(data, labels), divisions(data, labels)
    table = weighed(data, phase, labels, trust)
    off = table[MASS] - table["true"]
    line(
        name, noise, f"{score.f1:.4f}", score.contacts,
        score.switched[True], score.switched[False],
        f"{right} of {daughters}", f"{100 * (off.abs() / table['true']).median():.2f}",
        f"{100 * (off.abs() <= table[ERROR]).mean():.0f}",
        f"{100 * between_views(table):.0f}", len(table),
    )  # fmt: skip
    return table


def recordings() -> Iterator[tuple[str, str, xr.Dataset, xr.DataArray, xr.DataArray]]:
    """Make each recording with each noise, unwrap it, and judge that."""
    for count, shape, events in RECORDINGS:
        happens = {"divisions": events, "leaving": min(events, count - events), "entering": events}
        exact = swimming_cells(shape, FRAMES, count, seed=count, **happens)
        for noise in NOISES:
            data = with_noise(exact, noise, seed=count)
            phase = p4d.unwrap(data["wrapped"], METHOD)
            yield (
                f"{count} cells",
                f"{noise:g} rad",
                exact,
                phase,
                p4d.confidence(phase, data["wrapped"]),
            )
    optics = p4d.Optics()
    for count, shape, (electrons, reading) in HOLOGRAMS:
        happens = {"divisions": 1, "leaving": 1, "entering": 1, "seed": count}
        seen = swimming_cells(shape, FRAMES, count, pixel_um=optics.pixel_um, **happens)
        video = multiplexed_video(
            seen["phase"], optics, drift_rad=0.2,
            full_well_electrons=electrons, read_noise_electrons=reading,
        )  # fmt: skip
        lobes = p4d.find_lobes(video, 2, angles_deg=seen["angle"].values)
        wrapped = p4d.reconstruct(video, lobes)
        phase = p4d.unwrap(wrapped["phase"], METHOD, amplitude=wrapped["amplitude"])
        small = tuple(phase.shape[2:])
        pixels = pixels_of(phase)
        pixel, first = pixels["pixel_um"][0], pixels["first_um"]
        exact = swimming_cells(small, FRAMES, count, pixel_um=pixel, first_um=first, **happens)
        trust = p4d.confidence(phase, wrapped["phase"], wrapped["amplitude"])
        yield f"{count} cells, holograms", f"{electrons} electrons", exact, phase, trust


def cells() -> None:
    """Cells that swim, touch, divide, leave and come in, over 40 frames and two views."""
    heading(
        "Cells, unwrapped by WL1: found (F1 at an overlap of one half), numbers that change, "
        "parents of daughters, and masses of cells wholly in view",
        "recording noise F1 contacts changed-in-contact changed-apart parents mass-off-median-% "
        "within-their-error-% views-agree-% masses",
    )
    tables: dict[bool, list[pd.DataFrame]] = {False: [], True: []}
    for each in recordings():
        tables["holograms" in each[0]].append(row(*each))
    for through_optics, found in tables.items():
        every = pd.concat(found)
        off = (every[MASS] - every["true"]).abs()
        once, twice = ((off <= k * every[ERROR]).mean() for k in (1, 2))
        print(
            f"\n{'Through the optics' if through_optics else 'Without optics'}: of {len(every)} "
            f"masses {100 * once:.1f} % lie within their error, {100 * twice:.1f} % within twice "
            f"of it; the median is off by {100 * (off / every['true']).median():.2f} %."
        )


def cells_long() -> None:
    """A thousand frames with thirty cells, of which a few are in memory at a time."""
    heading("1000 frames of 30 cells", "work seconds processor-seconds memory-gained-MB")
    some = swimming_cells((384, 448), 40, 30, divisions=0, leaving=0, entering=0, angles_deg=(0,))
    values = some["phase"].values
    there_and_back = np.r_[0:40, 38:0:-1]
    frames = [values[there_and_back[i % len(there_and_back)]] for i in range(1000)]
    stack = da.stack([da.from_array(frame) for frame in frames])
    coords = {dim: some[dim] for dim in ("angle", "y", "x")} | {"time": np.arange(1000) / 6}
    phase = xr.DataArray(stack, dims=some["phase"].dims, coords=coords, attrs=some["phase"].attrs)
    p4d.find_cells(phase[:3])  # loads
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    labels = None
    for name in ("find_cells", "measure"):
        began, used = time.perf_counter(), time.process_time()
        if labels is None:
            labels = p4d.find_cells(phase)
        else:
            table = p4d.measure(phase, labels, p4d.Optics())
        gained = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        seconds, processor = time.perf_counter() - began, time.process_time() - used
        line(name, f"{seconds:.0f}", f"{processor:.0f}", f"{gained:.0f}")
    print(f"\n{labels.nbytes / 1e6:.0f} MB of it are the labels; {table['cell'].nunique()} cells.")
