"""Stacks larger than memory, as napari looks at them: one frame at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.recording import one_frame

__all__ = ["OnDemand", "frames_of", "is_lazy", "lazy_of", "shown"]


class OnDemand:
    """Frames (time, angle, y, x) that are read when they are looked at.

    A dask array of many frames takes a tenth of a second for each one that is shown, most of it
    for its graph; this goes straight to the file.

    Parameters
    ----------
    lazy : dask array
        (time, angle, y, x); or (time, y, x), which is then shown at every angle.
    n_angles : int, optional
        Number of angles that frames without an angle are shown at.
    """

    ndim = 4

    def __init__(self, lazy: Any, n_angles: int = 1) -> None:
        self._lazy = lazy
        times, *rest = lazy.shape
        self.shape = (times, *rest) if lazy.ndim == self.ndim else (times, n_angles, *rest)
        self.dtype = np.dtype(lazy.dtype)
        self._last: tuple[int, NDArray[Any]] | None = None

    def __getitem__(self, key: Any) -> NDArray[Any]:
        """Return numbers by whole numbers and slices, as of an array."""
        key = key if isinstance(key, tuple) else (key,)
        if len(key) < 2 or not all(isinstance(i, int | np.integer) for i in key[:2]):
            return np.asarray(self.as_dask()[key])
        frames = self._at(int(key[0]))
        frame = frames[int(key[1])] if self._lazy.ndim == self.ndim else frames
        return np.asarray(frame[key[2:]])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return everything at once."""
        return np.asarray(self.as_dask(), dtype=dtype)

    def spread(self, n_angles: int) -> OnDemand:
        """Return frames without an angle, shown at so many."""
        return OnDemand(self._lazy, n_angles)

    def as_dask(self) -> Any:
        """Return the stack as a dask array (time, angle, y, x)."""
        import dask.array as da

        if self._lazy.ndim == self.ndim:
            return self._lazy
        return da.broadcast_to(self._lazy[:, None], self.shape)

    @property
    def frames(self) -> Any:
        """What was given, or its first angle: (time, y, x)."""
        return self._lazy if self._lazy.ndim < self.ndim else self._lazy[:, 0]

    def _at(self, time: int) -> NDArray[Any]:
        """Return what the file holds of one time; the last one is kept."""
        last = self._last
        if last is None or last[0] != time:
            last = self._last = (time, np.asarray(one_frame(self._lazy, time)))
        return last[1]


def is_lazy(data: Any) -> bool:
    """Say whether numbers are not in memory yet."""
    return isinstance(data, OnDemand) or hasattr(data, "dask")


def shown(data: Any) -> Any:
    """Return what napari is given to look at: arrays as they are, lazy ones on demand."""
    return OnDemand(data) if hasattr(data, "dask") else data


def lazy_of(data: Any) -> Any:
    """Return the array of a layer of ours, NumPy or dask."""
    return data.as_dask() if isinstance(data, OnDemand) else data


def frames_of(data: Any) -> Any:
    """Return camera frames (time, y, x) from a layer that shows them at every angle."""
    return data.frames if isinstance(data, OnDemand) else data[:, 0]
