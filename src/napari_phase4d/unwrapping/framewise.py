"""Methods for a stack out of functions that unwrap one frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.spatial import border_medians, border_values

__all__ = ["frame_by_frame"]

TURN = 2 * np.pi

#: Takes wrapped phase (y, x), the pixels to unwrap, and options; returns unwrapped phase.
OnFrame = Callable[..., ArrayLike]
OnStack = Callable[..., NDArray[np.float32]]


def frame_by_frame(unwrap_frame: OnFrame) -> OnStack:
    """Return the ``function`` of a `Method` that unwraps every frame by itself.

    Frames are worked on in several threads, progress is told and cancelling is heeded after each.
    The whole turns that a frame leaves open are chosen as for the method "spatial-2d": the border
    of the boundary frame lies within half a turn of zero, and the border moves by less than half
    a turn from frame to frame and from view to view.

    Parameters
    ----------
    unwrap_frame : callable
        ``unwrap_frame(wrapped, mask, **options)``: gets wrapped phase (y, x) in radians, float32,
        and the pixels to unwrap, bool; returns unwrapped phase (y, x) in radians. Both arrays are
        its own to change. It may be called from several threads at a time.

    Returns
    -------
    callable
        ``function(problem, progress, cancelled, **options)``.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_phase4d.unwrapping import Method, frame_by_frame
    >>> method = Method(
    ...     label="Itoh",
    ...     source="Itoh 1982, Appl. Opt. 21, 2470",
    ...     summary="Along each row.",
    ...     function=frame_by_frame(lambda wrapped, mask: np.unwrap(wrapped, axis=1)),
    ... )
    """

    def on_stack(
        problem: Problem,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        **options: Any,
    ) -> NDArray[np.float32]:
        task = Task(progress, cancelled)
        wrapped, mask = problem.wrapped, problem.mask
        unwrapped = np.zeros_like(wrapped)
        border = np.zeros(wrapped.shape[:2])

        def work(index: tuple[int, ...]) -> None:
            found = unwrap_frame(wrapped[index].copy(), mask[index].copy(), **options)
            unwrapped[index] = as_frame(found, mask[index])
            border[index] = np.median(border_values(unwrapped[index]))

        watch = Watch(problem.n_frames, "unwrapping frame by frame", task)
        for _ in in_threads(work, list(np.ndindex(*wrapped.shape[:2])), watch):
            pass
        turns = np.round((border_medians(border, problem.first) - border) / TURN)
        unwrapped += (TURN * turns).astype(np.float32)[..., None, None]
        unwrapped[~mask] = 0
        return unwrapped

    return on_stack


def as_frame(values: ArrayLike, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return what a function gave for a frame, or say what is wrong with it."""
    frame = np.array(values)
    if frame.shape != mask.shape or frame.dtype.kind not in "fiu":
        msg = f"a frame {mask.shape} came back as {frame.dtype} {frame.shape}"
        raise ValueError(msg)
    bad = ~np.isfinite(frame)
    if (bad & mask).any():
        msg = "a frame came back with NaN or infinite pixels"
        raise ValueError(msg)
    frame[bad] = 0
    return frame.astype(np.float32)
