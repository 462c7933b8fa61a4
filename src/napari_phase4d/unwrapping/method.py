"""What the program knows of an unwrapping method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["STACKS_OF_A_FRAME", "Method", "Option"]

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
        Whether frames that say nothing are left out; its results then list them as
        ``attrs["lost_frames"]``.
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
