"""Binary masks of the object (step 2 of the paper's algorithms)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.filters import gaussian, middle, running_mean, upper_quantile
from napari_phase4d.unwrapping.patches import extent, fill_holes, remove_specks, widened
from napari_phase4d.unwrapping.spatial import border_values

__all__ = [
    "left_out_advice",
    "left_out_note",
    "object_mask",
    "smooth_share_left_out",
]

#: A pixel belongs to the object where its phase exceeds this share of the largest ...
SHARE_OF_PEAK = 0.1
#: ... which is taken where all but this share of the frame lies below it ...
PEAK = 0.995
#: ... and so many standard deviations of the background.
DEVIATIONS = 4.0
#: Blobs smaller than this share of the frame are noise.
SMALLEST_SHARE = 0.002
#: What lies on more of the border than this is no single object; nothing is then left out.
LARGEST_BORDER_SHARE = 0.5
#: Pixels to widen the mask by, so that the object's rim is inside.
WIDEN = 2
#: What is left out is looked at on every so-manieth row and column.
THIN = 2
#: Phase is not flat so far from the level of what is left out, and smooth where it lies so near to
#: its surroundings, both in radians ...
NOT_FLAT_RAD, SMOOTH_RAD = 1.0, 0.5
#: ... in so large a share of them.
MOSTLY = 0.8
#: From so many percent of the field on it is worth a warning.
MUCH_LEFT_OUT_PERCENT = 10.0


def object_mask(unwrapped: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the mask of what rises out of the background of one frame.

    Where no single object can be told from a background, nothing is left out.

    Parameters
    ----------
    unwrapped : ndarray of shape (y, x)
        Unwrapped phase in radians.
    """
    edge = border_values(unwrapped)
    level = float(np.median(edge))
    noise = 1.4826 * float(np.median(np.abs(edge - level)))
    height = gaussian(unwrapped, level)
    np.abs(height, out=height)
    threshold = max(SHARE_OF_PEAK * float(upper_quantile(height, PEAK)), DEVIATIONS * noise, 1e-3)
    above: NDArray[np.bool_] = height > threshold
    top, bottom, left, right = extent(above, WIDEN + 1)
    part = above[top:bottom, left:right].copy()
    fill_holes(part)
    remove_specks(part, SMALLEST_SHARE * above.size)
    above[top:bottom, left:right] = part
    if not part.any() or border_values(above).mean() > LARGEST_BORDER_SHARE:
        return np.ones(above.shape, dtype=bool)
    above[top:bottom, left:right] = widened(part, WIDEN)
    return above


def smooth_share_left_out(unwrapped: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Return the share of a frame that a mask leaves out though its phase is smooth and not flat.

    The phase of an empty field is flat, and that of noise is not smooth; what is neither may well
    be measured.

    Parameters
    ----------
    unwrapped : ndarray of shape (y, x)
        Unwrapped phase in radians.
    mask : ndarray of bool, shape (y, x)
        What is kept.
    """
    out = ~mask[::THIN, ::THIN]
    if not out.any():
        return 0.0
    phase = unwrapped[::THIN, ::THIN]
    soft = running_mean(phase, 3)
    uneven = out & (np.abs(soft - middle(soft[out])) > NOT_FLAT_RAD)
    if not uneven.any():
        return 0.0
    near = (np.abs(phase - soft) < SMOOTH_RAD).astype(np.float32)
    uneven &= running_mean(near, 5) > MOSTLY
    return float(uneven.mean())


def left_out_note(share: float) -> dict[str, Any]:
    """Return what a result notes of the share left out; nothing if there is none."""
    percent = round(100 * share, 1)
    return {"smooth_left_out_percent": percent} if percent else {}


def left_out_advice(attrs: Mapping[str, Any]) -> str:
    """Say that a mask found by itself leaves out much that may be measured; "" if it does not.

    Parameters
    ----------
    attrs : mapping
        The notes of a result.

    Examples
    --------
    >>> left_out_advice({"smooth_left_out_percent": 31.2})[:46]
    '"object only" leaves out 31 % of the field tho'
    """
    percent = attrs.get("smooth_left_out_percent", 0.0)
    if percent <= MUCH_LEFT_OUT_PERCENT:
        return ""
    return (
        f'"object only" leaves out {percent:.0f} % of the field though its phase there is smooth '
        "and not flat: try the whole field"
    )
