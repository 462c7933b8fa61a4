"""The recordings of the suite: what they show, what is wrong with them, and the exact phase."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography import Lobe, reconstruct
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation import (
    FAULTS,
    HARD_SHAPES,
    SHAPES,
    budding_yeast,
    hard_shape,
    moving_shape,
    multiplexed_video,
    pixels_of,
    swimming_euglena,
    with_fault,
    with_noise,
)
from napari_phase4d.words import shown

__all__ = ["GROUPS", "SUITE_VERSION", "Case", "cases", "checked_groups"]

#: Rises whenever a case is added, left out or changed after its release, so that figures are
#: compared only with figures of the same suite.
SUITE_VERSION = 1

#: Pixels with less phase than this, in radians, are the empty field around the object.
EMPTY_RAD = 0.05
#: Objects of the groups that don't take all of them.
NOISY = ("dividing", "tumbling", "vacuole", "lamella", "ring")
SPARSE = ("dividing", "tumbling", "swelling", "bent tube", "cluster", "blebs")
ONE_VIEW = ("dividing", "touching", "neuron", "steep hill")
#: Thickness of the euglena behind the optics, in radians, in the full recording.
THICK_RAD = (12.0, 16.0, 20.0)
#: Side of the camera's frames, and how many there are.
CAMERA, CAMERA_FRAMES = 256, 16
#: After these faults the empty field lies elsewhere in the frame.
FIELD_MOVES = ("kick", "pause")


@dataclass(frozen=True)
class Case:
    """A recording of the suite.

    Parameters
    ----------
    group, name : str
        What it is made to show, and the object.
    wrapped, truth : xarray.DataArray
        Wrapped phase, and what an unwrapper that is right everywhere returns: with the noise, NaN
        where the camera showed something else. Dims (time, angle, y, x), radians.
    empty : ndarray of bool
        The empty field, in the form of the phase.
    boundary : tuple of int
        The frame (time, angle) in which the object is thinnest; every method starts there.
    amplitude : xarray.DataArray, optional
        Where the case was a hologram.
    """

    group: str
    name: str
    wrapped: xr.DataArray
    truth: xr.DataArray
    empty: NDArray[np.bool_]
    boundary: tuple[int, int]
    amplitude: xr.DataArray | None = None

    @property
    def voxels(self) -> int:
        """How many pixels there are in all frames."""
        return self.wrapped.size


#: Name of each recording -> what makes it.
Group = dict[str, Callable[[], Case]]


def cases(groups: Sequence[str] | None = None) -> Iterator[Case]:
    """Yield the recordings of the suite, each simulated when it is asked for.

    Random numbers are drawn with seeds of their own, so that a case is the same in every run.

    Parameters
    ----------
    groups : sequence of str, optional
        Some of `GROUPS`. Default: all.

    Yields
    ------
    Case
        Wrapped and exact phase in radians, dims (time, angle, y, x), group after group.

    Raises
    ------
    ValueError
        If there is no such group.

    Examples
    --------
    >>> from napari_phase4d.benchmark.cases import cases
    >>> case = next(cases(["one view"]))
    >>> case.name, dict(case.wrapped.sizes), case.boundary
    ('dividing', {'time': 20, 'angle': 1, 'y': 64, 'x': 64}, (0, 0))
    """
    for group in checked_groups(groups):
        for make in GROUPS[group].values():
            yield make()


def checked_groups(groups: Sequence[str] | None) -> list[str]:
    """Return names of groups as a list; ValueError for one that is none."""
    chosen = list(GROUPS) if groups is None else [groups] if isinstance(groups, str) else groups
    for group in chosen:
        if group not in GROUPS:
            msg = f"group must be one of {', '.join(GROUPS)}, but is {shown(group)}"
            raise ValueError(msg)
    return list(chosen)


def object_(name: str) -> xr.Dataset:
    """Return a simulated object with its exact phase."""
    if name == "budding yeast":
        return budding_yeast((64, 64))
    if name == "swimming euglena":
        return swimming_euglena((64, 64), 40, pixel_um=44 / 64)
    return moving_shape(name) if name in SHAPES else hard_shape(name)


def seed_of(*words: object) -> int:
    """Return the seed of a case: the words that name it."""
    return zlib.crc32("/".join(map(str, words)).encode()) % 100_000


def thinnest(exact: xr.DataArray, truth: xr.DataArray) -> tuple[int, int]:
    """Return the frame with the least phase among those whose truth is known."""
    highest = np.abs(exact.values).max(axis=(2, 3))
    highest[~np.isfinite(truth.values).any(axis=(2, 3))] = np.inf
    time, angle = np.unravel_index(int(np.argmin(highest)), highest.shape)
    return int(time), int(angle)


def case_of(
    group: str, name: str, exact: xr.DataArray, seen: xr.Dataset, amplitude: xr.DataArray | None
) -> Case:
    """Return a case of exact phase without noise, and of what is seen of it."""
    return Case(
        group,
        name,
        seen["wrapped"],
        seen["phase"],
        np.abs(exact.values) < EMPTY_RAD,
        thinnest(exact, seen["phase"]),
        amplitude,
    )


def noisy(
    group: str, name: str, simulated: str, noise_rad: float, frames: dict[str, slice] | None = None
) -> Case:
    """Return an object, or some of its frames, with white noise."""
    exact = object_(simulated).isel(frames or {})
    seen = with_noise(exact, noise_rad, seed=seed_of(group, name, noise_rad))
    return case_of(group, name, exact["phase"], seen, None)


def faulty(group: str, fault: str) -> Case:
    """Return a cell that divides, and what goes wrong half way through."""
    exact = object_("dividing")
    seen = with_fault(exact, fault, 0.2, seed_of(group, fault))
    clean = with_fault(exact, fault)["phase"] if fault in FIELD_MOVES else exact["phase"]
    return case_of(group, fault, clean, seen, None)


def hologram(group: str, name: str, peak_rad: float) -> Case:
    """Return what is reconstructed of holograms: two views at once, 8 bit, shot noise, a pupil."""
    optics = Optics(camera_pixel_um=2 * Optics().camera_pixel_um)
    pixel_um = optics.pixel_um
    exact = swimming_euglena((CAMERA, CAMERA), CAMERA_FRAMES, pixel_um=pixel_um, peak_rad=peak_rad)
    video = multiplexed_video(exact["phase"], optics, seed=seed_of(group, peak_rad))
    carriers = video.holograms.attrs["carriers"]
    lobes = [Lobe(k, 0.089, a) for k, a in zip(carriers, exact["angle"].values, strict=True)]
    data = reconstruct(video, lobes)
    shape = data.sizes["y"], data.sizes["x"]
    there = swimming_euglena(shape, CAMERA_FRAMES, **pixels_of(data["phase"]), peak_rad=peak_rad)
    clean = data["phase"].copy(data=there["phase"].values)
    # The optics blur: the right cycle is the one nearest to the exact phase.
    off = np.angle(np.exp(1j * (data["phase"].values - clean.values))).astype(np.float32)
    seen = xr.Dataset({"wrapped": data["phase"], "phase": clean + off})
    return case_of(group, name, clean, seen, data["amplitude"])


def named(group: str, noise_rad: float, names: Sequence[str], **frames: slice) -> Group:
    """Return a group of objects with one noise."""
    return {n: partial(noisy, group, n, n, noise_rad, frames) for n in names}


#: Name of each group -> name of each recording -> what makes it.
GROUPS: dict[str, Group] = {
    # Cells that swim, turn, divide and swell; the two of the paper among them.
    "moving cells": named("moving cells", 0.2, ("budding yeast", "swimming euglena", *SHAPES)),
    # Walls, tubes, shocks, hills that are steeper than half a turn a pixel.
    "hard shapes": named("hard shapes", 0.2, tuple(HARD_SHAPES)),
    # Noise that wraps steps by itself.
    "much noise": {
        words: partial(noisy, "much noise", words, name, noise)
        for name in NOISY
        for noise in (0.5, 0.8)
        for words in (f"{name}, {noise:g} rad",)
    },
    # What goes wrong half way through a recording.
    "faults": {fault: partial(faulty, "faults", fault) for fault in FAULTS},
    # Every third frame of the second half, so that cells are thick from the start and jump.
    "time lapse": named("time lapse", 0.3, SPARSE, time=slice(10, None, 3)),
    # What time alone can tell.
    "one view": named("one view", 0.3, ONE_VIEW, angle=slice(0, 1)),
    "through the optics": {
        f"euglena, {peak:g} rad": partial(
            hologram, "through the optics", f"euglena, {peak:g} rad", peak
        )
        for peak in THICK_RAD
    },
}
