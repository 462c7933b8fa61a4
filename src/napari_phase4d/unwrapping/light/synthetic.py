"""Unwrapping by the synthetic wavelength of views that differ in nothing but their wavelength."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Limits, ReadOnly, Stack, limits_of
from napari_phase4d.task import Task
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.chain import temporal_angular
from napari_phase4d.unwrapping.directional import directional_l1
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import Given
from napari_phase4d.unwrapping.light.alignment import warn_of_views_apart
from napari_phase4d.unwrapping.light.steps import (
    led_to_edges,
    settled_turns,
    steps_between,
    unwrapped_where_smooth,
    wrapped_to_turn,
)
from napari_phase4d.unwrapping.light.views import Rung, frames_among, ladder_of, noise_between
from napari_phase4d.unwrapping.objects import object_mask
from napari_phase4d.unwrapping.problem import Problem

__all__ = [
    "BEATS",
    "Group",
    "all_wavelengths_known",
    "check_wavelengths",
    "groups_of",
    "scene_of",
    "synthetic_wavelength",
]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

TURN = np.float32(2 * np.pi)
#: The least noise that is reckoned with, in radians: of the levels, and of what is no noise.
LEAST_NOISE = 0.05
#: How the phase of the longest synthetic wavelength is unwrapped over several frames ...
OVER_FRAMES: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"temporal-angular": temporal_angular, "directional-l1": directional_l1}
)
#: ... or in each frame by itself, or not at all.
BEATS = ("spatial", *OVER_FRAMES, "wrapped")


def synthetic_wavelength(
    problem: Problem,
    result: Stack,
    task: Task,
    *,
    beat: str = "spatial",
    settle: bool = True,
    cauchy_um2: float = 0.0,
) -> list[Limits]:
    """Unwrap views of one angle by each other's wavelengths, from the longest synthetic one down.

    The difference of the phases at two wavelengths is the phase of their synthetic wavelength,
    which is longer than either. The longest is unwrapped first, should it still wrap; each shorter
    one follows from the one before, which chooses its whole turns and adds no noise beside (Gass,
    Dakoff & Kim 2003; Mirsky & Shaked 2023). Steps of any height are told, as long as the path
    differs by less than half the longest synthetic wavelength from pixel to pixel.

    A view that says nothing in a frame, see `lost_frames`, takes no part in it: the other
    wavelengths of its angle are then unwrapped without it. Where only one is left, there is no
    synthetic wavelength, and the frame is unwrapped by itself: its steps must be less than half
    the wavelength then, and nothing tells whether they are.

    Parameters
    ----------
    problem : Problem
        What to unwrap; every angle has two wavelengths or more.
    result : Stack
        Where the unwrapped phase goes.
    task : Task
        Who is told of it, and may stop it.
    beat : str, optional
        How the phase of the longest synthetic wavelength is unwrapped: "spatial" (default), in
        each frame, where it is smooth: what walls cut off is taken to be thinner than half that
        wavelength, unless it wraps in itself; "temporal-angular" or "directional-l1", by these
        methods; or "wrapped", not at all.
    settle : bool, optional
        Whether turns that noise leaves in doubt are settled together with their neighbours'.
        Default True; False chooses the turns of each pixel by itself, as published.
    cauchy_um2 : float, optional
        How the refractive index of the object, less that of the medium, depends on the wavelength:
        as 1 + C / wavelength^2, C in square micrometres. Default 0.

    Returns
    -------
    list of (float, float)
        Smallest and largest phase of every block, radians.

    Raises
    ------
    ValueError
        If an angle has one wavelength only.

    Warns
    -----
    UserWarning
        If views of an angle are shifted against each other by a pixel or more.
    """
    check_wavelengths(problem.wavelengths_um, problem.angles_deg)
    warn_of_views_apart(problem, task)
    groups = groups_of(problem, cauchy_um2)
    scene = scene_of(problem, groups)
    unwrapped = None
    if beat in OVER_FRAMES:
        unwrapped = unwrapped_beats(problem, scene, beat, task)
    settings = Settings(beat, settle, problem.finds_mask)
    work = FinishBlock(problem.given, scene, unwrapped, settings, result)
    return problem.each(work, "going down the wavelengths", task)


def check_wavelengths(
    wavelengths_um: NDArray[np.float64] | None, angles_deg: Sequence[float] | NDArray[np.floating]
) -> None:
    """Refuse views of which an angle has no two wavelengths.

    Parameters
    ----------
    wavelengths_um : ndarray of shape (view,) or None
        In micrometres.
    angles_deg : sequence of float
        Angle of each view in degrees.

    Raises
    ------
    ValueError
        In one sentence that says what there is, and what to do.
    """
    advice = (
        'give each lobe its wavelength_um and its angle, or phase a coordinate "wavelength" along '
        "the angle"
    )
    need = "synthetic-wavelength needs two or three wavelengths at every angle"
    if wavelengths_um is None or len(np.unique(wavelengths_um)) < 2:
        said = "none is noted"
        if wavelengths_um is not None:
            said = f"there is one only, {wavelengths_um[0]:g} um"
        msg = f"{need}, but {said}; {advice}"
        raise ValueError(msg)
    for angle in np.unique(angles_deg):
        own = wavelengths_um[np.asarray(angles_deg) == angle]
        if len(own) < 2:
            msg = f"{need}, but the angle {angle:g} has {own[0]:g} um only; {advice}"
            raise ValueError(msg)


def has_every_wavelength(
    wavelengths_um: NDArray[np.float64] | None, angles_deg: NDArray[np.floating]
) -> bool:
    """Say whether every angle has two wavelengths or more."""
    try:
        check_wavelengths(wavelengths_um, angles_deg)
    except ValueError:
        return False
    return True


def all_wavelengths_known(problem: Problem) -> bool:
    """Say whether every angle has several wavelengths, which can be held against each other."""
    return has_every_wavelength(problem.wavelengths_um, problem.angles_deg)


# ---- what belongs together -------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """The views of one angle.

    Parameters
    ----------
    views : tuple of int
        Their numbers.
    light : tuple of float
        Their wavelengths in micrometres, longer by as much as dispersion makes the path shorter.
    ladder : tuple of Rung
        The wavelengths to go down by.
    noises : tuple of float
        Standard deviation of each view's noise in radians.
    """

    views: tuple[int, ...]
    light: tuple[float, ...]
    ladder: tuple[Rung, ...]
    noises: tuple[float, ...]

    @property
    def noise(self) -> float:
        """Standard deviation of a view's noise in radians."""
        return max(LEAST_NOISE, float(np.sqrt(np.mean(np.square(self.noises)))))

    def without(self, lost: Mask) -> Group:
        """Return those views that say something in a frame; all of them if none does.

        Parameters
        ----------
        lost : ndarray of bool, shape (view,)
            Which of all views say nothing.
        """
        left = [i for i, view in enumerate(self.views) if not lost[view]]
        if not left or len(left) == len(self.views):
            return self
        light = tuple(self.light[i] for i in left)
        return Group(
            tuple(self.views[i] for i in left),
            light,
            tuple(ladder_of(light)),
            tuple(self.noises[i] for i in left),
        )


def groups_of(problem: Problem, cauchy_um2: float) -> list[Group]:
    """Return the views of each angle, with the way down their wavelengths."""
    wavelengths, angles = problem.wavelengths_um, problem.angles_deg
    assert wavelengths is not None
    seen = {view: part.background().noise for views, part in problem.parts() for view in views}
    found = []
    for angle in np.unique(angles):
        views = tuple(np.flatnonzero(angles == angle).tolist())
        light = wavelengths[list(views)]
        light = light / (1 + cauchy_um2 / light**2)
        noises = tuple(seen[view] for view in views)
        found.append(Group(views, tuple(light), tuple(ladder_of(tuple(light))), noises))
    return found


@dataclass(frozen=True)
class Scene:
    """The views of each angle, against their empty field.

    Parameters
    ----------
    groups : tuple of Group
        The views of each angle.
    background : Background
        The empty field of all views.
    level : ndarray of float, shape (time, view)
        Its phase in radians, unwrapped over time.
    lost : ndarray of bool, shape (time, view)
        Frames that say nothing.
    """

    groups: tuple[Group, ...]
    background: Background
    level: NDArray[np.float64]
    lost: Mask

    def ground(self, block: Block) -> Image:
        """Return the phase of the empty field in a block, in radians."""
        return self.background.ground(self.level, block)

    def whole(self) -> Mask:
        """Mark the frames (time, group) in which every view of an angle says something."""
        return np.stack([~self.lost[:, list(g.views)].any(axis=1) for g in self.groups], axis=1)


def scene_of(problem: Problem, groups: list[Group]) -> Scene:
    """Return the views of each angle with the level of their empty field."""
    background = problem.background()
    level = np.zeros_like(background.level)
    for views, part in problem.parts():
        level[:, list(views)] = border_medians(part.background().level, part.first)
    return Scene(tuple(groups), background, level, problem.lost())


# ---- the longest synthetic wavelength --------------------------------------------------------


@dataclass(frozen=True)
class Beats(ReadOnly):
    """Phase of the longest synthetic wavelength of each angle, wrapped; NaN where not known.

    Parameters
    ----------
    given : Given
        Phase of all views.
    scene : Scene
        Which of them belong together.
    """

    given: Given
    scene: Scene

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        n_times, _, *frame = self.given.shape
        return (n_times, len(self.scene.groups), *frame)

    def read(self, block: Block, angles: slice = slice(None)) -> Image:
        """Return the frames of a block, or some of its angles."""
        wrapped, usable = self.given.read(block)
        phase = wrapped - self.scene.ground(block)
        # What is left where a view is lost has another synthetic wavelength, or none.
        whole = self.scene.whole()[block.start : block.stop, angles]
        found = []
        for number, group in enumerate(self.scene.groups[angles]):
            views = list(group.views)
            own = wrapped_to_turn(group.ladder[0].phase(np.moveaxis(phase[:, views], 1, 0)))
            known = usable[:, views].all(axis=1) & whole[:, number, None, None]
            found.append(np.where(known, own, np.float32(np.nan)))
        return np.stack(found, axis=1)


def unwrapped_beats(
    problem: Problem,
    scene: Scene,
    beat: str,
    task: Task,
) -> Stack | None:
    """Return the unwrapped phase of the longest synthetic wavelength, (time, angle, y, x).

    None if there is no frame in which all views of its angle say something.
    """
    if not scene.whole().any():
        return None
    stack = Beats(problem.given, scene)
    angles = np.array([problem.angles_deg[group.views[0]] for group in scene.groups])
    times = problem.template.coords.get("time")
    first = [group.views[0] for group in scene.groups]
    boundaries = frames_among(problem.boundaries, first, problem.angles_deg)
    coords: dict[str, Any] = {"angle": angles}
    if times is not None and times.ndim:
        coords["time"] = np.asarray(times.values)
    own = problem.derived(stack, coords, boundaries, "beat")
    found = own.store.temporary("unwrapped", stack.shape, "float32")
    OVER_FRAMES[beat](own, found, task)
    return found


# ---- down to the shortest wavelength ---------------------------------------------------------


@dataclass(frozen=True)
class Settings:
    """What was asked for, see `synthetic_wavelength`.

    Parameters
    ----------
    beat : str
        How the phase of the longest synthetic wavelength is unwrapped.
    settle : bool
        Whether neighbours are asked.
    finds_mask : bool
        Whether the object is what is to be unwrapped.
    """

    beat: str
    settle: bool
    finds_mask: bool


@dataclass(frozen=True)
class FinishBlock:
    """Goes down the wavelengths in every frame of a block, and writes all views.

    Parameters
    ----------
    given : Given
        Wrapped phase of all views.
    scene : Scene
        Which of them belong together.
    beats : Stack or None
        Unwrapped phase of the longest synthetic wavelengths, where it is known already.
    settings : Settings
        What was asked for.
    result : Stack
        Where the unwrapped phase goes.
    """

    given: Given
    scene: Scene
    beats: Stack | None
    settings: Settings
    result: Stack

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        wrapped, usable = self.given.read(block)
        ground = self.scene.ground(block)
        phase = wrapped - ground
        beats = None if self.beats is None else self.beats.read(block)
        whole = self.scene.whole()[block.start : block.stop]
        unwrapped = np.zeros_like(wrapped)
        for time in range(len(block)):
            for number, group in enumerate(self.scene.groups):
                seen = group.without(self.scene.lost[block.start + time])
                views = list(seen.views)
                common = np.asarray(usable[time, views].all(axis=0))
                start = beats[time, number] if beats is not None and whole[time, number] else None
                path = self.path_of(seen, phase[time, views], common, start)
                for view, light in zip(group.views, group.light, strict=True):
                    turns = np.rint((path / np.float32(light) - phase[time, view]) / TURN)
                    own = wrapped[time, view] + TURN * turns
                    known = common & usable[time, view]
                    inside = known & self.wanted(own - ground[time, view], known)
                    unwrapped[time, view] = np.where(inside, own, np.float32(0))
                    # What is seen at one wavelength only has no path that is known.
                    unwrapped[time, view][usable[time, view] & ~common] = np.nan
        unwrapped = self.given.without_unknown(unwrapped, usable)
        self.result.write(block, unwrapped)
        return limits_of(unwrapped)

    def path_of(self, group: Group, phases: Image, known: Mask, start: Image | None) -> Image:
        """Return 2 pi times the optical path of a frame in micrometres, from one angle's views.

        A view that is left alone is unwrapped in place of the beat that it has not.
        """
        ladder, settings = group.ladder, self.settings
        steps = steps_between(phases, group.light, group.noise)
        coarse = wrapped_to_turn(ladder[0].phase(phases)) if start is None else start
        coarse = np.where(known, coarse, np.float32(0))
        if start is None and settings.beat != "wrapped":
            coarse = unwrapped_where_smooth(coarse, steps, known)
        for before, rung in pairwise(ladder):
            fine = wrapped_to_turn(rung.phase(phases))
            scale = np.float32(before.wavelength_um / rung.wavelength_um)
            estimate = (scale * coarse - fine) / TURN
            if not settings.settle:
                turns = np.rint(estimate)
            else:
                noise = noise_between(before, rung) * group.noise
                shorter = steps.of(fine, rung.wavelength_um)
                turns = settled_turns(estimate, shorter, noise, known).astype(np.float32)
            coarse = fine + TURN * turns
        path: Image = coarse * np.float32(ladder[-1].wavelength_um)
        return led_to_edges(path, known) if settings.settle else path

    def wanted(self, about_zero: Image, known: Mask) -> Mask:
        """Return the pixels that are to be unwrapped: the object, where it is to be found."""
        if not self.settings.finds_mask:
            return known
        return object_mask(np.where(known, about_zero, np.float32(0)))
