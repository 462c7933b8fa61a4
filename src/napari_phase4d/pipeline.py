"""The one path behind the window, scripts and the command line.

A `Recipe` holds every setting; `run` follows it from the recording to the unwrapped phase.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from napari_phase4d.evaluation import Comparison, compare
from napari_phase4d.holography import (
    BACKGROUND_ORDERS,
    WINDOWS,
    Lobe,
    find_lobes,
    reconstruct,
)
from napari_phase4d.io import (
    open_input,
    open_recording,
    write_phase,
    write_table,
)
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.optics import Optics
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.recording import Recording
from napari_phase4d.sample import is_sample, open_sample
from napari_phase4d.unwrapping import METHODS, STACKS_OF_A_FRAME, check_method

__all__ = [
    "Outcome",
    "Recipe",
    "found_anywhere",
    "needed_bytes",
    "open_by",
    "reconstruct_by",
    "run",
    "unwrap_by",
    "working_bytes",
    "write_outcome",
]

#: The paper's own methods.
PAPER_METHODS = ("spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal")
#: Methods that are run if none are chosen.
DEFAULT_METHODS = (*PAPER_METHODS, "directional-l1")


Options = dict[str, dict[str, bool | int | float | str]]


class Recipe(BaseModel):
    """Every setting of a run, from the file to the unwrapped phase.

    Parameters
    ----------
    recording : str
        File or folder of the hologram video, a file of wrapped phase, or a sample,
        "sample:euglena" or "sample:yeast"; empty if it is given to `run` directly.
    dataset : str, optional
        Which array of a file that holds several.
    content : str
        What the file holds: "holograms", "phase", or "auto" (default) to look.
    optics : Optics, optional
        The microscope. Default: what the file says, else that of the paper.
    frame_rate_hz : float, optional
        Frames per second. Default: what the file says, else 1.
    n_views : int
        Number of views to find if no lobes are given, 1 to 6.
    angles_deg : tuple of float, optional
        Viewing angles of the views that are found, in degrees.
    lobes : tuple of Lobe
        The views; empty to find them.
    reference : int, str or None
        Frame number, "median", a file with a hologram without the object, or None.
    window : str
        How a lobe is cut out: "disk", "smooth-disk", "gaussian" or "tukey".
    background : str
        What is fitted to the empty field and removed: "none", "tilt" or "curvature".
    drift : bool
        Whether the phase of the empty field is set to zero in every frame.
    mask : str or None
        "auto" (default) to unwrap the object only, as the paper does; None for the whole field.
    boundary : tuple of (int, int)
        Optically thin frames as (time, angle) numbers.
    methods : tuple of str
        Ids of the unwrapping methods.
    options : dict
        Method id to that method's options.
    confidence : bool
        Whether a map of how far to trust it is written with each result.

    Raises
    ------
    ValueError
        If a setting has no such value.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=False)

    recording: str = ""
    dataset: str | None = None
    content: Literal["auto", "holograms", "phase"] = "auto"
    optics: Optics | None = None
    frame_rate_hz: float | None = Field(default=None, gt=0)
    n_views: int = Field(default=2, ge=1, le=6)
    angles_deg: tuple[float, ...] | None = None
    lobes: tuple[Lobe, ...] = ()
    reference: int | str | None = None
    window: str = "smooth-disk"
    background: str = "tilt"
    drift: bool = True
    mask: Literal["auto"] | None = "auto"
    boundary: tuple[tuple[int, int], ...] = ((0, 0),)
    methods: tuple[str, ...] = DEFAULT_METHODS
    options: Options = Field(default_factory=dict)
    confidence: bool = False

    @field_validator("window")
    @classmethod
    def _window_exists(cls, value: str) -> str:
        return one_of("window", value, WINDOWS)

    @field_validator("background")
    @classmethod
    def _background_exists(cls, value: str) -> str:
        return one_of("background", value, BACKGROUND_ORDERS)

    @field_validator("options")
    @classmethod
    def _options_exist(cls, value: Options) -> Options:
        for method, options in value.items():
            try:
                check_method(method, options)
            except TypeError as error:  # which pydantic would let through
                raise ValueError(str(error)) from error
        return value

    @field_validator("methods")
    @classmethod
    def _methods_exist(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for method in value:
            check_method(method, {})
        return value

    def changed(self, **settings: Any) -> Recipe:
        """Return a copy with other settings.

        Raises
        ------
        ValueError
            If a setting has no such value; one sentence names it.
        """
        try:
            return Recipe.model_validate(self.model_dump() | settings)
        except ValidationError as error:
            raise ValueError(sentence_of(error)) from error

    def to_file(self, path: str | Path) -> Path:
        """Write the recipe as JSON.

        Raises
        ------
        OSError
            If it can't be written; an older file of that name is then left as it was.
        """
        path = Path(path)
        with written_whole(path) as temporary:
            temporary.write_text(self.model_dump_json(indent=2) + "\n", encoding="utf-8")
        return path

    @classmethod
    def from_file(cls, path: str | Path) -> Recipe:
        """Read a recipe from JSON.

        Raises
        ------
        OSError
            If the file can't be read.
        ValueError
            If it is no recipe, or a setting has no such value.
        """
        path = Path(path)
        try:
            settings = json.loads(path.read_text(encoding="utf-8"))
            return cls.model_validate(settings)
        except UnicodeDecodeError as error:
            msg = f"{path.name} is no recipe: it is not a text file"
            raise ValueError(msg) from error
        except json.JSONDecodeError as error:
            msg = f"{path.name} is no recipe: line {error.lineno} is not JSON"
            raise ValueError(msg) from error
        except ValidationError as error:
            msg = f"{path.name} is no valid recipe: {sentence_of(error)}"
            raise ValueError(msg) from error


def sentence_of(error: ValidationError) -> str:
    """Return the first thing that is wrong, in one sentence."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"]) or "the file"
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"


def one_of(name: str, value: str, known: Any) -> str:
    """Return a value if it is known, else raise ValueError."""
    if value not in known:
        msg = f"{name} must be one of {', '.join(known)}, but is {value!r}"
        raise ValueError(msg)
    return value


@dataclass(frozen=True)
class Outcome:
    """What a run gives.

    Parameters
    ----------
    recording : Recording or None
        The hologram video; None if the run began with wrapped phase.
    recipe : Recipe
        All settings that were used, with the lobes and the optics.
    reconstruction : xarray.Dataset
        Wrapped ``phase``, dims (time, angle, y, x); and ``amplitude``, where it is known.
    comparison : Comparison
        Unwrapped phase of every method, and the table.
    truth : xarray.DataArray, optional
        Exact phase on the reconstruction's grid, where it is known.
    """

    recording: Recording | None
    recipe: Recipe
    reconstruction: xr.Dataset
    comparison: Comparison
    truth: xr.DataArray | None = None


def run(
    recipe: Recipe,
    recording: Recording | None = None,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Outcome:
    """Follow a recipe from the recording to the unwrapped phase.

    Parameters
    ----------
    recipe : Recipe
        All settings.
    recording : Recording, optional
        The hologram video, instead of the file that the recipe names.
    truth : xarray.DataArray, optional
        Exact phase on the reconstruction's grid, for the table.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Raises
    ------
    OSError, TypeError, ValueError
        If the recording can't be read or a setting does not fit it.
    Cancelled
        If ``cancelled()`` returned True.
    """
    if recording is None and not recipe.recording:
        msg = "the recipe names no recording; give run() one, or a recipe with a file"
        raise ValueError(msg)
    opened = recording if recording is not None else open_by(recipe)
    if isinstance(opened, xr.DataArray):
        comparison = unwrap_by(recipe, opened, truth, progress, cancelled)
        return Outcome(None, recipe, xr.Dataset({"phase": opened}), comparison, truth)
    recording = opened
    lobes = list(recipe.lobes) or find_lobes(
        recording, recipe.n_views, angles_deg=recipe.angles_deg
    )
    data = reconstruct_by(recipe, recording, lobes, progress, cancelled)
    comparison = unwrap_by(
        recipe, data["phase"], truth, progress, cancelled, amplitude=data["amplitude"]
    )
    used = recipe.changed(lobes=tuple(lobes), optics=recording.optics)
    return Outcome(recording, used, data, comparison, truth)


def open_by(recipe: Recipe) -> Recording | xr.DataArray:
    """Open the file or sample that a recipe names: holograms, or wrapped phase.

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
        angles_deg=recipe.angles_deg,
        content=recipe.content,
    )


def found_anywhere(source: str | Path) -> str:
    """Return a recording's name as it holds in every folder: files get their whole path.

    Names of samples, and of files that are not there, stay as they are.
    """
    if str(source) and not is_sample(str(source)):
        with suppress(OSError, ValueError):  # not there, or no name of a file at all
            return str(Path(source).resolve(strict=True))
    return str(source)


def unwrap_by(
    recipe: Recipe,
    phase: xr.DataArray,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    amplitude: xr.DataArray | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Unwrap wrapped phase with a recipe's methods and settings; NaN are left out.

    ``finished`` is told each method and the comparison so far, see `compare`.
    """
    known = np.isfinite(phase.values)
    return compare(
        phase,
        recipe.methods,
        recipe.boundary,
        truth,
        mask=known if recipe.mask is None and not known.all() else recipe.mask,
        amplitude=amplitude,
        options=recipe.options,
        progress=progress,
        cancelled=cancelled,
        finished=finished,
    )


def reconstruct_by(
    recipe: Recipe,
    recording: Recording,
    lobes: list[Lobe],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Reconstruct a recording with a recipe's settings; a reference file is opened."""
    reference: Any = recipe.reference
    if isinstance(reference, str) and reference != "median":
        reference = open_recording(reference, recording.optics)
    return reconstruct(
        recording,
        lobes,
        reference,
        window=recipe.window,
        background=recipe.background,
        drift=recipe.drift,
        progress=progress,
        cancelled=cancelled,
    )


def write_outcome(
    outcome: Outcome,
    folder: str | Path,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> list[Path]:
    """Write phase, amplitude, every result, the table and the recipe into a folder.

    Where they are there, the exact phase is written too, and how far to trust each result. All
    stacks are OME-TIFF with their pixel, times and angles, see `write_phase`.

    Raises
    ------
    OSError
        If a file can't be written; files of that name are then left as they were.
    Cancelled
        If ``cancelled()`` returned True; the files written by then are whole.
    """
    folder, comparison = Path(folder), outcome.comparison
    stacks = {
        "wrapped" if name == "phase" else str(name): stack
        for name, stack in outcome.reconstruction.data_vars.items()
    } | dict(comparison.results)
    if outcome.truth is not None:
        stacks["exact"] = exact_phase(outcome.truth, outcome.reconstruction["phase"])
    if outcome.recipe.confidence:
        trust = {m: comparison.confidence(m, progress, cancelled) for m in comparison.results}
        stacks |= {f"confidence_{method}": stack for method, stack in trust.items()}
        comparison = comparison.with_suspicion(trust)
    watch = Watch(len(stacks), "saving", progress, cancelled)
    written = []
    for name, stack in stacks.items():
        written.append(write_phase(folder / f"{name}.ome.tif", stack))
        watch.step()
    written.append(write_table(folder / "table.csv", comparison.table))
    written.append(outcome.recipe.to_file(folder / "recipe.json"))
    return written


def exact_phase(truth: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return truth with the axes and places of wrapped phase, noted to be exact."""
    is_named = isinstance(truth, xr.DataArray)
    exact = phase.copy(data=truth.transpose(*phase.dims).values if is_named else truth)
    exact.attrs = {**(truth.attrs if is_named else {}), "units": "rad", "exact": True}
    return exact.rename("exact")


def needed_bytes(recording: Recording, lobes: list[Lobe], methods: Sequence[str]) -> int:
    """Return about how much memory a run will need, in bytes, beyond the recording itself."""
    from napari_phase4d.holography import Demodulator

    height, width = Demodulator(recording.frame_shape, lobes).output_shape
    stack = 4 * recording.n_frames * len(lobes) * height * width
    # Phase and amplitude stay; the transforms of the frames in work do not.
    unwrapping = working_bytes(stack, methods, frame=4 * height * width)
    return 2 * stack + unwrapping + int(64 * np.prod(recording.frame_shape))


def working_bytes(stack: int, methods: Sequence[str], *, frame: int) -> int:
    """Return about how much memory unwrapping needs, in bytes, beyond the wrapped phase.

    Parameters
    ----------
    stack : int
        Bytes of the wrapped phase as float32.
    methods : sequence of str
        Ids of the methods to run, one after the other.
    frame : int
        Bytes of one frame of it.
    """
    largest = max((METHODS[m].working_stacks for m in methods), default=0)
    of_threads = (os.cpu_count() or 1) * STACKS_OF_A_FRAME * frame
    # The two-dimensional step and every result stay.
    return int(stack * (2 + len(methods) + largest) + of_threads)
