"""What a run begins with: the files that a recipe names, and the frame it starts from.

Any thread or process can read the frames: it opens the files anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis import Comparison
from napari_phase4d.holography import Lobe
from napari_phase4d.holography.lobes import in_order_of_angle
from napari_phase4d.io import address_of, file_pixel_um, open_input
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics, optics_for_pixel, pixel_note, with_typed_numbers
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.sample import is_sample, open_sample
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.unwrapping import best_frame, scores_of_some, scores_sentence
from napari_phase4d.warned import warn
from napari_phase4d.words import checked_call, counted, frame_in_words

__all__ = [
    "FOUND_BY",
    "FrameSource",
    "found_anywhere",
    "light_for",
    "lobes_of",
    "noting_start",
    "open_by",
    "say_what_counts",
    "say_what_file_says",
    "start_sentence",
    "start_words",
    "typed_into",
    "what_needs_holograms",
    "with_start",
    "without_holograms",
]


#: Fields of a recipe that say what is done with holograms, and what each asks for. Lobes are no
#: wish: the recipe of an earlier run has those that it found, and may go on with its phase.
NEED_HOLOGRAMS = {
    "reference": "a reference",
    "refocus_um": "refocusing",
    "tilt_per_frame": "taking a tilt off each frame",
    "window": "a window round the lobes",
    "background": "taking a background off",
}


@checked_call
def open_by(recipe: Recipe) -> Recording | xr.DataArray:
    """Open the file or sample that a recipe names: holograms, or wrapped phase.

    Parameters
    ----------
    recipe : Recipe
        Its recording, microscope, frame rate, angles and what else says how to read the file.

    Returns
    -------
    Recording or xarray.DataArray
        The hologram video, or wrapped phase in radians, dims (time, angle, y, x).

    Raises
    ------
    OSError, TypeError, ValueError
        If there is no such file or sample, or it can't be read.
    """
    if is_sample(recipe.recording):
        return open_sample(recipe.recording, recipe.optics, recipe.frame_rate_hz)
    return open_input(
        recipe.recording,
        recipe.optics,
        recipe.frame_rate_hz,
        dataset=recipe.dataset,
        raw=recipe.raw,
        angles_deg=recipe.angles_deg,
        content=recipe.content,
    )


#: What phase may note of the microscope, beside its pixel.
NOTED_LIGHT = ("wavelength_um", "medium_index")
#: What the pixel in the sample follows from.
OF_THE_PIXEL = {"camera_pixel_um", "magnification"}


def typed_into(
    given: Optics | None, numbers: Mapping[str, float], opened: Recording | xr.DataArray
) -> Optics:
    """Return the microscope with numbers that were typed in; the rest is as the file says.

    Parameters
    ----------
    given : Optics or None
        The microscope of the recipe.
    numbers : mapping of str to float
        Fields of `Optics` that were typed in.
    opened : Recording or DataArray
        What the file holds, opened without a microscope.
    """
    if isinstance(opened, Recording):
        pixel_um, own = opened.file_pixel_um, opened.optics
    else:
        pixel_um = file_pixel_um(opened)
        counted = pixel_um is None and not numbers.keys() & OF_THE_PIXEL
        own = replace(optics_for_pixel(1.0) if counted else Optics(), **noted_light(opened))
    known = given or own
    if given is not None and pixel_note(given.pixel_um, pixel_um):
        pixel_um = None  # the recipe's own counts
    typed = with_typed_numbers(known, numbers, pixel_um)
    other = OF_THE_PIXEL - numbers.keys()
    follows = [n for n in other if not math.isclose(getattr(typed, n), getattr(known, n))]
    if pixel_um is not None and len(other) == 1 and follows:
        way_out = "; give both to change it" if isinstance(opened, Recording) else ""
        warn(
            f"the pixel in the file, {pixel_um:.4g} um, stays: the camera's is taken for "
            f"{typed.camera_pixel_um:.4g} um and the magnification for {typed.magnification:.4g}"
            f"{way_out}"
        )
    return typed


def noted_light(stack: xr.DataArray) -> dict[str, float]:
    """Return what phase notes of wavelength and medium, as fields of `Optics`."""
    return {n: float(stack.attrs[n]) for n in NOTED_LIGHT if stack.attrs.get(n) is not None}


def lobes_of(recipe: Recipe) -> list[Lobe]:
    """Return the lobes of a recipe at the angles that it names, none if they are to be found.

    Raises
    ------
    ValueError
        If there are not as many angles as lobes, or the boundary frame would lie in another view.
    """
    lobes, angles = list(recipe.lobes), recipe.angles_deg
    if not lobes:
        return []
    if recipe.n_views not in (None, len(lobes)):
        warn(
            f"n_views is {recipe.n_views}, but the recipe has {counted(len(lobes), 'lobe')}, "
            "which count; take them out of it to look for views"
        )
    light, own = recipe.wavelengths_um, tuple(lobe.wavelength_um for lobe in lobes)
    if light is not None and light != own:
        warn("wavelengths_um of the recipe do not count, as its lobes name their own")
    return lobes if angles is None else lobes_at(recipe, angles)


def lobes_at(recipe: Recipe, angles_deg: Sequence[float]) -> list[Lobe]:
    """Return the lobes of a recipe at other angles."""
    lobes = list(recipe.lobes)
    if len(angles_deg) != len(lobes):
        msg = (
            f"angles_deg has {counted(len(angles_deg), 'angle')}, but the recipe has "
            f"{counted(len(lobes), 'lobe')}; give as many, or take its lobes out of it"
        )
        raise ValueError(msg)
    turned = [replace(b, angle_deg=float(a)) for b, a in zip(lobes, angles_deg, strict=True)]
    noted = [lobe.angle_deg for lobe in lobes]
    if any(noted) and list(angles_deg) != noted:
        warn(
            f"angles_deg of the recipe, {', '.join(f'{a:g}' for a in angles_deg)}, count, and not "
            f"those that its lobes name, {', '.join(f'{a:g}' for a in noted)}"
        )
    before, now = (
        [lobe.carrier for lobe in in_order_of_angle(views)[0]] for views in (lobes, turned)
    )
    if before != now and recipe.boundary != "auto":
        msg = (
            "angles_deg put the views into another order than that in which the recipe counts "
            'its boundary frame; set boundary to "auto", or the angles in the lobes'
        )
        raise ValueError(msg)
    return turned


def light_for(given: Optics | None, stack: xr.DataArray, own: Optics | None = None) -> Optics:
    """Return the microscope that masses and heights of phase are counted with.

    Parameters
    ----------
    given : Optics or None
        That of the recipe, which counts.
    stack : xarray.DataArray
        Phase, or a result; what it notes of wavelength and medium comes next.
    own : Optics, optional
        The user's own, for the rest. Default: the paper's, and a warning if the wavelength is
        nowhere said.
    """
    if given is not None:
        return given
    noted = noted_light(stack)
    base = own or Optics()
    if own is None and "wavelength_um" not in noted and wavelengths_of(stack) is None:
        warn(
            f"the wavelength is not in the file; {1000 * base.wavelength_um:g} nm are taken for "
            "masses and heights: give it in the optics of the recipe, or as --wavelength"
        )
    return replace(base, **noted)


def found_anywhere(source: str | Path) -> str:
    """Return a recording's name as it holds in every folder: files get their whole path.

    Names of samples, and of files that are not there, stay as they are.

    Parameters
    ----------
    source : str or Path
        A file, a folder, an address, or the name of a sample.

    Returns
    -------
    str
        The whole path of what is there, with links followed; an address in its plain form.
    """
    if (address := address_of(source)) is not None:
        return address
    if str(source) and not is_sample(str(source)):
        # Not there, no name of a file at all, or a link to itself.
        with suppress(OSError, RuntimeError, ValueError):
            return str(Path(source).resolve(strict=True))
    return str(source)


#: Attribute of results whose boundary frame was found: what told it.
FOUND_BY = "boundary_found_by"


#: A rate that was counted back from times is off by no more than this share.
RATE_OFF = 1e-6


def say_what_counts(recipe: Recipe, recording: Recording) -> None:
    """Warn where a recipe names another microscope or rate than the recording that was given."""
    passed_over = []
    if recipe.optics is not None and recipe.optics != recording.optics:
        passed_over.append("optics")
    rate = recording.frame_rate_hz
    # A rate that was counted back from times is off in its last digit.
    asked = recipe.frame_rate_hz
    if asked is not None and rate is not None and not math.isclose(asked, rate):
        passed_over.append("frame_rate_hz")
    if passed_over:
        warn(
            f"the {' and '.join(passed_over)} of the recording count, not those of the recipe; "
            "give them to open_recording() to use them"
        )


def what_needs_holograms(recipe: Recipe) -> list[str]:
    """Return what a recipe asks for that wrapped phase does not give."""
    return [NEED_HOLOGRAMS[field] for field in fields_of_holograms(recipe)]


def fields_of_holograms(recipe: Recipe) -> list[str]:
    """Return the fields of `NEED_HOLOGRAMS` in which something is asked for."""
    asked_for = {field: getattr(recipe, field) for field in NEED_HOLOGRAMS}
    nothing: dict[str, tuple[object, ...]] = {
        field: (Recipe.model_fields[field].default,) for field in NEED_HOLOGRAMS
    }
    nothing["background"] += ("none",)  # which is what is done
    return [field for field, value in asked_for.items() if value not in nothing[field]]


def without_holograms(recipe: Recipe) -> Recipe:
    """Return the recipe for a file of phase without what needs holograms, and warn of that.

    Else a recipe that is written with the results would say what was not done.
    """
    fields = fields_of_holograms(recipe)
    if not fields:
        return recipe
    names = what_needs_holograms(recipe)
    one = len(names) == 1
    warn(
        f"{Path(recipe.recording).name} holds wrapped phase; {' and '.join(names)} "
        f"{'needs holograms, and is' if one else 'need holograms, and are'} passed over"
    )
    return recipe.changed(**{field: Recipe.model_fields[field].default for field in fields})


def say_what_file_says(recipe: Recipe, phase: xr.DataArray) -> None:
    """Warn where a recipe has other facts than the file of wrapped phase notes itself."""
    passed_over = []
    times, angles = phase["time"].values, phase["angle"].values
    rate, span = recipe.frame_rate_hz, float(times[-1] - times[0])
    # Times that do not rise are refused later, in a sentence of their own.
    if rate is not None and span > 0:
        own = (len(times) - 1) / span
        if not math.isclose(own, rate, rel_tol=RATE_OFF):
            passed_over.append(f"frame_rate_hz (the file: {own:.4g})")
    asked = recipe.angles_deg
    if asked is not None and not (len(asked) == len(angles) and np.allclose(asked, angles)):
        passed_over.append(f"angles_deg (the file: {', '.join(f'{a:g}' for a in angles)})")
    if recipe.n_views not in (None, len(angles)):
        passed_over.append(f"n_views (the file: {len(angles)})")
    pixel_um = file_pixel_um(phase)
    if recipe.optics is not None and pixel_note(recipe.optics.pixel_um, pixel_um):
        passed_over.append(f"optics (the pixel in the file: {pixel_um:.4g} um)")
    if passed_over:
        warn(
            f"the file of wrapped phase says its own, which counts, not the recipe's "
            f"{', '.join(passed_over)}"
        )
    light = phase.attrs.get("wavelength_um")
    if recipe.optics is not None and light is not None:
        given = recipe.optics.wavelength_um
        if not math.isclose(float(light), given, rel_tol=RATE_OFF):
            warn(
                f"the file of wrapped phase was measured at {1000 * float(light):.4g} nm, but the "
                f"recipe says {1000 * given:.4g} nm; give the right one, as masses and heights "
                "go by it"
            )


def with_start(
    recipe: Recipe,
    phase: xr.DataArray,
    task: Task = UNWATCHED,
) -> tuple[Recipe, xr.DataArray | None]:
    """Return a recipe with the frame to start from, and the scores if it had to be found.

    It depends on the phase only, wherever that lies: a run on disk starts as one in memory.

    Parameters
    ----------
    recipe : Recipe
        Its boundary may be "auto".
    phase : xarray.DataArray
        Wrapped phase (time, angle, y, x), in memory or lazy.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    if recipe.boundary != "auto":
        return recipe, None
    scores = scores_of_some(phase, task)
    return recipe.changed(boundary=(best_frame(scores),)), scores


def noting_start(comparison: Comparison, scores: xr.DataArray | None) -> Comparison:
    """Let results note that their boundary frame was found, and by what."""
    if scores is None:
        return comparison
    note = {FOUND_BY: scores.attrs["basis"]}
    results = {m: result.assign_attrs(note) for m, result in comparison.results.items()}
    return replace(comparison, results=results)


def start_words(
    frames: Sequence[tuple[int, int]], *, found: bool, of: xr.DataArray | None = None
) -> str:
    """Say from which frames (time, angle) a run starts, and whether they were found or chosen.

    They are said by their numbers, as settings have them, or by time and angle ``of`` a stack.
    """
    named = " and ".join(
        f"time {time}, angle {view}" if of is None else frame_in_words(of, time, view)
        for time, view in frames
    )
    named += ", counted from 0" if of is None else ""
    if not found:
        return f"Start: {named} (chosen)."
    # In the window, the star and the words beside it say that it is the safest; a line is short.
    return f"Start: {'safest frame, ' if of is None else ''}{named} (found automatically)."


def start_sentence(recipe: Recipe, scores: xr.DataArray | None) -> str:
    """Say which frame a run started from, and how far that is to be relied on.

    Parameters
    ----------
    recipe : Recipe
        That of the outcome.
    scores : xarray.DataArray or None
        What the frame was found by; None if it was chosen.
    """
    words = start_words(recipe.start_frames, found=scores is not None)
    return words if scores is None else f"{words} {scores_sentence(scores)}"


# ---- read by any thread or process ----------------------------------------------------------


class FrameSource:
    """A recording's frames; another process opens the recording anew.

    Parameters
    ----------
    recipe : Recipe
        Names the file.
    recording : Recording
        What was opened.
    """

    def __init__(self, recipe: Recipe, recording: Recording) -> None:
        self.recording = recording
        self._recipe = recipe.changed(
            recording=found_anywhere(recording.source),
            dataset=recording.dataset,
            raw=recording.raw,
            optics=recording.optics,
            frame_rate_hz=recording.frame_rate_hz,
            content="holograms",
        )

    def raw_frame(self, index: int) -> NDArray[np.generic]:
        """Return one frame, shape (y, x), its numbers as they are in the file."""
        return self.recording.raw_frame(index)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the frames out where they can be opened anew."""
        if not self.recording.source:
            if isinstance(self.recording.holograms.data, np.ndarray):
                msg = (
                    f"{self.recording.name} is in memory, where the workers of a cluster can't "
                    "read it; save it to a file first"
                )
                raise ValueError(msg)
            return dict(vars(self))
        return {"_recipe": self._recipe, "_stamp": self._stamp()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Open the recording where only its name has come along."""
        stamp = state.pop("_stamp", None)
        self.__dict__.update(state)
        if stamp is None:
            return
        self.recording = opened_anew(self._recipe.model_dump_json(), stamp)
        if self._stamp() != stamp:
            msg = f"{self.recording.name} has changed since this run began; run it again"
            raise OSError(msg)

    def _stamp(self) -> tuple[int, ...]:
        """Return what tells this recording from another one of the same name."""
        source = Path(self._recipe.recording)
        status = source.stat() if source.exists() else None
        when = () if status is None else (status.st_size, status.st_mtime_ns)
        return (*self.recording.holograms.shape, *when)


@lru_cache(4)
def opened_anew(recipe: str, _stamp: tuple[int, ...]) -> Recording:
    """Return the recording that a recipe names, opened once in each process."""
    found = open_by(Recipe.model_validate_json(recipe))
    assert isinstance(found, Recording)  # the recipe says what the file holds
    return found
