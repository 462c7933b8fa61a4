"""Unwrapping by any method, of this program or of another package."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.later import xr
from napari_phase4d.stack import Limits, Stack
from napari_phase4d.stacks import KIND, UNWRAPPED, without_masked, wrapped_stack
from napari_phase4d.task import (
    CancelledCall,
    ProgressCall,
    Task,
)
from napari_phase4d.unwrapping.brought import of_a_package
from napari_phase4d.unwrapping.light import ViewsOf
from napari_phase4d.unwrapping.light.synthetic import check_wavelengths
from napari_phase4d.unwrapping.objects import left_out_advice, left_out_note
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registry import METHODS, Option
from napari_phase4d.warned import warn
from napari_phase4d.words import shown

__all__ = [
    "ONE_OF",
    "all_options",
    "as_methods",
    "check_light",
    "check_method",
    "label_of",
    "methods_for",
    "noted",
    "options_by_id",
    "run_method",
    "unwrap",
    "why_unsuited",
]

#: How choices are called on screen, where not by their own name.
SPOKEN = {"phasetools": "PhaseTools"}
#: What is said of a dimension in which there is a single frame.
ONE_OF = {"time": "one time", "angle": "one view"}


def unwrap(
    phase: xr.DataArray | ArrayLike,
    method: str = "temporal-angular",
    boundary: tuple[int, int] | Sequence[tuple[int, int]] = (0, 0),
    mask: xr.DataArray | ArrayLike | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    amplitude: xr.DataArray | ArrayLike | None = None,
    **method_options: Any,
) -> xr.DataArray:
    """Unwrap phase over time, angle, y and x.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, dims among (time, angle, y, x); plain arrays are (y, x),
        (time, y, x) or (time, angle, y, x). Other units that ``attrs`` or coordinates name are
        converted; times and angles must rise. What is masked in a masked array is left out.
    method : str, optional
        One of `METHODS`, by its id or by its label, as "T/A"; default "temporal-angular" (T/A).
    boundary : tuple of int or sequence of such, optional
        (time, angle) frame numbers of the optically thin frame, or several. Default (0, 0).
    mask : array_like of bool, "auto" or None, optional
        Pixels to unwrap; the others are 0 in the result, or NaN as in the phase. "auto" finds the
        object. Plain masks are (y, x), (time, y, x) or (time, angle, y, x) too, whatever the dims
        of the phase.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each step; ``cancelled()`` stops the work.
    amplitude : DataArray or array_like, optional
        Amplitude of the field, of the phase's shape; the directional methods trust the phase less
        where it fades.
    **method_options
        The method's own settings, see ``METHODS[method].options``.

    Returns
    -------
    xarray.DataArray
        Unwrapped phase in radians, float32, with the dims, coordinates and attributes of
        ``phase``; inside the mask it differs from it by whole turns, or is not known, NaN.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.

    Warns
    -----
    UserWarning
        If the phase looks like another unit, camera frames, or unwrapped phase, or as if it had
        been filtered, resized or cut out, which loses turns.
    UserWarning
        If the object that "auto" finds leaves out more than 10 % of the field of any frame where
        the phase is smooth and not flat. ``attrs["smooth_left_out_frames"]`` lists these frames
        (time, angle), ``attrs["smooth_left_out_most_percent"]`` says how much of the worst one,
        ``attrs["smooth_left_out_percent"]`` how much of all frames.

    See Also
    --------
    compare : Several methods side by side.
    score_boundaries : Which frame is thin enough to start from.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> unwrapped = p4d.unwrap(sample["wrapped"], "temporal-angular", boundary=(0, 0))
    >>> unwrapped.dims
    ('time', 'angle', 'y', 'x')
    >>> unwrapped.attrs["method"], unwrapped.attrs["boundary"]
    ('temporal-angular', [[0, 0]])
    """
    task = Task(progress, cancelled)
    method = check_method(method, method_options)
    mask = without_masked(phase, mask)
    problem = Problem(wrapped_stack(phase, mask=mask), boundary, mask, amplitude, shared=False)
    found = run_method(problem, method, task, method_options)
    if advice := left_out_advice(found.attrs):
        warn(f"{advice}, with mask=None")
    return found


def run_method(
    problem: Problem, method: str, task: Task, options: Mapping[str, Any]
) -> xr.DataArray:
    """Run one method on a problem and note how, in the result's attributes.

    Parameters
    ----------
    problem : Problem
        Wrapped phase with its mask and boundary frames.
    method : str, see `all_options`
    task : Task
        Who is told of it, and may stop it.
    options : mapping, see `all_options`

    Returns
    -------
    xarray.DataArray
        Unwrapped phase in radians, in the form of the problem's phase.
    """
    chosen, facts = all_options(method, options), METHODS[method]
    limits: Sequence[Limits] = ()
    values: Stack | NDArray[np.float32]
    if facts.wavelengths == 1 and problem.parts():
        values, limits = each_wavelength(problem, method, task, chosen)
    elif facts.streams:
        values = problem.result_stack(method)
        limits = facts.function(problem, values, task, **chosen)
    else:
        values = at_once(problem.in_memory(), method, task, chosen)
    attrs = noted(
        method,
        options,
        problem.boundaries,
        mask="auto" if problem.finds_mask else "none" if problem.all_usable else "given",
        amplitude=problem.has_amplitude,
    )
    attrs |= left_out_note(problem.smooth_left_out())
    if facts.leaves_out and (left_out := problem.frames_left_out()).any():
        attrs["lost_frames"] = np.argwhere(left_out).tolist()
    return problem.finished(values, method, attrs, limits)


def each_wavelength(
    problem: Problem, method: str, task: Task, options: Mapping[str, Any]
) -> tuple[Stack | NDArray[np.float32], list[Limits]]:
    """Run a method on the views of each wavelength by themselves; return them together."""
    facts = METHODS[method]
    if not facts.streams:
        together = np.empty(problem.given.shape, dtype=np.float32)
        for views, part in problem.parts():
            found = at_once(part.in_memory(), method, task, options)
            together[:, list(views)] = found
        return together, []
    values, limits = problem.result_stack(method), []
    for views, part in problem.parts():
        own = ViewsOf(values, views)
        limits += facts.function(part, own, task, **options)
    return values, limits


def at_once(
    problem: Problem, method: str, task: Task, options: Mapping[str, Any]
) -> NDArray[np.float32]:
    """Run a method that looks at all frames at once."""
    facts = METHODS[method]
    if not facts.finds_object:
        problem.settle_mask(task)
    if facts.package:
        return of_a_package(problem, method, task, options)
    found: NDArray[np.float32] = facts.function(problem, task, **options)
    return found


def all_options(method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a method, those that are not given by their default.

    Parameters
    ----------
    method : str
        Id of a method, one of `METHODS`.
    options : mapping of str to value
        Some of its options by name; they are not checked, see `check_method`.

    Returns
    -------
    dict of str to value, with every option of the method
    """
    return {o.name: o.default for o in METHODS[method].options} | dict(options)


def noted(
    method: str,
    options: Mapping[str, Any],
    boundaries: Sequence[tuple[int, int]],
    *,
    mask: str,
    amplitude: bool,
) -> dict[str, Any]:
    """Return what a result notes of how it was made.

    Parameters
    ----------
    method, options
        See `all_options`.
    boundaries : sequence of (int, int)
        The boundary frames (time, angle).
    mask : str
        "none", "auto" (the method found the object) or "given".
    amplitude : bool
        Whether the amplitude was known.

    Returns
    -------
    dict of str to value
        For ``attrs``; of methods that a package brings with its name.
    """
    found = {
        KIND: UNWRAPPED,
        "method": method,
        "options": all_options(method, options),
        "boundary": [list(b) for b in boundaries],
        "mask": mask,
        "amplitude": amplitude,
    }
    package = METHODS[method].package
    return found | ({"package": package} if package else {})


def label_of(method: str, options: Mapping[str, Any]) -> str:
    """Return a method's short name, with what was chosen where that is not the default.

    Parameters
    ----------
    method, options : see `all_options`

    Returns
    -------
    str, as in tables and on screen, such as "T/A"
    """
    chosen = [
        SPOKEN.get(str(options[o.name]), str(options[o.name]))
        for o in METHODS[method].options
        if o.choices and options.get(o.name, o.default) != o.default
    ]
    label = METHODS[method].label
    return f"{label} ({', '.join(chosen)})" if chosen else label


def check_method(method: str, options: Mapping[str, Any]) -> str:
    """Return the id of a method, which may be called by its label, as on screen.

    Raises ValueError for unknown methods and TypeError for options that a method lacks.

    Parameters
    ----------
    method : str
        Id or label, such as "temporal-angular" or "T/A".
    options : mapping of str to value
        Some of its options by name.

    Returns
    -------
    str, one of `METHODS`
    """
    if isinstance(method, str) and method not in METHODS:
        method = next((name for name, facts in METHODS.items() if facts.label == method), method)
    if not isinstance(method, str) or method not in METHODS:
        msg = f"method must be one of {', '.join(METHODS)}, but is {shown(method)}"
        raise ValueError(msg)
    known = [o.name for o in METHODS[method].options]
    unknown = [name for name in options if name not in known]
    if unknown:
        msg = f"{method} has no option {unknown[0]!r}; it has {', '.join(known) or 'none'}"
        raise TypeError(msg)
    for option in METHODS[method].options:
        value = options.get(option.name, option.default)
        if not takes(option, value):
            kind = type(option.default).__name__
            msg = f"the option {option.name} of {method} takes a {kind}, but got {shown(value)}"
            raise TypeError(msg)
        if option.choices and value not in option.choices:
            msg = (
                f"{option.name} must be one of {', '.join(option.choices)}, but is {shown(value)}"
            )
            raise ValueError(msg)
    return method


def options_by_id(options: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Return the options of methods by their ids, whatever name each is called by.

    Raises as `check_method` does, and ValueError where two names stand for the same method.
    """
    found: dict[str, Mapping[str, Any]] = {}
    for named, own in options.items():
        method = check_method(named, own)
        if method in found:
            msg = f"options are given twice for {method}, which is called {named!r} too"
            raise ValueError(msg)
        found[method] = own
    return found


def as_methods(methods: Any) -> list[str]:
    """Return names of methods as a list; a single one will do."""
    if isinstance(methods, str):
        return [methods]
    try:
        found = list(methods)
    except TypeError as error:
        msg = f"methods must be a list of method ids, but is {shown(methods)}"
        raise TypeError(msg) from error
    if not found:
        msg = f"methods is empty; give at least one of {', '.join(METHODS)}"
        raise ValueError(msg)
    return found


#: Wavelength of each view in micrometres; None where it is not known.
Light = Sequence[float] | NDArray[np.floating] | None


def methods_for(wavelengths_um: Light, shape: Sequence[int] | None = None) -> list[str]:
    """Return the methods that suit views of such wavelengths.

    Parameters
    ----------
    wavelengths_um : sequence of float or None
        Wavelength of each view in micrometres; None where it is not known.
    shape : sequence of int, optional
        How many times and views there are. Default: more than one of each.

    Returns
    -------
    list of str
        Ids among `METHODS`, all but those that need more wavelengths than there are, or go along
        something of which there is only one.

    Examples
    --------
    >>> from napari_phase4d.unwrapping import methods_for
    >>> "synthetic-wavelength" in methods_for(None)
    False
    >>> "synthetic-wavelength" in methods_for([0.532, 0.6328])
    True
    >>> "temporal" in methods_for(None, (1, 2))
    False
    """
    return [method for method in METHODS if not why_unsuited(method, wavelengths_um, shape)]


def why_unsuited(method: str, wavelengths_um: Light, shape: Sequence[int] | None = None) -> str:
    """Say why a method makes no sense for such views, in one sentence; "" where it does.

    Parameters
    ----------
    method : str
        Id among `METHODS`.
    wavelengths_um, shape
        As in `methods_for`.

    Returns
    -------
    str
        Names the method that gives the same, where there is one.
    """
    facts, views = METHODS[method], Counter([] if wavelengths_um is None else wavelengths_um)
    if facts.wavelengths > max(1, len(views)):
        return f"It needs {facts.wavelengths} wavelengths for each angle."
    if shape is None:
        return ""
    # Views of another wavelength are unwrapped by themselves.
    counts = {"time": shape[0], "angle": max(views.values(), default=shape[1])}
    left = {dim for dim in facts.along if counts[dim] > 1}
    if len(left) == len(facts.along):
        return ""
    missing = " and ".join(ONE_OF[dim] for dim in facts.along if dim not in left)
    same = next(other for other in METHODS.values() if set(other.along) == left)
    along = " and ".join(facts.along)
    return f"It goes along {along}, but there is only {missing}: {same.label} gives the same."


def check_light(
    methods: Sequence[str],
    wavelengths_um: NDArray[np.float64] | None,
    angles_deg: Sequence[float] | NDArray[np.floating],
) -> None:
    """Refuse methods that need more wavelengths than an angle has.

    Parameters
    ----------
    methods : sequence of str
        Ids of methods.
    wavelengths_um : ndarray of shape (view,) or None
        Wavelength of each view in micrometres.
    angles_deg : sequence of float
        Angle of each view in degrees.

    Raises
    ------
    ValueError
        In one sentence that says what there is, and what to do.
    """
    if any(METHODS[method].wavelengths > 1 for method in methods):
        check_wavelengths(wavelengths_um, angles_deg)


def takes(option: Option, value: Any) -> bool:
    """Say whether a value has the type of an option; a whole number will do for a float."""
    if isinstance(option.default, float):
        return isinstance(value, float | int) and not isinstance(value, bool)
    return type(value) is type(option.default)


# ---- what methods of other packages are given -----------------------------------------------


TURN = 2 * np.pi
