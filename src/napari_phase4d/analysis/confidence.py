"""How far each pixel of an unwrapped phase is to be trusted, without knowing the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.analysis.balance import (
    BALANCE,
    MISSING_MASS,
    Balance,
    balance_of,
    frames_missing_mass,
)
from napari_phase4d.analysis.itoh import larger_step
from napari_phase4d.later import xr
from napari_phase4d.stack import Block, Stack, stack_of
from napari_phase4d.stacks import (
    in_full,
    on_grid_of,
    unwrapped_stack,
    without_masked,
    wrapped_stack,
)
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.unwrapping import (
    FRAMES_LEFT_OUT,
    METHODS,
    PLATEAUS,
    Astray,
    Judged,
    Problem,
    Residues,
    Support,
    ViewsOf,
    all_wavelengths_known,
    astray,
    every_plateau,
    level_residues,
    odds_by_wavelengths,
    on_its_field,
    run_method,
    supports_by_steps,
    views_apart,
    working_blocks,
)
from napari_phase4d.warned import warn

__all__ = [
    "REFERENCE",
    "above_field",
    "chances_of_right",
    "confidence",
    "judged_of",
    "reference_of",
    "trust_map",
    "turns_off",
    "whole_turns",
]

TURN = 2 * np.pi
#: The method that all others are held against.
REFERENCE = "directional-l1"
#: Logarithm of the odds that a wrap count is wrong: so much, so much for each radian of the
#: roughest step on its way up to ROUGHEST, and so much for each unit by which it is held. Fitted
#: once, to WL1, RGd, T/A and 2-D on one half of the shapes, walls and sparse recordings of
#: ``benchmarks/regimes.py``, thick and noisy ones among them; ``benchmarks/trusting.py`` prints
#: how well it holds on the other.
LEVEL, PER_RADIAN, PER_HOLD = -3.4, 1.0, -9.6
ROUGHEST = 4.0
#: No result is held less than this.
LOOSEST = -0.2
#: Added to the same: so much for each radian by which a pixel stands out from those round it,
#: from OUT on, up to FAR_OUT, if a step beside it is more than half a turn. Chosen for WL1 on the
#: same half, with the other one in view.
PER_OUT = 2.0
OUT, FAR_OUT = 0.5, 2.0
#: Logarithm of the odds that the level of an object is wrong: so much, and so much for each factor
#: of e in one and the residues that stand in the way of it. Fitted to WL1 on the same half.
LEVEL_OF_OBJECT, PER_FACTOR = -20.2, 4.57
#: Added to the logarithm of the odds that it is wrong where the mass that an object misses says
#: that it slipped, see `balance_of`. Chosen on the same half, with the other one in view.
PER_MISSING = 3.5
#: Nothing is trusted more than this where no empty field is in view: of 66 crops from the middle
#: of cells, parts slip against each other in 10.
ADRIFT = np.float32(0.9)
#: The empty field of a frame counts as so many patches, which slip independently of each other.
#: Chosen with both halves in view.
PATCHES = 8
#: Levels that are more turns off are counted as this.
FURTHEST = 100
#: Where wavelengths are asked, steps alone leave so much chance to be right, less where a pixel
#: stands out, and to be wrong: they take a sheer wall for a slip, and a plate of a whole turn for
#: empty field. Chosen with the cells and plates of ``benchmarks/wavelengths.py`` in view.
LEAST_TRUST, LEAST_DOUBT = np.float32(0.3), np.float32(1e-4)
#: A part of a turn that is no rounding, and the share of pixels in which it is no accident.
NOT_WHOLE, MANY_OFF = 0.02, 0.1

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


def confidence(
    unwrapped: xr.DataArray | ArrayLike,
    phase: xr.DataArray | ArrayLike,
    amplitude: xr.DataArray | ArrayLike | None = None,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return the chance, from 0 to 1, that each pixel of a result has the right wrap count.

    Each wrap count is judged by the way that leads to it: of all ways from the empty field over
    time, angle, y and x along steps that agree with the result, the one whose roughest step is
    smoothest. Where no frame shows an empty field, ways begin in the largest part of the boundary
    frame that hangs together, and no chance is above 0.9.

    Where a result differs from directional L1, both ways compete. So it also falls where a whole
    object has slipped: then no smooth way leads into it, or a smoother one contradicts it. And it
    falls for all of an object whose level is not known: residues are in the way from any frame
    that would know it, the empty field itself is torn in two, or its dry mass drops at once by
    what a turn over its area comes to, as in a slip. Few pixels that stand out from those round
    them are trusted less. Where every angle has several wavelengths, it rises and falls with how
    far these agree, in frames that show an empty field: sheer walls have no smooth way, and need
    none then.

    Parameters
    ----------
    unwrapped : DataArray or array_like
        Unwrapped phase of any method in radians, as `unwrap` returns it.
    phase : DataArray or array_like
        The wrapped phase that it was made of, same shape.
    amplitude : DataArray or array_like, optional
        Amplitude of the field, same shape; where it fades, less is trusted.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        float32 in the form of the phase; 0 in frames that say nothing of the object, or fit
        neither the one before nor the one after.

    Raises
    ------
    ValueError
        If the shapes differ, or an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    compare : Several methods; its ``confidence`` and ``verdict`` use the same.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> unwrapped = p4d.unwrap(sample["wrapped"], "spatial-2d")
    >>> trust = p4d.confidence(unwrapped, sample["wrapped"])
    >>> bool((trust >= 0).all() and (trust <= 1).all())
    True
    """
    task = Task(progress, cancelled)
    mask = without_masked(phase, None)
    problem = Problem(wrapped_stack(phase, mask=mask), mask=mask, amplitude=amplitude)
    name = "the unwrapped phase"
    values = unwrapped_stack(on_grid_of(unwrapped, problem.template, name), name)
    doubt_other_phase(values, problem)
    reference = reference_of(problem, task)
    name = str(values.attrs.get("method", "")) or "result"
    found = chances_of_right(problem, {name: values}, reference, task)[name]
    return trust_map(problem, found, name, str(values.attrs.get("method", "")))


def doubt_other_phase(unwrapped: xr.DataArray, problem: Problem) -> None:
    """Warn if a result is not the phase and whole turns: it may be of another recording."""
    if unwrapped.attrs.get("method") == "laplacian":  # an estimate, as its page says
        return
    off = (in_full(unwrapped) - problem.wrapped) / np.float32(TURN)
    known = problem.usable & np.isfinite(off)
    if unwrapped.attrs.get("mask", "none") != "none":
        known &= in_full(unwrapped) != 0
    share = float((np.abs(off - np.round(off))[known] > NOT_WHOLE).mean()) if known.any() else 0.0
    if share > MANY_OFF:
        warn(
            f"in {100 * share:.0f} % of the pixels the unwrapped phase is not the wrapped phase "
            "and whole turns; are both of the same recording?"
        )


def reference_of(
    problem: Problem,
    task: Task = UNWATCHED,
) -> xr.DataArray:
    """Return the result of directional L1 on a problem, computed once."""
    return problem.once(REFERENCE, lambda: run_method(problem, REFERENCE, task, {}))


def chances_of_right(
    problem: Problem,
    results: Mapping[str, xr.DataArray | None],
    reference: xr.DataArray | None = None,
    task: Task = UNWATCHED,
) -> dict[str, Stack]:
    """Return what `confidence` gives for some results, of stacks of any length.

    Where these lie on disk they go when the problem is tidied, unless `trust_map` keeps them.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    results : mapping of str to DataArray or None
        Unwrapped phase in the form of the problem's, by method; None for the reference itself.
    reference : DataArray, optional
        The result of directional L1; default: it is computed on the way.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    maps = {name: problem.result_stack(f"confidence_{name}") for name in results}
    judged = {
        name: None if result is None or result is reference else judged_of(result, problem)
        for name, result in results.items()
    }
    own = None if reference is None else judged_of(reference, problem)
    told = bool(problem.parts()) and all_wavelengths_known(problem)
    if told:
        own = own or reference_on_the_way(problem, task)
    shape = problem.given.shape
    steps = (
        {n: problem.store.temporary(f"steps_{n}", shape, "float32") for n in maps}
        if told
        else maps
    )
    for views, part in problem.by_wavelength():
        chosen = {n: None if j is None else j.of_views(views) for n, j in judged.items()}
        of_part = reference_on_the_way(part, task) if own is None else own.of_views(views)
        into = {name: ViewsOf(stack, views) for name, stack in steps.items()}
        by_steps(part, chosen, of_part, into, task)
    problem.frames_left_out()  # noted, while the parts know it, and so is this
    problem.once(MISSING_MASS, partial(frames_missing_mass, problem))
    problem.once(PLATEAUS, partial(every_plateau, problem))
    if told:
        assert own is not None
        every = {n: j or own for n, j in judged.items()}
        by_wavelengths(problem, every, steps, maps, task)
    return maps


def trust_map(problem: Problem, values: Stack, name: str, method: str) -> xr.DataArray:
    """Return a map as `confidence` gives it.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    values : Stack
        The map.
    name : str
        By which the result was given to `chances_of_right`.
    method : str
        Id of the method, if it is known.
    """
    attrs = {"of": method, "units": "1"}
    return problem.map_of(values, f"confidence_{name}", attrs).rename("confidence")


def judged_of(result: xr.DataArray, problem: Problem) -> Judged:
    """Return a result of a problem as it is judged."""
    masked = result.attrs.get("mask", "none") != "none"
    return Judged(stack_of(result), problem.given if masked else None)


def reference_on_the_way(problem: Problem, task: Task) -> Judged:
    """Return the result of directional L1, which is needed on the way only."""

    def unwrapped() -> Judged:
        found = problem.store.temporary("reference", problem.given.shape, "float32")
        # Changes from view to view say nothing where their wavelengths differ.
        for views, part in problem.by_wavelength():
            METHODS[REFERENCE].function(part, ViewsOf(found, views), task)
        masked = problem.finds_mask or not problem.all_usable
        return Judged(found, problem.given if masked else None)

    return problem.once("reference", unwrapped)


def by_steps(
    problem: Problem,
    results: Mapping[str, Judged | None],
    reference: Judged,
    maps: Mapping[str, Stack],
    task: Task,
) -> None:
    """Write the chance that each wrap count is right, by the ways that lead to it."""
    wanted = {name: result for name, result in results.items() if result is not None}
    if not problem.knows("support"):
        wanted["reference"] = reference
    seen = on_its_field(problem, reference, task)
    if seen is not problem:
        frames_that_fit(problem, task)  # by which it was unwrapped
        problem.forget_field()  # it is as large as that which comes
    supports = supports_by_steps(seen, wanted, task)
    rival = problem.once("support", lambda: supports["reference"])
    noise, residues = astray(seen, task), level_residues(seen, task)
    if seen is not problem:
        problem.note(FRAMES_LEFT_OUT, problem.frames_left_out() | seen.frames_left_out())
    balance = problem.once(BALANCE, lambda: balance_of(seen, reference, task))
    empty = seen.background().empty
    blocks = working_blocks(problem.given.shape)
    watch = Watch(len(blocks) * len(results), "weighing the results", task)
    for name, result in results.items():
        chance = ChanceBlock(
            problem,
            result or reference,
            reference,
            supports.get(name, rival),
            rival,
            noise,
            residues,
            balance,
            empty,
            maps[name],
        )
        for _ in in_threads(chance, blocks, watch, wait=True):
            pass
    if seen is not problem:
        seen.forget_field()


def frames_that_fit(problem: Problem, task: Task) -> None:
    """Look which frames fit to those beside them, if no directional method has looked."""
    if not problem.knows(FRAMES_LEFT_OUT):
        astray(problem, task)


@dataclass(frozen=True)
class ChanceBlock:
    """Writes the chance that the wrap counts of a block are right.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    result, reference : Judged
        The result, and that of directional L1.
    own, rival : Support
        What the steps say of both.
    noise : Astray
        What noise does.
    residues : Residues
        What stands in the way of the levels of objects.
    balance : Balance
        What mass they miss.
    empty : Stack
        The empty field.
    found : Stack
        Where the chance goes.
    """

    problem: Problem
    result: Judged
    reference: Judged
    own: Support
    rival: Support
    noise: Astray
    residues: Residues
    balance: Balance
    empty: Stack
    found: Stack

    def __call__(self, block: Block) -> None:
        """Do a block."""
        values = self.result.read(block)
        own = self.result is self.reference
        others = values if own else self.reference.read(block)
        empty = self.empty.read(block)
        turns = above_field(whole_turns(values, others), empty)
        differs = turns != 0
        weight, rival = odds_of_right(self.own, block), odds_of_right(self.rival, block)
        in_line = odds_in_line(values)
        weight *= in_line
        rival *= in_line if own else odds_in_line(others)
        weight = np.where(differs, weight, np.maximum(weight, rival))
        still = 1 - self.noise.read(block)
        chance = still * weight / (1 + weight + np.where(differs, rival, 0))
        # Another result has a level of its own.
        chance *= np.where(differs, 1, level_known(self.residues, block))
        missing = np.where(differs, np.float32(0), self.balance.read(block))
        if missing.any():
            chance /= chance + (1 - chance) * np.exp(np.float32(PER_MISSING) * missing)
        chance *= field_known(turns, empty)[..., None, None]
        if not self.rival.anchored:
            chance = np.where(np.isnan(values), ADRIFT, ADRIFT * chance)  # NaN: masked
        chance[self.problem.frames_left_out()[block.start : block.stop]] = 0
        self.found.write(block, chance.astype(np.float32))


def by_wavelengths(
    problem: Problem,
    results: Mapping[str, Judged],
    steps: Mapping[str, Stack],
    maps: Mapping[str, Stack],
    task: Task,
) -> None:
    """Write the chance that each wrap count is right, by its steps and by how wavelengths agree.

    Where phase is flat, wavelengths tell what no steps do: how high a sheer wall is. Where it is
    steep they tell little, and a method that makes them agree often does so at a wrong count.

    Parameters
    ----------
    problem : Problem
        What was unwrapped; every angle has several wavelengths.
    results : mapping of str to Judged
        The results, by method.
    steps, maps : mapping of str to Stack
        The chance by steps alone, and where that by both goes.
    task : Task
        Who is told of it, and may stop it.
    """
    views_apart(problem, task)  # which all blocks ask for, and none could be stopped in
    blocks = working_blocks(problem.given.shape)
    left_out = problem.frames_left_out()
    watch = Watch(len(blocks) * len(results), "weighing the results", task)
    for name, result in results.items():

        def work(block: Block, name: str = name, result: Judged = result) -> None:
            values = result.read(block)
            by_steps_alone = steps[name].read(block)
            least = LEAST_TRUST * odds_in_line(values)
            chance = np.maximum(by_steps_alone, least)
            odds = odds_by_wavelengths(problem, values, block)
            told = chance * odds / (chance * odds + np.maximum(1 - chance, LEAST_DOUBT))
            told = np.where(np.isnan(odds), by_steps_alone, told)
            told[np.isnan(values)] = 1  # masked: taken for empty field
            # What has no partner at another wavelength is not known, and not to be trusted.
            told[np.isnan(result.values.read(block))] = 0
            told[left_out[block.start : block.stop]] = 0
            maps[name].write(block, told.astype(np.float32))

        for _ in in_threads(work, blocks, watch, wait=True):
            pass


def odds_of_right(support: Support, block: Block) -> Image:
    """Return the odds, right to wrong, of wrap counts that are supported so well."""
    rough = np.minimum(support.roughest.read(block), np.float32(ROUGHEST))
    held = np.maximum(support.held.read(block), np.float32(LOOSEST))
    odds: Image = np.exp(-(LEVEL + PER_RADIAN * rough + PER_HOLD * held))
    return odds


def odds_in_line(values: Image) -> Image:
    """Return by what the odds of phase (time, angle, y, x) change where it stands out.

    A pixel that is wrong alone, or with a few others, is a turn off from those round it: beside a
    step of more than half a turn. What is thin or small and has no such step is not doubted, nor
    are straight edges, where half of nine pixels lie on either side. Pixels beside what is not
    known are left as they are.
    """
    odds = np.empty_like(values)
    for frame in np.ndindex(*values.shape[:2]):  # which stay in the cache one by one
        phase = values[frame]
        with np.errstate(invalid="ignore"):  # NaN, see above
            out = np.abs(phase - median_of_nine(phase))
            judged = (out > OUT) & np.any(
                [larger_step(phase, axis) > 1 for axis in (0, 1)], axis=0
            )
        further = np.where(judged, np.minimum(out, FAR_OUT) - np.float32(OUT), np.float32(0))
        odds[frame] = np.exp(-np.float32(PER_OUT) * further)
    return odds


def median_of_nine(frame: Image) -> Image:
    """Return the median of each pixel of a frame and the eight round it, mirrored at its edges.

    It lies between the largest of three small, the middle of three middle and the smallest of
    three large ones, if every three along y are put in order first: `scipy.ndimage.median_filter`
    gives the same, and takes ten times as long.
    """
    rows = np.pad(frame, 1, mode="symmetric")
    ordered = in_order(rows[:-2], rows[1:-1], rows[2:])
    low, middle, high = (in_order(v[:, :-2], v[:, 1:-1], v[:, 2:]) for v in ordered)
    return in_order(low[2], middle[1], high[0])[1]


def in_order(one: Image, two: Image, three: Image) -> tuple[Image, Image, Image]:
    """Return the smallest, the middle and the largest of three numbers each."""
    low, high = np.minimum(one, two), np.maximum(one, two)
    return np.minimum(low, three), np.clip(three, low, high), np.maximum(high, three)


def level_known(residues: Residues, block: Block) -> Image:
    """Return the chance that the levels of objects are right, by the residues in their way."""
    counts = residues.read(block)
    known: Image = 1 / (1 + np.exp(np.float32(LEVEL_OF_OBJECT)) * (1 + counts) ** PER_FACTOR)
    return known.astype(np.float32)


def whole_turns(one: Image, other: Image) -> Image:
    """Return by how many whole turns two results differ; 0 where either is not known."""
    found: Image = np.nan_to_num(np.round((one - other) / np.float32(TURN)))
    return found


def above_field(turns: Image, empty: Mask) -> Image:
    """Return turns relative to the median of each frame's empty field (time, angle, y, x).

    A method that lets a whole frame slip has its field a turn off with it: the object is right
    above it. One that lets the field slip alone has all of the object wrong above it.
    """
    found = turns.copy()
    for frame in np.ndindex(*turns.shape[:2]):
        if empty[frame].any():
            levels = turns[frame][empty[frame]]
            middle = (levels.size - 1) // 2  # a level that there is, not half way between two
            found[frame] -= np.partition(levels, middle)[middle]
    return found


def field_known(turns: Image, empty: Mask) -> Image:
    """Return the chance that the level of each frame's field is known (time, angle).

    A method that goes pixel by pixel, as Temporal, may tear the field itself in two. Where both
    parts are about as large, an object above one is a turn off above the other. If `PATCHES`
    patches slip independently, all of them are at a level with its share to that power.

    Parameters
    ----------
    turns : ndarray of float
        Turns that a result is off, above the empty field, see `above_field`.
    empty : ndarray of bool, same shape
        The empty field.
    """
    known = np.ones(turns.shape[:2], dtype=np.float32)
    for frame in np.ndindex(*known.shape):
        if empty[frame].any():
            levels = np.clip(turns[frame][empty[frame]], -FURTHEST, FURTHEST)
            counts = np.bincount(levels.astype(np.intp) + FURTHEST, minlength=FURTHEST + 1)
            votes = (counts / counts.max()) ** PATCHES
            known[frame] = votes[FURTHEST] / votes.sum()
    return known


def turns_off(result: xr.DataArray, reference: xr.DataArray) -> xr.DataArray:
    """Return by how many whole turns two results of the same pixels differ."""
    every = Block(0, result.sizes.get("time", 1))
    reference = reference.transpose(*result.dims)
    one, other = (stack_of(stack).read(every) for stack in (result, reference))
    off = whole_turns(one, other).reshape(result.shape)
    return result.copy(data=off)
