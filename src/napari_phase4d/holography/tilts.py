"""How frames tilt against each other, where the arms of the interferometer move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.background import MUCH_LEFT_RAD, aligned_to
from napari_phase4d.holography.emptyfield import FrameTilt

__all__ = ["TiltsBetween", "in_line", "tilt_advice"]

#: Tilts are believed if they are contradicted by less than this share of them.
MOST_CONTRADICTED = 0.5
#: A tilt is taken off a frame that agrees with another by so much more without: 0.14 rad rms.
MORE_ALIKE = 1.01
#: Of so many rows and columns one tells how strong a field is.
SOME = 4

Field = NDArray[np.complex64]
Fields = NDArray[np.complex64]
Tilts = list[tuple[float, float]]


class TiltsBetween:
    """The tilts of frames next to the first of them, and what is taken off by them.

    What frames have in common, as aberrations and what stands still, drops out of the product of
    one with the conjugate of another, so their tilts are known before the background is.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the fields in pixels.
    take_off : bool
        Whether the fields are given back with the tilt of the first frame instead of their own.
    """

    def __init__(self, shape: tuple[int, int], take_off: bool) -> None:
        self._tilt = FrameTilt(shape)
        self._take_off = take_off
        self._found: list[Tilts] = []
        self._steps: list[Tilts] = []

    def seen(self, each: Iterator[Fields]) -> Iterator[Fields]:
        """Yield the fields (view, y, x) of frames, levelled in place if that is asked for.

        They may be turned by constant phases afterwards, but by nothing else.
        """
        first = before = next(each)
        self._found.append([(0.0, 0.0)] * len(first))
        yield first
        for fields in each:
            tilts = self._between(first, fields)
            self._found.append(tilts)
            if self._take_off:
                for field, tilt in zip(fields, tilts, strict=True):
                    self._tilt.subtract(tilt, field)
            else:
                self._steps.append(self._between(before, fields))
            before = fields
            yield fields

    def _between(self, one: Fields, other: Fields) -> Tilts:
        """Return the tilt from one frame to another in each view."""
        return [self._tilt.of(relative(b, a)) for a, b in zip(one, other, strict=True)]

    def left_rad(self) -> list[float]:
        """Return what one tilt for all frames leaves in each view of a usual one, in rad rms.

        It is 0 where the tilts contradict those from each frame to the next, as they do where
        large objects that move are taken for tilts.
        """
        found = np.array(self._found)  # (frame, view, axis)
        left = usual_rad(found - np.median(found, axis=0))
        if self._steps:
            off = usual_rad(np.diff(found, axis=0) - np.array(self._steps))
            left[off > MOST_CONTRADICTED * left] = 0.0
        return [float(rad) for rad in left]


def in_line(first: Field, field: Field, tilt: FrameTilt) -> Field:
    """Return a field, turned in place to agree with the first: by a constant phase, and a tilt.

    The tilt counts only where the two agree clearly better without: an object that moves may be
    taken for one, but the empty field agrees less then.

    Parameters
    ----------
    first, field : ndarray of shape (y, x)
        Complex fields of one view.
    tilt : FrameTilt
        Of their size.
    """
    slopes = tilt.of(relative(field, first))
    if any(slopes):
        level = field.copy()
        tilt.subtract(slopes, level)
        if abs(np.vdot(first, level)) > MORE_ALIKE * abs(np.vdot(first, field)):
            field[...] = level
    return aligned_to(first, field)


def relative(field: Field, to: Field) -> Field:
    """Return the phase of a field relative to another's, with an amplitude of about 1.

    Grey values of 64 bits give fields whose products go beyond single precision.
    """
    product = field * to.conj()
    some = np.abs(product[::SOME, ::SOME])
    size = np.float32(max(float(np.median(some)), float(np.finfo(np.float32).tiny)))
    found: Field = product / size
    return found


def usual_rad(tilts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median over frames of tilts (frame, view, axis) in each view, in rad rms."""
    # A slope from -1 to 1 has a mean square of 1/3.
    rad: NDArray[np.float64] = np.median(np.sqrt((tilts**2).sum(axis=2) / 3), axis=0)
    return rad


def tilt_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views frames tilt against each other, and what to do; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    much = {
        view: left
        for view, left in enumerate(attrs.get("frame_tilt_left_rad", ()))
        if left > MUCH_LEFT_RAD
    }
    if not much:
        return ""
    views = " and ".join(f"view {view + 1} ({left:.1f} rad rms)" for view, left in much.items())
    return (
        f"frames tilt against each other, and what they don't share is left in {views}: "
        "tick Tilt (tilt_per_frame=True), unless an object that moves fills most of the view"
    )
