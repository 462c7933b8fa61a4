"""What the map of frames shows, in numbers: ways through the frames, ticks and cells (no Qt)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping import ORDERS
from napari_phase4d.unwrapping.chain import starts_on
from napari_phase4d.unwrapping.pieces import pieces_between

__all__ = [
    "Arrow",
    "Frame",
    "Grid",
    "best_per_pixel",
    "path_arrows",
    "spread",
    "time_ticks",
    "time_unit",
]

#: (time index, angle index).
Frame = tuple[int, int]
#: Steps between labelled times are one of these times a power of ten.
NICE_STEPS = (1, 2, 5)
#: Recordings shorter than so many seconds are labelled in units of so many seconds.
TIME_UNITS = ((600.0, 1.0, "s"), (36_000.0, 60.0, "min"), (np.inf, 3600.0, "h"))


@dataclass(frozen=True)
class Arrow:
    """A straight way through frames.

    Parameters
    ----------
    start, end : (int, int)
        First and last frame, (time index, angle index).
    pass_number : int
        1 for the pass that is made first, 2 for the second.
    """

    start: Frame
    end: Frame
    pass_number: int


def path_arrows(
    path: str | None,
    n_times: int,
    n_angles: int,
    boundaries: Sequence[Frame],
    *,
    most_times: int | None = None,
    most_angles: int | None = None,
) -> list[Arrow]:
    """Return the ways that a method goes from its boundary frames, after the paper's Fig. 1.

    The first of two passes goes along the line of each boundary frame; the second leaves that
    line at each of its frames. A single pass goes along every line. Where a line has several
    frames to start from, each is left until half way to the next.

    Parameters
    ----------
    path : str or None
        One of `ORDERS`; None is no way at all.
    n_times, n_angles : int
        How many frames there are, at least 1 each.
    boundaries : sequence of (int, int)
        Where it starts, (time index, angle index); at least one.
    most_times, most_angles : int, optional
        Draw at most so many arrows next to each other, evenly spread over the times or angles
        and one of them from the first boundary frame.

    Returns
    -------
    list of Arrow
        First pass first; within a pass by line, onwards before backwards. Arrows of no length
        are left out.

    Raises
    ------
    ValueError
        If the path is not known or a boundary frame does not exist.
    """
    if path is None:
        return []
    if path not in ORDERS:
        msg = f"path is {path!r}; it must be one of {', '.join(ORDERS)}"
        raise ValueError(msg)
    for t, a in boundaries:
        if not (0 <= t < n_times and 0 <= a < n_angles):
            msg = f"boundary is {(t, a)}, but there are {n_times} times and {n_angles} angles"
            raise ValueError(msg)
    known, counts, most = list(boundaries), (n_times, n_angles), (most_times, most_angles)
    arrows: list[Arrow] = []
    for number, dim in enumerate(ORDERS[path], start=1):
        along, across = (0, 1) if dim == "time" else (1, 0)
        lines = sorted({frame[across] for frame in known})
        if number == len(ORDERS[path]):
            lines = spread(counts[across], most[across], known[0][across])
        for line in lines:
            for piece in pieces_between(starts_on(dim, line, known), counts[along], None):
                start = on_line(dim, piece.start, line)
                ends = (on_line(dim, end, line) for end in (piece.stop - 1, piece.first))
                arrows += [Arrow(start, end, number) for end in ends if start != end]
    return arrows


def on_line(dim: str, place: int, line: int) -> Frame:
    """Return the frame at a place of a line along a dimension."""
    return (place, line) if dim == "time" else (line, place)


def spread(count: int, most: int | None, keep: int) -> list[int]:
    """Return at most ``most`` of the numbers 0 to ``count - 1``, evenly spread.

    ``keep`` is always among them.
    """
    stride = 1 if most is None else -(-count // most)
    return list(range(keep % stride, count, stride))


def time_ticks(times_s: NDArray[np.floating], most: int) -> list[tuple[float, str]]:
    """Choose round times to write under the frames.

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        Time of each frame in seconds.
    most : int
        How many labels there is room for; two are always allowed.

    Returns
    -------
    list of (float, str)
        Position as a (fractional) time index, and the time with its unit (s, min or h).
        Times that do not grow from frame to frame get a label at their ends.
    """
    factor, unit = time_unit(times_s)
    shown = np.asarray(times_s, dtype=np.float64) / factor
    low, high = float(shown[0]), float(shown[-1])
    if len(shown) == 1:
        return [(0.0, f"{low:.4g} {unit}")]
    if np.any(np.diff(shown) <= 0):
        return [(0.0, f"{low:.4g} {unit}"), (len(shown) - 1.0, f"{high:.4g} {unit}")]
    step, decimals = nice_step(high - low, max(most, 2))
    first, last = int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6))
    values = np.arange(first, last + 1) * step
    positions = np.interp(values, shown, np.arange(len(shown)))
    texts = [f"{value:.{decimals}f} {unit}" for value in values]
    return list(zip(positions.tolist(), texts, strict=True))


def time_unit(times_s: NDArray[np.floating]) -> tuple[float, str]:
    """Return the unit that suits a recording: its length in seconds, and its sign."""
    longest = float(np.max(np.abs(times_s)))
    return next((seconds, sign) for below, seconds, sign in TIME_UNITS if longest < below)


def nice_step(span: float, most: int) -> tuple[float, int]:
    """Return the smallest round step with at most ``most`` ticks on ``span``, and its decimals."""
    power = int(np.floor(np.log10(span))) - 2
    while True:
        for nice in NICE_STEPS:
            step = nice * 10.0**power
            if span / step + 1 <= most + 1e-6:
                return step, max(0, -power)
        power += 1


def best_per_pixel(scores: NDArray[np.floating], width: int) -> NDArray[np.float32]:
    """Return scores (time, angle) for at most ``width`` columns of pixels.

    Where several times share a column, it holds the highest score, so that a short safe moment
    of a long recording stays visible; NaN only where none is known.
    """
    n_times = len(scores)
    values: NDArray[np.float32] = np.asarray(scores, dtype=np.float32)
    if n_times <= width:
        return values
    # A frame belongs to the pixel that its middle is in.
    starts = -((width - 2 * np.arange(width) * n_times) // (2 * width))
    found = np.maximum.reduceat(np.where(np.isnan(values), -np.inf, values), starts, axis=0)
    return np.where(np.isinf(found), np.float32(np.nan), found).astype(np.float32)


@dataclass(frozen=True)
class Grid:
    """Where the frames are drawn: time to the right, angle upwards, as in Fig. 1.

    Parameters
    ----------
    left, top, width, height : float
        Place of all frames in pixels of the widget.
    n_times, n_angles : int
        How many frames there are.
    """

    left: float
    top: float
    width: float
    height: float
    n_times: int
    n_angles: int

    @property
    def cell(self) -> tuple[float, float]:
        """Width and height of one frame in pixels."""
        return self.width / self.n_times, self.height / self.n_angles

    def centre(self, t: float, a: float) -> tuple[float, float]:
        """Return the middle (x, y) of a frame in pixels."""
        width, height = self.cell
        return self.left + (t + 0.5) * width, self.top + self.height - (a + 0.5) * height

    def nearest(self, x: float, y: float, reach: float) -> Frame | None:
        """Return the frame nearest to a pixel; None further than ``reach`` pixels outside."""
        right, bottom = self.left + self.width, self.top + self.height
        if not (
            self.left - reach <= x <= right + reach and self.top - reach <= y <= bottom + reach
        ):
            return None
        width, height = self.cell
        t = int(np.clip(np.floor((x - self.left) / width), 0, self.n_times - 1))
        a = int(np.clip(np.floor((bottom - y) / height), 0, self.n_angles - 1))
        return t, a
