"""From one hologram frame to the complex field of every view, cut out by a window."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.words import shown

__all__ = [
    "WINDOWS",
    "Demodulator",
    "cut_of",
    "field_shape",
    "half_spectrum",
    "middle_of_first",
]

Window = Callable[[NDArray[np.float64]], NDArray[np.float64]]

#: Width of the smooth disk's edge (standard deviation) as a share of the radius.
EDGE = 0.05
#: Share of a Tukey window's radius that is tapered.
TAPER = 0.25


def disk(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 up to the radius, 0 beyond."""
    return (rho <= 1).astype(np.float64)


def smooth_disk(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a disk with a Gaussian-blurred edge, 1/2 at the radius."""
    soft: NDArray[np.float64] = 0.5 * scipy.special.erfc((rho - 1) / (EDGE * np.sqrt(2)))
    return np.where(rho < 1 + 4 * EDGE, soft, 0.0)


def gaussian(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a Gaussian with a standard deviation of half the radius, cut off at the radius."""
    return np.where(rho <= 1, np.exp(-2 * rho**2), 0.0)


def tukey(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 up to three quarters of the radius, then a cosine down to 0 at the radius."""
    along = np.clip((rho - (1 - TAPER)) / TAPER, 0, 1)
    taper: NDArray[np.float64] = 0.5 * (1 + np.cos(np.pi * along))
    return taper


#: Window name -> function of (distance from the carrier / radius).
WINDOWS: dict[str, Window] = {
    "disk": disk,
    "smooth-disk": smooth_disk,
    "gaussian": gaussian,
    "tukey": tukey,
}


def window_reach(name: str) -> float:
    """Return how far a window reaches, in radii."""
    return 1 + 4 * EDGE if name == "smooth-disk" else 1.0


#: The grey level is taken from every so manieth row and column.
LEVEL_STEP = 16
#: Rows transformed at a time; they and their transform stay in the cache of one core.
BLOCK_ROWS = 128

Indices = NDArray[np.intp]
Area = tuple[slice, slice]


@dataclass(frozen=True)
class Cut:
    """Where one lobe lies in the transformed columns, and what to do with it.

    ``pieces`` pair places in the lobe's block with places in the columns, and say whether these
    hold the conjugate. The block runs from the lowest frequency to the highest, and ``ramp`` makes
    up for its zero being in the middle. ``factors`` weigh the block by the window, and move the
    grid to the pixels' middles.
    """

    pieces: list[tuple[Area, Area, bool]]
    factors: NDArray[np.complex64]
    ramp: NDArray[np.complex64]
    flip: bool

    def field(self, spectrum: NDArray[np.complex64], out: NDArray[np.complex64]) -> None:
        """Write the lobe's field, of the block's shape, from the columns that were transformed."""
        block = np.empty_like(out)
        for place, source, mirrored in self.pieces:
            if mirrored:  # F(-k) = F(k)*
                np.conjugate(spectrum[source], out=block[place])
            else:
                block[place] = spectrum[source]
        block *= self.factors
        back = scipy.fft.ifft2(block, overwrite_x=True, norm="forward")
        np.multiply(back, self.ramp, out=out)
        if self.flip:
            np.conjugate(out, out=out)


class Demodulator:
    """Cuts all lobes out of one real Fourier transform of a frame.

    One transform in float32 serves all views, and along y only the columns that hold lobes are
    computed. Each lobe is cut out with its window, moved to zero frequency, and transformed back
    on a grid just large enough for it; the part of the carrier below one spectral pixel is taken
    off by a phase ramp. All views share one output grid, whose pixels cover the frame: each stands
    for its middle. Several threads may use one demodulator.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    lobes : sequence of Lobe
        The views.
    window : str, optional
        "disk", "smooth-disk" (default), "gaussian" or "tukey".

    Attributes
    ----------
    output_shape : tuple of int
        Height and width of the fields.
    pixel_ratio : tuple of float
        Height and width of an output pixel in camera pixels.

    Raises
    ------
    ValueError
        If there is no lobe, or the window has no such name.
    """

    def __init__(
        self, shape: tuple[int, ...], lobes: Sequence[Lobe], window: str = "smooth-disk"
    ) -> None:
        if not lobes:
            msg = "there is no lobe to demodulate; find or place at least one"
            raise ValueError(msg)
        if not isinstance(window, str) or window not in WINDOWS:
            msg = f"window must be one of {', '.join(WINDOWS)}, but is {shown(window)}"
            raise ValueError(msg)
        self.shape = (int(shape[0]), int(shape[1]))
        self.output_shape = field_shape(self.shape, lobes, window)
        self.pixel_ratio = (
            self.shape[0] / self.output_shape[0],
            self.shape[1] / self.output_shape[1],
        )
        blocks = [frequencies(lobe, self.shape, self.output_shape)[1] for lobe in lobes]
        held = [half_columns(columns, self.shape[1])[0] for columns in blocks]
        self._columns: Indices = np.unique(held)
        self._runs = runs(np.arange(len(self._columns)), self._columns)
        self._cuts = [
            cut_of(lobe, window, self.shape, self.output_shape, self._columns) for lobe in lobes
        ]

    def __call__(self, frame: NDArray[np.generic]) -> NDArray[np.complex64]:
        """Return the fields of all views.

        Parameters
        ----------
        frame : ndarray of shape (y, x)
            Grey values of any real type; it is best to leave integers as they are.

        Returns
        -------
        ndarray of shape (view, y, x)
            complex64.
        """
        if frame.shape != self.shape:
            msg = f"the frame is {frame.shape} pixels, but the lobes are set for {self.shape}"
            raise ValueError(msg)
        spectrum = transformed_columns(frame, self._runs)
        if self._columns[0] == 0:
            spectrum[0, 0] = 0  # the mean grey value is no part of any fringes
        fields = np.empty((len(self._cuts), *self.output_shape), dtype=np.complex64)
        for field, cut in zip(fields, self._cuts, strict=True):
            cut.field(spectrum, field)
        return fields


def middle_of_first(ratio: float) -> float:
    """Return where the first pixel that is so many camera pixels wide has its middle.

    The transform takes a frame as going on round its edges, where fringes don't fit together. A
    grid that began at the first camera pixel would have all of its first row and column there.

    Examples
    --------
    >>> middle_of_first(1.0), middle_of_first(4.0)  # half a camera pixel is outside
    (0.0, 1.5)
    """
    return (ratio - 1) / 2


def field_shape(
    shape: tuple[int, int], lobes: Sequence[Lobe], window: str = "smooth-disk"
) -> tuple[int, int]:
    """Return the height and width of the grid that all lobes' fields share.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    lobes : sequence of Lobe
        The views, at least one.
    window : str, optional
        As in `Demodulator`.
    """
    reach = max(lobe.radius for lobe in lobes) * window_reach(window)
    return grid_length(reach, shape[0]), grid_length(reach, shape[1])


def frequencies(
    lobe: Lobe, shape: tuple[int, int], field: tuple[int, int]
) -> tuple[Indices, Indices]:
    """Return the rows and columns of the full spectrum that a lobe's block holds."""
    rows, columns = (
        (round(k * n) + np.arange(m) - m // 2) % n
        for k, n, m in zip(lobe.carrier, shape, field, strict=True)
    )
    return rows, columns


def cut_of(
    lobe: Lobe, window: str, shape: tuple[int, int], field: tuple[int, int], held: Indices
) -> Cut:
    """Prepare what cuts one lobe out of some columns of the half plane kx >= 0.

    Parameters
    ----------
    lobe : Lobe
        The view.
    window : str
        As in `Demodulator`.
    shape, field : tuple of int
        Height and width of the frames, and of the fields.
    held : ndarray of shape (column,)
        Which columns there are, ascending.
    """
    offsets, ramps, moves = [], [], []
    for k, n, m in zip(lobe.carrier, shape, field, strict=True):
        centre = round(k * n)
        offsets.append((centre + np.arange(m) - m // 2) / n - k)
        moves.append(np.exp(2j * np.pi * offsets[-1] * middle_of_first(n / m)))
        turns = (k - centre / n) * (n / m) + (m // 2) / m
        ramps.append(np.exp(-2j * np.pi * turns * np.arange(m)) / n)
    rows, columns = frequencies(lobe, shape, field)
    sources, mirrored = half_columns(columns, shape[1])
    rho = np.hypot(offsets[0][:, None], offsets[1][None, :]) / lobe.radius
    factors = (WINDOWS[window](rho) * np.outer(*moves)).astype(np.complex64)
    pieces = []
    for side in (False, True):
        across = np.flatnonzero(mirrored == side)
        for x, from_x in runs(across, np.searchsorted(held, sources[across])):
            opposite = -rows % shape[0] if side else rows
            for y, from_y in runs(np.arange(len(rows)), opposite):
                pieces.append(((y, x), (from_y, from_x), side))
    ramp = np.outer(*(each.astype(np.complex64) for each in ramps))
    return Cut(pieces, factors, ramp, lobe.flip)


def half_spectrum(frame: NDArray[np.generic]) -> NDArray[np.complex64]:
    """Return the Fourier transform of a frame on the half plane kx >= 0, less its grey level.

    Parameters
    ----------
    frame : ndarray of shape (y, x)
        Grey values of any real type; it is best to leave integers as they are.

    Returns
    -------
    ndarray of shape (y, x // 2 + 1)
        complex64, in the order of `scipy.fft.rfft2`. Only its value at zero frequency depends on
        which level was taken off.
    """
    every = slice(0, frame.shape[1] // 2 + 1)
    return transformed_columns(frame, [(every, every)])


def transformed_columns(
    frame: NDArray[np.generic], copies: list[tuple[slice, slice]]
) -> NDArray[np.complex64]:
    """Return some columns of the transform of a frame, less its grey level.

    Each pair of slices says where columns go, and which of the half plane kx >= 0 they are.
    """
    height, width = frame.shape
    kept = np.empty((height, copies[-1][0].stop), dtype=np.complex64)
    buffer = np.empty((min(BLOCK_ROWS, height), width), dtype=np.float32)
    # Next to a large mean, single precision would lose weak fringes.
    level = np.float32(frame[::LEVEL_STEP, ::LEVEL_STEP].mean(dtype=np.float64))
    for top in range(0, height, BLOCK_ROWS):
        rows = slice(top, min(top + BLOCK_ROWS, height))
        grey = buffer[: rows.stop - top]
        np.subtract(frame[rows], level, out=grey, dtype=np.float32, casting="unsafe")
        half = scipy.fft.rfft(grey, axis=1, overwrite_x=True)
        for place, source in copies:
            kept[rows, place] = half[:, source]
    spectrum: NDArray[np.complex64] = scipy.fft.fft(kept, axis=0, overwrite_x=True)
    return spectrum


def half_columns(columns: Indices, width: int) -> tuple[Indices, NDArray[np.bool_]]:
    """Return which columns of the half spectrum kx >= 0 to read, and which of them mirrored."""
    mirrored = columns > width // 2
    return np.where(mirrored, width - columns, columns), mirrored


def runs(places: Indices, sources: Indices) -> list[tuple[slice, slice]]:
    """Return pairs of slices that copy what is at ``sources`` to the ascending ``places``."""
    if not len(places):
        return []
    breaks = np.flatnonzero((np.diff(places) != 1) | (np.abs(np.diff(sources)) != 1)) + 1
    pairs = zip(np.split(places, breaks), np.split(sources, breaks), strict=True)
    return [(as_slice(place), as_slice(source)) for place, source in pairs]


def as_slice(run: Indices) -> slice:
    """Return the slice of a run of neighbours, in either direction."""
    first, last = int(run[0]), int(run[-1])
    if first <= last:
        return slice(first, last + 1)
    return slice(first, last - 1 if last else None, -1)


def grid_length(reach: float, n: int) -> int:
    """Return the shortest quickly transformed length that holds +-reach of n frequencies."""
    needed = 2 * math.ceil(reach * n) + 2
    return min(int(scipy.fft.next_fast_len(needed)), n)
