"""All unwrapping methods, in the order in which they are shown: what is known of each.

Those of this program come first, then those that other packages bring.
"""

from __future__ import annotations

import functools
import re
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from napari_phase4d.unwrapping import chain, volumes
from napari_phase4d.unwrapping.dilate_erode import dilate_erode
from napari_phase4d.unwrapping.directional import directional_growing, directional_l1
from napari_phase4d.unwrapping.laplacian import laplacian
from napari_phase4d.unwrapping.light.synthetic import BEATS, synthetic_wavelength
from napari_phase4d.unwrapping.network_flow import network_flow

__all__ = [
    "BUILT_IN",
    "GROUP",
    "METHODS",
    "STACKS_OF_A_FRAME",
    "Method",
    "Option",
    "WithInstalled",
]

#: Memory of each thread while it unwraps single frames, in sizes of a frame as float32.
STACKS_OF_A_FRAME = 20.0


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
        ``function(problem, progress, cancelled, **options) -> (time, angle, y, x)`` of a method
        that a package brings. Those of this program take a `Task` in place of the two calls; of
        one that streams, ``function(problem, result, task, **options)`` writes the result to a
        stack and returns the smallest and largest phase of each block.
    options : tuple of Option
        Its settings.
    working_stacks : float
        Largest memory at one time beyond its input and the shared first step, in sizes of the
        wrapped phase as float32, with the variant that needs most. Measured at noise of up to
        0.7 rad, and rounded up.
    finds_object : bool
        Whether it tells the object from the empty field by itself, so that mask "auto" costs it
        no other unwrapping first.
    wavelengths : int
        How many wavelengths an angle must have. One that needs no more than 1 (default) is given
        the views of each wavelength by themselves, since phases of different wavelengths can't be
        held against each other as they are.
    streams : bool
        Whether it goes through the frames one after the other, so that a recording may be larger
        than memory. Only methods of this program do: it counts as False for those of packages.
    block_bytes : int
        Bytes for each pixel of a block while it is worked on, if the method streams.
    kept_bytes : float
        Bytes for each pixel of the recording that stay in memory even then.
    scratch_bytes : int
        Bytes for each pixel of the recording that it needs on disk on the way.
    name : str
        Its full name; empty for its label.
    package : str
        Name and version of the package that brought it; empty for those of this program.
    leaves_out : bool
        Whether frames are left out that say nothing, or fit neither neighbour; its results then
        list them as ``attrs["lost_frames"]``.
    along : tuple of str
        Dimensions, "time" or "angle", that it goes along. Where one of them has a single frame,
        another method gives the same.
    """

    label: str
    source: str
    summary: str
    function: Callable[..., Any]
    options: tuple[Option, ...] = ()
    working_stacks: float = 5.0
    finds_object: bool = False
    leaves_out: bool = False
    streams: bool = False
    block_bytes: int = 48
    kept_bytes: float = 0.0
    scratch_bytes: int = 10
    name: str = ""
    package: str = ""
    wavelengths: int = 1
    along: tuple[str, ...] = ()


# ---- methods that other packages bring ------------------------------------------------------


#: The group of entry points under which a package names its methods.
GROUP = "napari_phase4d.methods"
#: What an id may look like: it stands in file names, commands and recipes.
ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
#: Keywords of `unwrap`, which no option may take.
TAKEN = {"phase", "method", "boundary", "mask", "progress", "cancelled", "amplitude"}


class WithInstalled(Mapping[str, Method]):
    """Methods of this program, and of what is installed when they are first looked at.

    A package that can't be used is left out with a warning: it must not stop the others.

    Parameters
    ----------
    own : mapping of str to Method
        The program's methods by their ids.
    """

    def __init__(self, own: Mapping[str, Method]) -> None:
        self._own = dict(own)
        self._lock = threading.RLock()

    @functools.cached_property
    def _all(self) -> dict[str, Method]:
        with self._lock:
            return self._own | installed_methods(self._own)

    def __getitem__(self, method: str) -> Method:
        found = self._own.get(method)
        return self._all[method] if found is None else found

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)


def installed_methods(own: Mapping[str, Method]) -> dict[str, Method]:
    """Return the methods of installed packages, in the order of their ids."""
    found: dict[str, Method] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            found[point.name] = loaded(point, {*own, *found})
        except KeyboardInterrupt:  # the user's, as far as can be told
            raise
        except BaseException as error:  # whatever the package does wrong, sys.exit() too
            why = words_of(error)
            warnings.warn(
                f"the unwrapping method {point.name!r} of {package_of(point)} is left out: {why}",
                stacklevel=2,
            )
    return found


def words_of(error: BaseException) -> str:
    """Return what an error of another package says, its name where that says nothing."""
    try:
        return " ".join(str(error).split()) or type(error).__name__
    except Exception:  # nor does it know how to say it
        return type(error).__name__


def loaded(point: EntryPoint, taken: set[str]) -> Method:
    """Return the method of an entry point.

    Only the program's own methods stream: how each goes through the blocks is written for it.

    Raises
    ------
    ValueError, TypeError
        If its id or an option can't be used, or it is no `Method`.
    """
    if point.name in taken:
        msg = "there is a method of this id already"
        raise ValueError(msg)
    if not ID.fullmatch(point.name):
        msg = "an id is made of small letters, digits and single hyphens"
        raise ValueError(msg)
    outlets = sys.stdout, sys.stderr
    try:
        method = point.load()
    finally:
        sys.stdout, sys.stderr = outlets  # what it put in their place
    if not isinstance(method, Method):
        msg = f"{point.value} is a {type(method).__name__}, not a Method"
        raise TypeError(msg)
    for option in method.options:
        if option.name in TAKEN or not option.name.isidentifier():
            msg = f"an option can't be called {option.name!r}"
            raise ValueError(msg)
    return replace(method, package=package_of(point), streams=False)


def package_of(point: EntryPoint) -> str:
    """Return name and version of the package that an entry point belongs to."""
    return (
        "an unknown package" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    )


# ---- the methods of this program ------------------------------------------------------------


OWN = "This project"
#: Memory of the directional methods for each pixel of a block (all that steps are weighed by), and
#: of the recording (regions, and the edges between them), in bytes; on disk the phase without
#: noise, the noise that is left, groups and turns.
OF_A_BLOCK, OF_REGIONS, OF_SCRATCH = 300, 2.0, 16
#: Memory of DE for each pixel of a block: what is carried is in double precision.
OF_DILATING = 80
#: Memory of Flow for each pixel of a block, in bytes; on disk the phase again, the turns and costs
#: of steps, and the turns of pixels.
OF_FLOWS, OF_STEPS = 160, 30
#: Memory of LBE for each pixel of a block, in bytes; on disk what is transformed.
OF_TRANSFORMS, OF_SPECTRA = 60, 26
#: Memory of RG and 3-D for each pixel of a block, in bytes; on disk group and turns of every
#: pixel, and lists of groups.
OF_GROWING, OF_GROUPS = 200, 20
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

#: What both directional methods do and take.
DIRECTIONAL: dict[str, Any] = {
    "working_stacks": 26.0,
    "finds_object": True,
    "leaves_out": True,
    "streams": True,
    "block_bytes": OF_A_BLOCK,
    "kept_bytes": OF_REGIONS,
    "scratch_bytes": OF_SCRATCH,
}

#: The methods of this program.
BUILT_IN: dict[str, Method] = {
    "spatial-2d": Method(
        "2-D",
        "Herraez et al. 2002, Appl. Opt. 41, 7437",
        "Each frame by itself, most reliable pixels first.",
        chain.spatial_2d,
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
        name="frame by frame, by reliability",
    ),
    "angular": Method(
        "Angular",
        "Dardikman et al. 2017, Opt. Express 25, 3347",
        "From the thin angle to the others, at each time.",
        chain.angular,
        CHAIN_OPTIONS,
        streams=True,
        name="along the angle only",
        along=chain.ORDERS["angular"],
    ),
    "temporal": Method(
        "Temporal",
        PAPER,
        "From the thin time to the others, for each angle.",
        chain.temporal,
        CHAIN_OPTIONS,
        streams=True,
        name="along time only",
        along=chain.ORDERS["temporal"],
    ),
    "temporal-angular": Method(
        "T/A",
        PAPER + ", Fig. 1(a)",
        "Along time first, then along the angle.",
        chain.temporal_angular,
        CHAIN_OPTIONS,
        streams=True,
        name="along time, then angle",
        along=chain.ORDERS["temporal-angular"],
    ),
    "angular-temporal": Method(
        "A/T",
        PAPER + ", Fig. 1(b)",
        "Along the angle first, then along time.",
        chain.angular_temporal,
        CHAIN_OPTIONS,
        streams=True,
        name="along angle, then time",
        along=chain.ORDERS["angular-temporal"],
    ),
    "laplacian": Method(
        "LBE",
        "Schofield & Zhu 2003, Opt. Lett. 28, 1194; in 4-D: Barnhill et al. 2015",
        "Solves for the phase whose Laplacian is that of the wrapped phase; an estimate.",
        laplacian,
        (
            VARIANT,
            Option("rounded", False, "Add whole turns to the wrapped phase, the nearest to it."),
        ),
        working_stacks=8.0,
        streams=True,
        block_bytes=OF_TRANSFORMS,
        scratch_bytes=OF_SPECTRA,
        name="Laplacian-based estimate",
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
        working_stacks=50.0,  # of "phasetools"; "textbook" takes 15,
        streams=True,
        block_bytes=OF_GROWING,
        scratch_bytes=OF_GROUPS,
        name="region growing in 4-D",
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
        working_stacks=6.0,
        streams=True,
        block_bytes=OF_DILATING,
        name="dilate, erode, propagate",
    ),
    "spatial-3d": Method(
        "3-D",
        "Abdul-Rahman et al. 2007, Appl. Opt. 46, 6623",
        "Joins pixels over time, y and x for each angle, most reliable edges first.",
        volumes.spatial_3d,
        working_stacks=10.0,
        streams=True,
        block_bytes=OF_GROWING,
        scratch_bytes=OF_GROUPS,
        name="reliability in time, y and x",
        along=("time",),
    ),
    "network-flow": Method(
        "Flow",
        "Pepe & Lanari 2006, IEEE Trans. Geosci. Remote Sens. 44, 2374; after Costantini",
        "Fewest whole turns that close all loops: over time and angle, then in each frame.",
        network_flow,
        working_stacks=36.0,
        streams=True,
        block_bytes=OF_FLOWS,
        scratch_bytes=OF_STEPS,
        name="network flow, time and angle first",
    ),
    "directional-growing": Method(
        "RGd",
        OWN,
        "Joins pixels over time, angle, y and x, first where steps change least along themselves.",
        directional_growing,
        **DIRECTIONAL,
        name="directional region growing",
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
        **DIRECTIONAL,
        name="directional L1",
    ),
    "synthetic-wavelength": Method(
        "Synthetic",
        "Gass, Dakoff & Kim 2003, Opt. Lett. 28, 1141; of multiplexed holograms: Mirsky & Shaked "
        "2023, Sci. Rep. 13, 19293",
        "From the beat of two or three wavelengths down to the shortest; tells sheer steps too.",
        synthetic_wavelength,
        (
            Option(
                "beat",
                "spatial",
                'How the phase of the longest synthetic wavelength is unwrapped; "wrapped" where '
                "the object is thinner than half of it everywhere.",
                tuple(BEATS),
            ),
            Option(
                "settle",
                True,
                "Settle turns that noise leaves in doubt together with their neighbours'.",
            ),
            Option(
                "cauchy_um2",
                0.0,
                "Dispersion of the object: C in 1 + C / wavelength^2, in square micrometres.",
            ),
        ),
        working_stacks=20.0,  # with the beat by WL1; else 8
        finds_object=True,
        streams=True,
        block_bytes=OF_A_BLOCK // 2,  # there are half as many beats as views at most
        kept_bytes=OF_REGIONS / 2,
        scratch_bytes=OF_SCRATCH,
        wavelengths=2,
        name="synthetic wavelength, hierarchical",
    ),
}

#: Method id -> Method: those of this program, then those of installed packages by their ids.
METHODS: Mapping[str, Method] = WithInstalled(BUILT_IN)
