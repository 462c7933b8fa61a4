"""What every reader returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

__all__ = ["Facts", "Video"]


class Facts(TypedDict, total=False):
    """What a file says of its scale, see `Video`."""

    pixel_um: float
    interval_s: float


@dataclass(frozen=True)
class Video:
    """Frames as they lie in a file, with what the file says of them.

    Parameters
    ----------
    frames : array_like
        Lazy or in memory; (time, y, x) or (y, x), plus a last axis for colour.
    pixel_um : float, optional
        Width of a pixel in the sample in micrometres, if the file says it.
    interval_s : float, optional
        Time between frames in seconds, if the file says it.
    colour : bool
        Whether the last axis is colour.
    kind : str
        What was read, in words for the user, such as "BigTIFF" or "H.264 in MP4".
    dataset : str
        Which of several arrays was read, empty where there is only one.
    times_s : ndarray of float64, shape (time,), optional
        Time of each frame in seconds, if the file says it and frames are not evenly spaced.
    axes : str
        The letters of the axes where there may be more than three, such as "TZYX".
    notes : tuple of str
        What had to be assumed or chosen, in sentences for the user.
    """

    frames: Any
    pixel_um: float | None = None
    interval_s: float | None = None
    colour: bool = False
    kind: str = ""
    dataset: str = ""
    times_s: NDArray[np.float64] | None = None
    axes: str = ""
    notes: tuple[str, ...] = ()
