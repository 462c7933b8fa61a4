"""What every reader returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Video"]


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
    """

    frames: Any
    pixel_um: float | None = None
    interval_s: float | None = None
    colour: bool = False
