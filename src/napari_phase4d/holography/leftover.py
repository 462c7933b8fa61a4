"""What is left of the background after it has been taken off, and what would take off more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.background import Surface
from napari_phase4d.holography.choosing import LOOK_PIXELS, Look

__all__ = ["MUCH_LEFT_RAD", "BetterSurface", "Left", "background_advice", "curvature_advice"]

#: What to try next, what its surface is fitted with, and what is then left as it is now.
NEXT: dict[str, tuple[str, str, int, str]] = {
    "tilt": ("curvature", "powers", 2, "curvature is"),
    "curvature": ("polynomial", "polynomial", 4, "aberrations are"),
}
#: Another surface counts only if it explains so much more of a view.
CLEARLY_MORE = 1.1
#: From so many radians rms on it is worth another try.
MUCH_LEFT_RAD = 0.3
#: A view with fewer pixels on a side shows too little to tell.
LEAST_SIDE = 24


@dataclass(frozen=True)
class Left:
    """What is left in the empty field of a view.

    Parameters
    ----------
    rad : float
        In radians rms, without the noise.
    explained : bool
        Whether the next better surface explains all corners of the view, so that aberrations are
        the reason why this one does not.
    """

    rad: float
    explained: bool


class BetterSurface:
    """The next better surface than the one that was taken off, to tell what is left.

    What is left can't be told from the pixels near the surface alone: those far from it would be
    taken for the object, however curved the field is.

    Parameters
    ----------
    background : str
        What was taken off, see `reconstruct`.
    shape : tuple of int
        Height and width of the views in pixels.
    """

    def __init__(self, background: str, shape: tuple[int, ...]) -> None:
        self.surface: Surface | None = None
        if background in NEXT and min(shape) >= LEAST_SIDE:
            _, kind, order, _ = NEXT[background]
            self.surface = Surface(kind, order, shape, LOOK_PIXELS)

    def leaves(self, mean: NDArray[np.complex64], taken: NDArray[np.float32]) -> Left:
        """Return what is left in the empty field of a view.

        Parameters
        ----------
        mean : ndarray of shape (y, x)
            The field before anything was taken off.
        taken : ndarray of shape (y, x)
            The phase that is taken off, in radians.
        """
        look = Look(mean)
        seen = (slice(None, None, look.step),) * 2
        own = look.judged(taken[seen].astype(np.float64))
        if self.surface is not None:
            better = self.surface.fit(mean)
            judged = look.judged(better.surface[seen].astype(np.float64))
            clear = not better.doubt and judged.ends >= judged.of_ends - 1
            if clear and judged.share > CLEARLY_MORE * own.share:
                left = (better.surface - taken)[seen][judged.near] + judged.rest[judged.near]
                return Left(float(np.std(left)), judged.ends == judged.of_ends)
        return Left(float(np.std(own.rest[own.near])) if own.near.any() else 0.0, False)


def background_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views of a reconstruction much is left, and what to try; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    background = attrs.get("background")
    lefts: Sequence[float] = attrs.get("background_left_rad", ())
    much = [(i, left) for i, left in enumerate(lefts) if left > MUCH_LEFT_RAD]
    if not much or background not in NEXT:
        return ""
    name, _, _, what = NEXT[background]
    views = " and ".join(f"view {i} ({left:.1f} rad rms)" for i, left in much)
    return f"{what} left in {views}: try background={name!r}"


def curvature_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views the curvature that was taken off may be the object's; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    views = attrs.get("curvature_unsure", ())
    if not views:
        return ""
    named = " and ".join(f"view {view}" for view in views)
    return (
        f"one corner of {named} does not look empty, so that the curvature taken off may be the "
        "object's: compare with background='tilt', or use a reference hologram"
    )
