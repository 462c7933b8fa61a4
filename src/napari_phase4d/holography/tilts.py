"""How frames tilt against each other, where the arms of the interferometer move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.background import MUCH_LEFT_RAD
from napari_phase4d.holography.emptyfield import FrameTilt

__all__ = ["TiltsBetween", "tilt_advice"]

Fields = NDArray[np.complex64]


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
        self._found: list[list[tuple[float, float]]] = []

    def seen(self, each: Iterator[Fields]) -> Iterator[Fields]:
        """Yield the fields (view, y, x) of frames, levelled in place if that is asked for."""
        first = next(each)
        self._found.append([(0.0, 0.0)] * len(first))
        common = first.conj()
        yield first
        for fields in each:
            pairs = zip(fields, common, strict=True)
            tilts = [self._tilt.of(field * other) for field, other in pairs]
            self._found.append(tilts)
            if self._take_off:
                for field, tilt in zip(fields, tilts, strict=True):
                    self._tilt.subtract(tilt, field)
            yield fields

    def left_rad(self) -> list[float]:
        """Return what one tilt for all frames leaves in each view of a usual one, in rad rms."""
        found = np.array(self._found)  # (frame, view, axis)
        away = found - np.median(found, axis=0)
        # A slope from -1 to 1 has a mean square of 1/3.
        rms = np.sqrt((away**2).sum(axis=2) / 3)
        return [float(left) for left in np.median(rms, axis=0)]


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
        f"frames tilt against each other, which one tilt for all leaves in {views}: tick Tilt "
        "(tilt_per_frame=True)"
    )
