"""All unwrapping methods, in the order in which they are shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import four_d, volumes
from napari_phase4d.unwrapping.dilate_erode import dilate_erode
from napari_phase4d.unwrapping.directional import directional_growing, directional_l1
from napari_phase4d.unwrapping.laplacian import laplacian
from napari_phase4d.unwrapping.network_flow import network_flow
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["METHODS", "STACKS_OF_A_FRAME", "Method", "Option", "label_of", "unwrap"]


@dataclass(frozen=True)
class Option:
    """One setting of a method.

    Parameters
    ----------
    name : str
        Keyword of `unwrap`.
    default : bool, int, float or str
        Value if it is not given; its type is the option's type.
    summary : str
        One sentence for tooltips and help.
    choices : tuple of str, optional
        All values that it can have; empty for any.
    """

    name: str
    default: bool | int | float | str
    summary: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Method:
    """One way to unwrap.

    Parameters
    ----------
    label : str
        Short name on screen.
    source : str
        Where the method was published.
    summary : str
        What it does, in one sentence.
    function : callable
        ``function(problem, progress, cancelled, **options) -> (time, angle, y, x)``.
    options : tuple of Option
        Its settings.
    working_stacks : float
        Largest memory at one time beyond its input and the shared first step, in sizes of the
        wrapped phase as float32, with the variant that needs most. Measured at noise of up to
        0.7 rad, and rounded up.
    finds_object : bool
        Whether it tells the object from the empty field by itself, so that mask "auto" costs it
        no other unwrapping first.
    streams : bool
        Whether it goes through the frames one after the other, so that a recording may be larger
        than memory.
    """

    label: str
    source: str
    summary: str
    function: Callable[..., NDArray[np.float32]]
    options: tuple[Option, ...] = ()
    working_stacks: float = 5.0
    finds_object: bool = False
    streams: bool = False


#: Memory of each thread while it unwraps single frames, in sizes of a frame as float32.
STACKS_OF_A_FRAME = 20.0

OWN = "This project, see docs/own_method.md"
PAPER = "Dardikman, Singh & Shaked 2018, section 2"
CHAIN_OPTIONS = (
    Option(
        "registration",
        True,
        "Move frames by whole pixels so that the object's centre of mass stays in place.",
    ),
    Option(
        "split",
        True,
        "Start anew where the object has become as thin again as in the boundary frame.",
    ),
)

VARIANT = Option(
    "variant",
    "textbook",
    '"textbook", as the method is described, or "phasetools", as PhaseTools computes it.',
    ("textbook", "phasetools"),
)

#: How choices are called on screen, where not by their own name.
SPOKEN = {"phasetools": "PhaseTools"}

#: Method id -> Method.
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "spatial-2d": Method(
            "2-D",
            "Herraez et al. 2002, Appl. Opt. 41, 7437",
            "Each frame by itself, most reliable pixels first.",
            four_d.spatial_2d,
            (
                Option(
                    "reliability",
                    "herraez",
                    '"herraez", as published: pixels whose phase bends least first; "coherence": '
                    "steps first that are like those round them, better on steep or noisy phase.",
                    ("herraez", "coherence"),
                ),
            ),
            streams=True,
        ),
        "angular": Method(
            "Angular",
            "Dardikman et al. 2017, Opt. Express 25, 3347",
            "From the thin angle to the others, at each time.",
            four_d.angular,
            CHAIN_OPTIONS,
            streams=True,
        ),
        "temporal": Method(
            "Temporal",
            PAPER,
            "From the thin time to the others, for each angle.",
            four_d.temporal,
            CHAIN_OPTIONS,
            streams=True,
        ),
        "temporal-angular": Method(
            "T/A",
            PAPER + ", Fig. 1(a)",
            "Along time first, then along the angle.",
            four_d.temporal_angular,
            CHAIN_OPTIONS,
            streams=True,
        ),
        "angular-temporal": Method(
            "A/T",
            PAPER + ", Fig. 1(b)",
            "Along the angle first, then along time.",
            four_d.angular_temporal,
            CHAIN_OPTIONS,
            streams=True,
        ),
        "laplacian": Method(
            "LBE",
            "Schofield & Zhu 2003, Opt. Lett. 28, 1194; in 4-D: Barnhill et al. 2015",
            "Solves for the phase whose Laplacian is that of the wrapped phase; an estimate.",
            laplacian,
            (
                VARIANT,
                Option(
                    "rounded", False, "Add whole turns to the wrapped phase, the nearest to it."
                ),
            ),
            working_stacks=8.0,
        ),
        "region-growing": Method(
            "RG",
            "Abdul-Rahman et al. 2007, Appl. Opt. 46, 6623; in 4-D: Barnhill et al. 2015",
            "Joins pixels over time, angle, y and x, most reliable edges first.",
            volumes.region_growing,
            (
                VARIANT,
                Option(
                    "rga_threshold",
                    3.14,
                    'Only with "phasetools": step in radians beyond which a turn is added.',
                ),
            ),
            working_stacks=50.0,  # of "phasetools"; "textbook" takes 15
        ),
        "dilate-erode": Method(
            "DE",
            "Dilate-erode-propagate: Barnhill et al. 2015, Magn. Reson. Med. 73, 2321",
            "Mends the boundary frame with windows, then carries its phase from frame to frame.",
            dilate_erode,
            (
                VARIANT,
                Option(
                    "max_window",
                    0,
                    "Half the width of the largest window in pixels; 0, as published: no windows.",
                ),
                Option(
                    "erode_threshold",
                    6.0,
                    "Largest second difference over three frames, in radians, of a valid pixel.",
                ),
            ),
            working_stacks=9.0,
        ),
        "spatial-3d": Method(
            "3-D",
            "Abdul-Rahman et al. 2007, Appl. Opt. 46, 6623",
            "Joins pixels over time, y and x for each angle, most reliable edges first.",
            volumes.spatial_3d,
            working_stacks=10.0,
        ),
        "network-flow": Method(
            "Flow",
            "Pepe & Lanari 2006, IEEE Trans. Geosci. Remote Sens. 44, 2374; after Costantini",
            "Fewest whole turns that close all loops: over time and angle, then in each frame.",
            network_flow,
            working_stacks=36.0,
        ),
        "directional-growing": Method(
            "RGd",
            OWN,
            "Joins pixels over time, angle, y and x, first where steps change least along "
            "themselves.",
            directional_growing,
            working_stacks=50.0,
            finds_object=True,
        ),
        "directional-l1": Method(
            "WL1",
            OWN,
            "Whole turns that disagree least with all steps, each weighted by how smooth it is.",
            directional_l1,
            (
                Option(
                    "one_sided",
                    True,
                    "The object is nowhere optically thinner than the empty field round it (or "
                    "nowhere denser): where the steps can't tell, prefer that.",
                ),
            ),
            working_stacks=45.0,
            finds_object=True,
        ),
    }
)


def unwrap(
    phase: xr.DataArray | Any,
    method: str = "temporal-angular",
    boundary: Any = (0, 0),
    mask: Any = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    amplitude: Any = None,
    **method_options: Any,
) -> xr.DataArray:
    """Unwrap phase over time, angle, y and x.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, dims among (time, angle, y, x); plain arrays are (y, x),
        (time, y, x) or (time, angle, y, x).
    method : str, optional
        One of `METHODS`, default "temporal-angular" (T/A).
    boundary : tuple of int or sequence of such, optional
        (time, angle) frame numbers of the optically thin frame, or several. Default (0, 0).
    mask : array_like of bool, "auto" or None, optional
        Pixels to unwrap; the others are 0 in the result. "auto" finds the object.
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
        ``phase``; inside the mask it differs from it by whole turns.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.
    """
    check_method(method, method_options)
    problem = Problem(phase, boundary, mask, amplitude)
    problem.for_one_method = True
    return run_method(problem, method, progress, cancelled, method_options)


def run_method(
    problem: Problem,
    method: str,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    options: Mapping[str, Any],
) -> xr.DataArray:
    """Run one method on a problem and note how, in the result's attributes."""
    chosen = all_options(method, options)
    if not METHODS[method].finds_object:
        problem.settle_mask(progress, cancelled)
    values = METHODS[method].function(problem, progress, cancelled, **chosen)
    attrs = noted(
        method,
        options,
        problem.boundaries,
        mask="auto" if problem.finds_mask else "given" if not problem.mask.all() else "none",
        amplitude=problem.amplitude is not None,
    )
    return problem.result(values, method, attrs)


def all_options(method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a method, those that are not given by their default."""
    return {o.name: o.default for o in METHODS[method].options} | dict(options)


def noted(
    method: str,
    options: Mapping[str, Any],
    boundaries: Sequence[tuple[int, int]],
    *,
    mask: str,
    amplitude: bool,
) -> dict[str, Any]:
    """Return what a result notes of how it was made."""
    return {
        "method": method,
        "options": all_options(method, options),
        "boundary": [list(b) for b in boundaries],
        "mask": mask,
        "amplitude": amplitude,
    }


def label_of(method: str, options: Mapping[str, Any]) -> str:
    """Return a method's short name, with what was chosen where that is not the default."""
    chosen = [
        SPOKEN.get(str(options[o.name]), str(options[o.name]))
        for o in METHODS[method].options
        if o.choices and options.get(o.name, o.default) != o.default
    ]
    label = METHODS[method].label
    return f"{label} ({', '.join(chosen)})" if chosen else label


def check_method(method: str, options: Mapping[str, Any]) -> None:
    """Raise ValueError for unknown methods and TypeError for options that a method lacks."""
    if not isinstance(method, str) or method not in METHODS:
        msg = f"method must be one of {', '.join(METHODS)}, but is {method!r}"
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
            msg = f"the option {option.name} of {method} takes a {kind}, but got {value!r}"
            raise TypeError(msg)
        if option.choices and value not in option.choices:
            msg = f"{option.name} must be one of {', '.join(option.choices)}, but is {value!r}"
            raise ValueError(msg)


def takes(option: Option, value: Any) -> bool:
    """Say whether a value has the type of an option; a whole number will do for a float."""
    if isinstance(option.default, float):
        return isinstance(value, float | int) and not isinstance(value, bool)
    return type(value) is type(option.default)
