"""How good a hologram is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.emptyfield import ENOUGH_BACKGROUND
from napari_phase4d.later import xr
from napari_phase4d.stacks import AXES
from napari_phase4d.words import counted

__all__ = [
    "alike_around",
    "empty_advice",
    "fringe_advice",
    "fringe_contrast",
    "fringe_mask",
    "fringe_visibility",
    "is_noise",
    "lost_advice",
    "parts_of_views",
    "shows_fringes",
    "times_of_views",
]

#: Fringes are looked at in squares of so many pixels, so that uneven light does not count.
BLOCK = 16
#: A field is compared with itself so many pixels on, over a window of so many pixels a side.
APART, WINDOW = 3, 11
#: Noise is less alike to itself than this, from 0 to 1, and darker than this share of what is
#: bright in the view: its 90 % quantile. What is fainter than another share is noise in any case.
ALIKE, DARK, FAINT, BRIGHT = 0.5, 0.25, 0.05, 0.9
#: Speckle contrast above this is that of noise, 0.52; of dense layers of steep cells it is 0.2 to
#: 0.35.
SPECKLED = 0.42
#: Visibility may come out so large by noise.
MOST_VISIBLE = 1.05
#: Visibility below which there are no fringes, but noise.
FAINTEST = 0.004
#: From so many percent of a view on it is worth a warning.
MUCH_PERCENT = 5.0
#: Share of empty field below which its level is not to be relied on: so many pixels lie near any
#: level where all phases are as frequent.
LITTLE_EMPTY = 0.3


def fringe_contrast(frame: NDArray[np.floating]) -> float:
    """Return the contrast of the fringes, (max - min) / (max + min), from 0 to 1.

    Brightest and darkest grey value are the 98th and 2nd percentile of a small square, so that
    neither hot pixels nor uneven light count; the contrast is the median over all squares. Camera
    noise counts too.

    Parameters
    ----------
    frame : ndarray, shape (y, x)
        Grey values, 0 where it is dark.

    Returns
    -------
    float
        0 for a frame that is dark or constant.
    """
    side = min(BLOCK, *frame.shape)
    height, width = (n // side * side for n in frame.shape)
    blocks = frame[:height, :width].reshape(height // side, side, width // side, side)
    low, high = np.percentile(blocks, (2, 98), axis=(1, 3))
    lit = high + low > 0
    if not lit.any():
        return 0.0
    return float(np.median((high - low)[lit] / (high + low)[lit]))


def fringe_visibility(
    frame: NDArray[np.generic],
    demodulate: Demodulator,
    fields: NDArray[np.complex64] | None = None,
) -> list[float]:
    """Return the visibility of each view's own fringes in a frame.

    Fringes I (1 + V cos(2 pi k r)) leave a field of amplitude I V / 2 in their lobe; so V is twice
    the median amplitude over the mean grey value. Noise outside the lobe does not count, nor do
    the fringes of the other views, but a dark level of the camera counts as light. Where light
    was taken off, as the mean is by some, what is left is no measure of it.

    Parameters
    ----------
    frame : ndarray of shape (y, x)
        Grey values, 0 where it is dark.
    demodulate : Demodulator
        Gives the fields of all views.
    fields : ndarray of shape (view, y, x), optional
        What it gives for this frame, where that is known already.

    Returns
    -------
    list of float
        One a view, in the order of the demodulator's lobes; 0 for a dark frame. NaN where grey
        values are not 0 in the dark, since no fringes are stronger than the light is.
    """
    mean = float(frame.mean(dtype=np.float64))
    if fields is None:
        fields = demodulate(frame)
    return [believed(2 * float(np.median(np.abs(view))), mean) for view in fields]


def believed(strength: float, mean: float) -> float:
    """Return a visibility from 0 to 1, NaN where the mean grey value is no measure of light."""
    if strength == 0:
        return 0.0
    if mean <= 0 or strength > MOST_VISIBLE * mean:
        return math.nan
    return min(strength / mean, 1.0)


def shows_fringes(field: NDArray[np.complex64]) -> NDArray[np.bool_]:
    """Mark the pixels of a field in which fringes were seen; elsewhere its phase is noise.

    Noise is dark next to what the fringes give, and not alike to itself some pixels on; a dark
    object is alike to itself, and where its rim is not, it is not that dark.

    Parameters
    ----------
    field : ndarray of shape (y, x)
        Complex field of one view.
    """
    size = np.abs(field)
    bright = float(np.quantile(size, BRIGHT))
    if bright == 0:
        return np.zeros(field.shape, dtype=bool)
    alike = alike_around(field, size)
    if float(np.quantile(alike, BRIGHT)) < ALIKE and is_speckled(size):
        return np.zeros(field.shape, dtype=bool)  # of nothing but noise, some is bright as well
    local = scipy.ndimage.uniform_filter(size, WINDOW // 2)
    found: NDArray[np.bool_] = local >= DARK * bright
    found |= (local >= FAINT * bright) & (alike > ALIKE)
    return found


def is_speckled(size: NDArray[np.float32]) -> bool:
    """Say whether the amplitude varies as that of noise does.

    Steep cells that are smaller than the window are no more alike to themselves some pixels on
    than noise is, but as bright as what is round them.
    """
    mean = scipy.ndimage.uniform_filter(size, WINDOW)
    variance = scipy.ndimage.uniform_filter(size * size, WINDOW) - mean * mean
    lit = mean > 0
    contrast = np.sqrt(np.maximum(variance[lit], 0)) / mean[lit]
    return bool(lit.any() and np.median(contrast) > SPECKLED)


def is_noise(field: NDArray[np.complex64]) -> bool:
    """Say whether most of a field is not alike to itself some pixels on, as noise is.

    Parameters
    ----------
    field : ndarray of shape (y, x)
        Complex field of one view, which should be an empty field.
    """
    return bool(np.median(alike_around(field, np.abs(field))) < ALIKE)


def alike_around(field: NDArray[np.complex64], size: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how alike a field is to itself round every pixel, along the worse axis."""
    found: NDArray[np.float32] = np.minimum(*(alike_along(field, size, axis) for axis in (0, 1)))
    return found


def alike_along(
    field: NDArray[np.complex64], size: NDArray[np.float32], axis: int
) -> NDArray[np.float32]:
    """Return how alike a field is to itself some pixels on round every pixel, from 0 to 1."""
    n = field.shape[axis]
    there = field.take(np.minimum(np.arange(n) + APART, n - 1), axis)
    product = field.conj() * there
    mean = [scipy.ndimage.uniform_filter(part, WINDOW) for part in (product.real, product.imag)]
    power = scipy.ndimage.uniform_filter(size * np.abs(there), WINDOW)
    alike: NDArray[np.float32] = np.hypot(*mean) / np.maximum(power, np.finfo(np.float32).tiny)
    return alike


def fringe_mask(data: xr.Dataset) -> xr.DataArray:
    """Mark the pixels of a reconstruction in which fringes were seen.

    Elsewhere, such as beyond an aperture or where the beams don't meet, the phase is noise; the
    result may be given to `unwrap` and `compare` as ``mask``.

    Parameters
    ----------
    data : Dataset
        What `reconstruct` gave, in memory.

    Returns
    -------
    DataArray of bool
        In the form of the phase; False in frames that were lost.

    Examples
    --------
    >>> from napari_phase4d.holography import fringe_mask
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena((96, 96), 2, pixel_um=0.5)
    >>> rec = p4d.simulation.multiplexed_video(exact["phase"])
    >>> data = p4d.reconstruct(rec, p4d.find_lobes(rec, n_views=2))
    >>> bool(fringe_mask(data).all())
    True
    """
    leading = [axis for axis in AXES[:2] if axis in data["phase"].dims]
    phase, amplitude = (
        data[name].transpose(*leading, "y", "x") for name in ("phase", "amplitude")
    )
    seen = np.zeros(phase.shape, dtype=bool)
    for frame in np.ndindex(*phase.shape[:-2]):
        size = amplitude.values[frame]
        known = np.isfinite(size)
        field = np.where(known, size, 0) * np.exp(1j * np.nan_to_num(phase.values[frame]))
        seen[frame] = known & shows_fringes(field.astype(np.complex64))
    found = xr.DataArray(seen, phase.coords, phase.dims, name="fringes")
    return found.transpose(*data["phase"].dims)


def fringe_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views of a reconstruction much shows no fringes; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    faint = [(i, v) for i, v in enumerate(attrs.get("fringe_visibility", ())) if 0 < v < FAINTEST]
    if faint:
        views = " and ".join(f"view {i + 1} ({value:.3f})" for i, value in faint)
        return (
            f"The visibility of the fringes is next to nothing in {views}, so that its phase is "
            "noise; is its circle on a lobe of the spectrum?"
        )
    views, count = parts_of_views(attrs.get("without_fringes_percent", ()), MUCH_PERCENT)
    show = "shows" if count == 1 else "show"
    return f"{views} {show} no fringes: the phase there is noise" if count else ""


def parts_of_views(percents: Sequence[float], most: float) -> tuple[str, int]:
    """Name the views of which more than so many percent are meant, and say how many they are.

    Examples
    --------
    >>> parts_of_views([7.2, 0.0, 12.0], 5.0)
    ('7 % of view 1 and 12 % of view 3', 2)
    """
    parts = [f"{part:.0f} % of view {i + 1}" for i, part in enumerate(percents) if part > most]
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]])), len(parts)


def empty_advice(attrs: Mapping[str, Any]) -> str:
    """Say that a frame of a reconstruction shows little empty field; "" if none does.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    share = attrs.get("background_share", 1.0)
    if not attrs.get("drift_removed") or share >= LITTLE_EMPTY:
        return ""
    kept = ", and a frame keeps its drift" if share < ENOUGH_BACKGROUND else ""
    return f"little empty field is in view{kept}; check that the background is at 0"


def lost_advice(attrs: Mapping[str, Any], n_frames: int, most: float = 0.0) -> str:
    """Say how many frames of a reconstruction are lost, and how many views; "" if none is.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    n_frames : int
        How many frames there are.
    most : float, optional
        Share of them that is not worth a word.

    Examples
    --------
    >>> lost_advice({"lost_times": [1]}, 3)
    '1 frame of 3 left out as lost, first at time 1'
    >>> lost_advice({"lost_views": [(1, 0), (2, 0)]}, 3)
    '2 frames of 3 left out in view 1, as its fringes are gone or weak, first at time 1'
    """
    said, whole = [], attrs.get("lost_times", ())
    for words, lost, more in [
        ("left out as lost", whole, 0),
        *(
            (f"left out in view {view + 1}, as its fringes are gone or weak", times, len(whole))
            for view, times in times_of_views(attrs.get("lost_views", ())).items()
        ),
    ]:
        if len(lost) + more > most * n_frames and len(lost):
            number = counted(len(lost), "frame")
            said.append(f"{number} of {n_frames} {words}, first at time {lost[0]}")
    return "; ".join(said)


def times_of_views(lost: Iterable[tuple[int, int]]) -> dict[int, list[int]]:
    """Return the times at which each view is lost.

    Parameters
    ----------
    lost : iterable of tuple of int
        Pairs (time, view), counted from 0, as in ``attrs["lost_views"]``.

    Returns
    -------
    dict of int to list of int
        Times of each view that is lost at any.

    Examples
    --------
    >>> from napari_phase4d.holography import times_of_views
    >>> times_of_views([(1, 0), (2, 1), (2, 0)])
    {0: [1, 2], 1: [2]}
    """
    found: dict[int, list[int]] = {}
    for time, view in lost:
        found.setdefault(view, []).append(time)
    return dict(sorted(found.items()))
