"""How often the finder takes the right lobes, on random layouts of two to four views.

Objects, beams, carriers and camera are drawn anew for every seed; the carriers that were drawn
are the truth. The weights of `napari_phase4d.holography.beams` were fitted on the seeds 200000 to
203800 and 300000 to 300700.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import ndimage
from tables import heading, line

import napari_phase4d as p4d
from napari_phase4d.holography import pair_distance
from napari_phase4d.simulation import multiplexed_video

Carrier = tuple[float, float]

SIDE = 256
#: A carrier is right within so many cycles/px.
WITHIN = 0.017
#: Least distances in pupil radii: of views, of a view and a beat, of a view and zero.
REGIMES = {
    "separated": (2.1, 3.0, 3.0),
    "rims overlap": (2.1, 2.2, 2.6),
    "lobes overlap": (1.5, 1.0, 2.2),
}


@dataclass(frozen=True)
class Layout:
    """One random recording and what is in it.

    Parameters
    ----------
    rec : Recording
        The video.
    carriers : list of tuple of float
        Of its views.
    regime : str
        How near its lobes lie to each other.
    reference : float
        Amplitude of the reference beam.
    """

    rec: p4d.Recording
    carriers: list[Carrier]
    regime: str
    reference: float

    def found_by(self, lobes: list[p4d.Lobe]) -> bool:
        """Say whether all views were found and nothing else."""
        return len(lobes) == len(self.carriers) and all(
            min(pair_distance(lobe.carrier, k) for lobe in lobes) < WITHIN for k in self.carriers
        )


def layout(seed: int, n_views: int | None = None, regime: str | None = None) -> Layout:
    """Return the random recording of a seed."""
    rng = np.random.default_rng(seed)
    n = n_views or int(rng.integers(2, 5))
    regime = regime or str(rng.choice(list(REGIMES), p=(0.6, 0.2, 0.2)))
    carriers, radius = placed(rng, n, regime)
    reference = float(np.exp(rng.uniform(np.log(0.5), np.log(3))))
    video = multiplexed_video(
        phases(rng, n, int(rng.choice((1, 6)))),
        carriers=carriers,
        pupil_radius=radius,
        beam_amplitudes=rng.uniform(0.2, 1, n),
        reference_amplitude=reference,
        drift_rad=float(rng.choice((0, 0.3, 1))),
        curvature_rad=float(rng.choice((0, 0, 4))),
        bits=int(rng.choice((8, 12))),
        seed=seed,
    )
    return Layout(video, carriers, regime, reference)


def placed(rng: np.random.Generator, n: int, regime: str) -> tuple[list[Carrier], float]:
    """Draw carriers that are as far apart as the regime asks for, and the pupil's radius."""
    apart, from_beats, from_zero = REGIMES[regime]
    radius = float(rng.uniform(0.035, 0.1))
    while True:
        for _ in range(300):
            carriers = [drawn(rng, radius) for _ in range(n)]
            if all(np.hypot(*k) > from_zero * radius for k in carriers) and clear(
                carriers, apart * radius, from_beats * radius
            ):
                return carriers, radius
        radius *= 0.93


def drawn(rng: np.random.Generator, radius: float) -> Carrier:
    """Draw one carrier; one in eight lies on an axis."""
    ky, kx = rng.uniform(-0.5 + radius, 0.5 - radius, 2)
    axis = rng.integers(16)
    return (0.0 if axis == 0 else float(ky), 0.0 if axis == 1 else float(abs(kx)))


def clear(carriers: list[Carrier], apart: float, from_beats: float) -> bool:
    """Say whether views lie so far from each other, and from all beats and conjugates."""
    for a, b in itertools.combinations(carriers, 2):
        if pair_distance(a, b) < apart:
            return False
        beat = (a[0] - b[0], a[1] - b[1])
        if any(pair_distance(beat, k) < from_beats for k in carriers):
            return False
    # A lobe and its own conjugate.
    return all(pair_distance((2 * k[0], 2 * k[1]), (0.0, 0.0)) > apart for k in carriers)


def phases(rng: np.random.Generator, n_views: int, n_times: int) -> xr.DataArray:
    """Draw some bodies that move, seen shifted and with other heights in each view."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(np.float32) / SIDE - 0.5
    phase = np.zeros((n_times, n_views, SIDE, SIDE), dtype=np.float32)
    for _ in range(int(rng.integers(1, 4))):
        centre, move = rng.uniform(-0.3, 0.3, 2), rng.normal(0, 0.01, 2)
        size = rng.uniform(0.04, 0.3, 2)
        peak = float(np.exp(rng.uniform(np.log(0.3), np.log(18))))
        rough = float(rng.choice((0.5, 1, 2)))
        turn = rng.uniform(0, np.pi)
        for view in range(n_views):
            shift, height = rng.normal(0, 0.03, 2), peak * rng.uniform(0.7, 1.3)
            for time in range(n_times):
                ahead = centre + shift + time * move
                v = (y - ahead[0]) * np.cos(turn) + (x - ahead[1]) * np.sin(turn)
                u = (x - ahead[1]) * np.cos(turn) - (y - ahead[0]) * np.sin(turn)
                inside = 1 - (v / size[0]) ** 2 - (u / size[1]) ** 2
                phase[time, view] += height * np.maximum(inside, 0) ** (rough / 2)
    if rng.integers(3) == 0:  # granules, the same in all views
        for _ in range(int(rng.integers(3, 20))):
            place, radius = rng.uniform(-0.4, 0.4, 2), rng.uniform(0.01, 0.04)
            apart = (y - place[0]) ** 2 + (x - place[1]) ** 2
            phase += (phase > 0.2) * np.maximum(rng.uniform(0.3, 2) * (1 - apart / radius**2), 0)
    times, angles = np.arange(n_times) / 6.0, np.arange(n_views, dtype=float)
    return xr.DataArray(
        phase, dims=("time", "angle", "y", "x"), coords={"time": times, "angle": angles}
    )


@dataclass(frozen=True)
class Outcome:
    """What the finder made of a layout."""

    regime: str
    reference: float
    n_frames: int
    n_views: int
    wrong: bool
    doubted: bool


def steep_cell(
    side: int, views: int, peak: float, *, cover: float, power: float, off: tuple[int, int]
) -> tuple[p4d.Recording, list[Carrier]]:
    """Return the recording of a large cell with steep flanks, one frame, and its carriers.

    Parameters
    ----------
    side, views : int
        Pixels along a side of the frame, and how many views.
    peak : float
        Phase in the middle, in radians.
    cover : float
        Share of the view that the cell covers.
    power : float
        1 for a parabola; more for flanks that flatten out at the border.
    off : tuple of int
        How far beside the middle of the view it lies (y, x), in pixels.
    """
    y, x = np.indices((side, side)) - side / 2
    square = cover / np.pi * side**2
    phase = [
        peak * np.maximum(1 - ((y - off[0]) ** 2 + (x - off[1] - shift) ** 2) / square, 0) ** power
        for shift in (0, 4)[:views]
    ]
    smooth = ndimage.gaussian_filter(np.array(phase, dtype=np.float32), (0, 2, 2))
    carriers: list[Carrier] = [(0.19, 0.21), (-0.21, 0.19)][:views]
    exact = xr.DataArray(smooth[None], dims=("time", "angle", "y", "x"))
    return multiplexed_video(exact, carriers=carriers, pupil_radius=0.095, bits=8), carriers


def steep_cells(count: int = 90) -> None:
    """How far lobes lie beside the carriers of steep cells that cover a third of the view or more.

    What is more than 0.03 cycles/px off is another place of the spectrum.
    """
    heading("Steep cells: lobes beside their carriers", "cells more-than-0.03-off in-silence")
    rng = np.random.default_rng(3)
    off, doubted = [], []
    for _ in range(count):
        side, views = int(rng.choice([200, 224, 384])), int(rng.integers(1, 3))
        cover, power = round(rng.uniform(0.3, 0.6), 2), float(rng.choice([1, 1.5]))
        peak = round(rng.uniform(0.25, 0.75) * np.sqrt(cover / np.pi) * side / 2)
        beside = tuple(int(n) for n in rng.normal(0, 0.06 * side, 2))
        rec, carriers = steep_cell(side, views, peak, cover=cover, power=power, off=beside)
        lobes = p4d.find_lobes(rec, views)
        off.append(max(min(pair_distance(lobe.carrier, k) for lobe in lobes) for k in carriers))
        doubted.append(bool(lobes.doubts_of_views))
    far = np.array(off) > 0.03
    line(count, int(far.sum()), int((far & ~np.array(doubted)).sum()))


def outcome(case: Layout, n_views: int | None) -> Outcome:
    """Let the finder look for so many views, or count them."""
    try:
        found = p4d.find_lobes(case.rec, n_views)
        wrong, doubted = not case.found_by(found), bool(found.doubts_of_views)
    except ValueError:  # it says that it can't
        wrong = doubted = True
    few = case.rec.n_frames
    return Outcome(case.regime, case.reference, few, len(case.carriers), wrong, doubted)


def layouts(first: int = 0, count: int = 450) -> None:
    """Which lobes the finder takes, and how often it doubts."""
    heading("Lobes: wrong choices on random layouts", "layouts number wrong-(%)")
    found = [
        outcome(case, len(case.carriers)) for case in map(layout, range(first, first + count))
    ]
    groups: dict[str, Callable[[Outcome], bool]] = {
        **{regime: lambda o, r=regime: o.regime == r for regime in REGIMES},  # type: ignore[misc]
        "reference >= 1": lambda o: o.reference >= 1,
        "reference < 1": lambda o: o.reference < 1,
        "1 frame": lambda o: o.n_frames == 1,
        "6 frames": lambda o: o.n_frames > 1,
        **{f"{n} views": lambda o, n=n: o.n_views == n for n in (2, 3, 4)},  # type: ignore[misc]
    }
    for words, chosen in groups.items():
        some = [o for o in found if chosen(o)]
        line(words, len(some), share([o.wrong for o in some]))
    doubts(found)
    heading("Views counted, 1 to 6, most of them separated", "views number wrong-(%)")
    counted = [
        outcome(layout(seed, 1 + seed % 6, "separated" if seed % 4 else "rims overlap"), None)
        for seed in range(first + count, first + 2 * count)
    ]
    for n in range(1, 7):
        some = [o for o in counted if o.n_views == n]
        line(n, len(some), share([o.wrong for o in some]))
    doubts(counted)
    steep_cells()
    signs()


def doubts(found: list[Outcome]) -> None:
    """Say how many are wrong, and how often that is said."""
    wrong = [o.doubted for o in found if o.wrong]
    right = [o.doubted for o in found if not o.wrong]
    print(
        f"\nWrong: {len(wrong)} of {len(found)} ({share([o.wrong for o in found])} %); "
        f"doubt given in {sum(wrong)} of these, and in {share(right)} % of the right ones."
    )


def share(found: list[bool]) -> str:
    """Return a share in percent."""
    return f"{100 * sum(found) / max(len(found), 1):.1f}"


def signs() -> None:
    """Whether the sign is right, by how much of the field a cell covers."""
    columns = "cover-(%) number wrong-(%) wrong-and-sure-(%) doubted-(%)"
    heading("Sign: cells of 3 to 12 rad", columns)
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE - 0.5
    for cover in (0.003, 0.01, 0.03, 0.1, 0.25, 0.5, 0.65, 0.75, 0.85, 0.95):
        wrong, doubted = [], []
        for seed in range(24):
            rng = np.random.default_rng((seed, int(100 * cover)))
            aspect, centre = np.exp(rng.normal(0, 0.2)), rng.normal(0, 0.05, 2)
            area = cover / np.pi
            inside = 1 - ((y - centre[0]) ** 2 * aspect + (x - centre[1]) ** 2 / aspect) / area
            height = rng.uniform(3, 12) * np.maximum(inside, 0) ** rng.choice((0.5, 1))
            phase = xr.DataArray(
                np.float32(height)[None, None],
                dims=("time", "angle", "y", "x"),
                coords={"time": [0.0], "angle": [0.0]},
            )
            side = rng.choice((-1, 1))
            carrier = (0.2, float(0.2 * side))
            (lobe,) = p4d.find_lobes(multiplexed_video(phase, carriers=[carrier], seed=seed), 1)
            wrong.append(lobe.flip == (side > 0))
            doubted.append("guess" in lobe.doubt)
        sure = [w and not d for w, d in zip(wrong, doubted, strict=True)]
        line(f"{100 * cover:g}", len(wrong), share(wrong), share(sure), share(doubted))
