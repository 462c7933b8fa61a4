"""Every setting of a run, in one frozen model."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    ValidationInfo,
    field_serializer,
    field_validator,
)

from napari_phase4d.analysis import CellSettings
from napari_phase4d.holography import BACKGROUND_ORDERS, MAX_ORDER, MIN_ORDER, WINDOWS, Lobe
from napari_phase4d.io import RawLayout
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.optics import Optics
from napari_phase4d.unwrapping import check_method, options_by_id
from napari_phase4d.words import local_path, shown

__all__ = ["DEFAULT_METHODS", "PAPER_METHODS", "PHASE_SETTINGS", "Recipe"]

#: The paper's own methods.
PAPER_METHODS = ("spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal")
#: Methods that are run if none are chosen.
DEFAULT_METHODS = (*PAPER_METHODS, "directional-l1")
#: Settings that wrapped phase depends on, beside the lobes and the reference.
PHASE_SETTINGS = (
    "window",
    "background",
    "background_order",
    "refocus_um",
    "drift",
    "tilt_per_frame",
    "first_frames",
)

#: No recipe is larger than this, in bytes.
LARGEST_FILE = 2**20


Options = dict[str, dict[str, bool | int | float | str]]


class Recipe(BaseModel):
    """Every setting of a run, from the file to the unwrapped phase.

    Parameters
    ----------
    recording : str
        File or folder of the hologram video, a file of wrapped phase, or a sample,
        "sample:euglena", "sample:cells" or "sample:yeast"; empty if it is given to `run`.
    dataset : str, optional
        Which array of a file that holds several.
    raw : RawLayout, optional
        How frames lie in a raw camera file, which does not say it.
    content : str
        What the file holds: "holograms", "phase", or "auto" (default) to look.
    optics : Optics, optional
        The microscope. Default: what the file says, else that of the paper.
    frame_rate_hz : float, optional
        Frames per second. Default: what the file says, else 1.
    n_views : int, optional
        Number of views to find if no lobes are given, 1 to 6. Default: as many as there are
        angles, else they are counted.
    angles_deg : tuple of float, optional
        Viewing angles of the views that are found, or of the lobes, in degrees. They come before
        those that lobes name.
    wavelengths_um : tuple of float, optional
        Wavelengths of the views that are found, in micrometres, in the same order; where lobes
        are given, these name their own. Default: all have that of the optics.
    lobes : tuple of Lobe
        The views; empty to find them.
    reference : int, str or None
        Frame number, "median", a file with a hologram without the object, or None (default).
    window : str
        How a lobe is cut out: "disk", "smooth-disk" (default), "gaussian" or "tukey".
    background : str
        What is fitted to the empty field and removed: "none", "tilt" (default), "curvature",
        "polynomial" or "zernike".
    background_order : int
        Degree of the last two, 1 to 8, default 4.
    refocus_um : float, "auto" or None
        How far the fields are carried along the light, in micrometres; "auto" to find the focus;
        None (default) not to.
    drift : bool
        Whether the phase of the empty field is set to zero in every frame. Default True.
    tilt_per_frame : bool
        Whether a tilt is taken off each frame too, fitted to its own empty field. Default False.
    first_frames : int, optional
        Lobes, background, focus, and what fringes usually are, are taken from so many frames at
        the beginning only, as while a recording is watched. Default: from all over it.
    mask : str or None
        "auto" (default) to unwrap the object only, as the paper does; None for the whole field.
    boundary : "auto" or tuple of (int, int)
        Optically thin frames to start from, as (time, angle) numbers; "auto" (default) for the
        safest one by `score_boundaries`.
    methods : tuple of str
        Ids of the unwrapping methods; labels, as "T/A", are taken for the ids they stand for.
        Default: the paper's five (2-D, Angular, Temporal, T/A, A/T) and WL1.
    options : dict
        Method id to that method's options. Default: the usual ones.
    confidence : bool
        Whether a map of how far to trust it is written with each result. Default False.
    cells : CellSettings, optional
        How cells are found, followed and measured, in the first of these results that there is:
        Synthetic, WL1, T/A, A/T, Temporal, Angular, any. Default: they are not looked for.
    storage : str
        Where stacks are held: "memory", "disk" (a block of frames at a time in memory, as for
        recordings larger than it), or "auto" (default) for memory if they fit.

    Raises
    ------
    ValueError
        If a setting has no such value.

    See Also
    --------
    run : Follows a recipe.

    Examples
    --------
    >>> from napari_phase4d import Recipe
    >>> recipe = Recipe(recording="sample:euglena", angles_deg=(-7, 21), methods=("temporal",))
    >>> recipe.changed(reference="median").reference
    'median'
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=False, allow_inf_nan=False
    )

    recording: str = ""
    dataset: str | None = None
    raw: RawLayout | None = None
    content: Literal["auto", "holograms", "phase"] = "auto"
    optics: Optics | None = None
    frame_rate_hz: float | None = Field(default=None, gt=0)
    n_views: int | None = Field(default=None, ge=1, le=6)
    angles_deg: tuple[float, ...] | None = None
    wavelengths_um: tuple[float, ...] | None = None
    lobes: tuple[Lobe, ...] = ()
    reference: int | str | None = None
    window: str = "smooth-disk"
    background: str = "tilt"
    background_order: int = Field(default=4, ge=MIN_ORDER, le=MAX_ORDER)
    refocus_um: Literal["auto"] | FiniteFloat | None = None
    drift: bool = True
    tilt_per_frame: bool = False
    first_frames: int | None = Field(default=None, ge=1)
    mask: Literal["auto"] | None = "auto"
    boundary: Literal["auto"] | tuple[tuple[int, int], ...] = "auto"
    methods: tuple[str, ...] = DEFAULT_METHODS
    options: Options = Field(default_factory=dict)
    confidence: bool = False
    cells: CellSettings | None = None
    storage: Literal["auto", "memory", "disk"] = "auto"

    if not TYPE_CHECKING:  # type checkers know the settings from the fields

        def __init__(self, **settings: Any) -> None:
            try:
                super().__init__(**settings)
            except ValidationError as error:
                raise ValueError(first_fault(error)) from error

    @field_validator("*", mode="before")
    @classmethod
    def _bool_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        wants_bool = str(info.field_name) in ("drift", "tilt_per_frame", "confidence")
        if isinstance(value, bool) and not wants_bool:
            msg = f"it must not be {value}"
            raise ValueError(msg)
        if wants_bool and not isinstance(value, bool | np.bool_):
            msg = f"it must be True or False, but is {shown(value)}"
            raise ValueError(msg)
        if info.field_name in ("recording", "reference", "dataset") and isinstance(value, Path):
            return str(value)
        if info.field_name == "methods" and isinstance(value, str):
            return (value,)
        return value

    @field_validator("boundary", mode="before")
    @classmethod
    def _one_frame_will_do(cls, value: Any) -> Any:
        if isinstance(value, str):
            if value != "auto":
                msg = f'it must be "auto" or frames (time, angle), but is {shown(value)}'
                raise ValueError(msg)
            return value
        try:
            frames = [value] if all(np.ndim(part) == 0 for part in value) and value else value
            whole = [tuple(frame) for frame in frames]
        except TypeError as error:
            msg = (
                'it must be "auto" or frames (time, angle) such as ((0, 0),), but is '
                f"{shown(value)}"
            )
            raise ValueError(msg) from error
        numbers = [n for frame in whole for n in frame]
        plain = all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in numbers)
        if not whole or not plain or any(len(frame) != 2 for frame in whole):
            msg = f"it must be frames (time, angle) of whole numbers, but is {shown(value)}"
            raise ValueError(msg)
        return tuple((int(t), int(a)) for t, a in whole)

    @field_validator("recording", "dataset", "reference")
    @classmethod
    def _text_can_be_written(cls, value: Any) -> Any:
        try:
            str(value).encode()
        except UnicodeEncodeError as error:
            msg = "its characters can't be written as UTF-8; rename the file"
            raise ValueError(msg) from error
        return value

    @field_validator("lobes")
    @classmethod
    def _chosen_lobes_have_no_doubt(cls, value: tuple[Lobe, ...]) -> tuple[Lobe, ...]:
        return tuple(replace(lobe, doubt="") for lobe in value)

    @field_serializer("lobes")
    def _lobes_without_doubt(self, lobes: tuple[Lobe, ...]) -> list[dict[str, object]]:
        # A wavelength that no lobe names is not written, so that older versions can read it.
        left_out = [
            {"doubt"} | ({"wavelength_um"} if lobe.wavelength_um is None else set())
            for lobe in lobes
        ]
        return [
            {key: value for key, value in asdict(lobe).items() if key not in without}
            for lobe, without in zip(lobes, left_out, strict=True)
        ]

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
        try:
            return {method: dict(own) for method, own in options_by_id(value).items()}
        except TypeError as error:  # which pydantic would let through
            raise ValueError(str(error)) from error

    @field_validator("methods")
    @classmethod
    def _methods_exist(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(check_method(method, {}) for method in value)

    @property
    def wanted_views(self) -> int | None:
        """How many views to look for; None to count them."""
        if self.n_views is None and self.angles_deg is not None:
            return len(self.angles_deg)
        if self.n_views is None and self.wavelengths_um is not None:
            return len(self.wavelengths_um)
        return self.n_views

    @property
    def reference_file(self) -> str | None:
        """The file with a hologram that the fields are divided by, None if there is none."""
        named = isinstance(self.reference, str) and self.reference != "median"
        return str(self.reference) if named else None

    @property
    def start_frames(self) -> tuple[tuple[int, int], ...]:
        """The frames (time, angle) to start from.

        Raises
        ------
        ValueError
            If they are still to be found.
        """
        if self.boundary == "auto":
            msg = (
                'boundary is "auto", and the safest frame has not been looked for; give frame '
                "numbers such as ((0, 0),), or use run(), which finds it"
            )
            raise ValueError(msg)
        return self.boundary

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
            raise ValueError(first_fault(error)) from error

    def to_file(self, path: str | Path) -> Path:
        """Write the recipe as JSON.

        Raises
        ------
        OSError
            If it can't be written; an older file of that name is then left as it was.
        """
        path = local_path(path)
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
        path = local_path(path)
        try:
            return cls.model_validate(settings_in(path))
        except ValidationError as error:
            msg = f"{path.name} is no valid recipe: {first_fault(error)}"
            raise ValueError(msg) from error


def settings_in(path: Path) -> Any:
    """Return what a JSON file holds, or raise ValueError in one sentence."""
    if not path.is_file() and path.exists():
        msg = f"{path.name} is no recipe: it is no file"
        raise ValueError(msg)
    if path.stat().st_size > LARGEST_FILE:
        msg = f"{path.name} is no recipe: it is larger than {LARGEST_FILE // 2**20} MB"
        raise ValueError(msg)
    try:
        # Some editors put a byte order mark before UTF-8.
        text = path.read_text(encoding="utf-8-sig")
        return json.loads(text, object_pairs_hook=without_doubles)
    except UnicodeDecodeError as error:
        msg = f"{path.name} is no recipe: it is not a text file"
        raise ValueError(msg) from error
    except json.JSONDecodeError as error:
        msg = f"{path.name} is no recipe: line {error.lineno} is not JSON"
        raise ValueError(msg) from error
    except DoubledError as error:
        msg = f"{path.name} is no recipe: it sets {error} twice"
        raise ValueError(msg) from error
    except RecursionError as error:
        msg = f"{path.name} is no recipe: it is nested too deeply"
        raise ValueError(msg) from error
    except ValueError as error:  # of Python, for numbers of thousands of digits
        msg = f"{path.name} is no recipe: it holds a number that is too long"
        raise ValueError(msg) from error


def without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return settings of JSON; ValueError if one is there twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise DoubledError(twice)
    return found


class DoubledError(ValueError):
    """A setting is there twice."""


def first_fault(error: ValidationError) -> str:
    """Return the first thing that is wrong, in one sentence."""
    first = error.errors()[0]
    if not first["loc"] and first["type"] == "value_error":
        return first["msg"].removeprefix("Value error, ")  # it names the setting already
    where = ".".join(str(part) for part in first["loc"]) or "the file"
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"


def one_of(name: str, value: str, known: Any) -> str:
    """Return a value if it is known, else raise ValueError."""
    if value not in known:
        msg = f"{name} must be one of {', '.join(known)}, but is {shown(value)}"
        raise ValueError(msg)
    return value
