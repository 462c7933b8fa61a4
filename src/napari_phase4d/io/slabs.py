"""Stacks that are written some frames at a time, since all of one may not fit into memory."""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.io.atomic import UnreadableError
from napari_phase4d.progress import THREADS, CancelledCall, ProgressCall, Watch

__all__ = ["slabs"]

#: Bytes that are computed at a time, unless one chunk of the stack is larger.
SLAB_BYTES = 16 * 2**20


def slabs(
    stack: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Generator[tuple[slice, NDArray[Any]], None, None]:
    """Yield the times of each part of a stack and its values, in the order of the times.

    While one part is written, the next one is computed. Close it where it may not come to its end.

    Raises
    ------
    UnreadableError
        If what a lazy stack is computed from can't be read.
    Cancelled
        If ``cancelled()`` returned True.
    """
    parts = parts_of(stack)
    watch = Watch(len(parts), "saving", progress, cancelled)
    watch.check()
    pool = ThreadPoolExecutor(1, THREADS)
    try:
        coming = pool.submit(values_of, stack, parts[0])
        for this, following in zip(parts, [*parts[1:], None], strict=True):
            values = coming.result()
            if following is not None:
                coming = pool.submit(values_of, stack, following)
            yield this, values
            watch.step()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def values_of(stack: xr.DataArray, part: slice) -> NDArray[Any]:
    """Return the values at some times, computed if they are not there yet."""
    try:
        return np.ascontiguousarray(stack.data[part])
    except OSError as error:
        raise UnreadableError(*error.args) from error


def parts_of(stack: xr.DataArray) -> list[slice]:
    """Cut a stack's times into parts; the chunks of a lazy one are never cut."""
    n_times = stack.sizes["time"]
    chunks = stack.chunksizes.get("time", (1,) * n_times)
    frame = max(stack.nbytes // n_times, 1)
    ends, start, end = [0], 0, 0
    for length in chunks:
        if end > start and (end + length - start) * frame > SLAB_BYTES:
            ends.append(end)
            start = end
        end += length
    ends.append(end)
    return [slice(a, b) for a, b in pairwise(ends)]
