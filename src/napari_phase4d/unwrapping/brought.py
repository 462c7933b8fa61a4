"""Methods that other packages bring: functions of a frame or of a whole problem, made safe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.stack import InMemory
from napari_phase4d.task import (
    UNWATCHED,
    Cancelled,
    CancelledCall,
    ProgressCall,
    Task,
    Watch,
    in_threads,
)
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.frames import border_values, lift_of, median_and_field
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registry import METHODS

__all__ = ["LentProblem", "frame_by_frame", "of_a_package"]

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
        border = np.zeros((*wrapped.shape[:2], 2))

        def work(index: tuple[int, ...]) -> None:
            found = unwrap_frame(wrapped[index].copy(), mask[index].copy(), **options)
            unwrapped[index] = as_frame(found, mask[index])
            border[index] = median_and_field(border_values(unwrapped[index]))

        watch = Watch(problem.n_frames, "unwrapping frame by frame", task)
        for _ in in_threads(work, list(np.ndindex(*wrapped.shape[:2])), watch):
            pass
        unwrapped += (TURN * lift_of(border, problem.first)).astype(np.float32)[..., None, None]
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


def of_a_package(
    problem: Problem, method: str, task: Task, options: Mapping[str, Any]
) -> NDArray[np.float32]:
    """Run a method that a package brought: it may fail in any way, and writes into nothing.

    Raises
    ------
    ValueError
        If it fails, or gives back anything but a number for every pixel of the mask.
    """
    facts = METHODS[method]
    try:
        lent = LentProblem(problem)
        values = np.asarray(facts.function(lent, task.progress, task.cancelled, **options))
    except Cancelled:
        raise
    except Exception as error:
        why = " ".join(str(error).split()) or type(error).__name__
        msg = f"{facts.label} of the package {facts.package} failed: {why}"
        raise ValueError(msg) from error
    # A mask that it had no need of must not depend on what other methods have found.
    inside = problem.usable if facts.finds_object else problem.mask
    right = values.shape == problem.wrapped.shape and values.dtype.kind in "fiu"
    if not right or not np.isfinite(values[inside]).all():
        msg = (
            f"{facts.label} of the package {facts.package} gave {values.dtype} {values.shape}; it "
            f"must give a finite number for every pixel of {problem.wrapped.shape}"
        )
        raise ValueError(msg)
    return np.where(inside, values, 0).astype(np.float32)


class LentProblem(Problem):
    """A view of a problem whose arrays can't be written into.

    What is written there would reach all methods that run later, and the array of the caller.

    Parameters
    ----------
    owner : Problem
        What is computed once is computed there, so that other methods have it too.
    """

    def __init__(self, owner: Problem) -> None:
        vars(self).update(vars(owner))
        self._owner = owner
        self.boundaries = list(owner.boundaries)
        self.wrapped = read_only(owner.wrapped)
        self.usable = read_only(owner.usable)
        self._given = None  # the owner's may be written to
        if isinstance(owner.template.data, np.ndarray):
            self.template = owner.template.copy(data=read_only(owner.template.data))

    @property
    def amplitude(self) -> NDArray[np.float32] | None:
        """Amplitude of all frames as a share of its view's median, or None."""
        owner = self._owner
        share = owner.once("amplitude", lambda: owner.amplitude)
        return None if share is None else read_only(share)

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels to unwrap."""
        return read_only(self._owner.mask)

    def spatial(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.float32]:
        """Return all frames unwrapped one by one."""
        return read_only(self._owner.spatial(progress, cancelled))

    def shifts(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.intp]:
        """Return the shifts that register all frames, shape (time, angle, 2)."""
        return read_only(self._owner.shifts(progress, cancelled))

    def background(self, task: Task = UNWATCHED) -> Background:
        """Return the empty field of every frame, and its level."""
        found = self._owner.background(task)
        empty = InMemory(read_only(found.mask))
        return replace(found, empty=empty, level=read_only(found.level))


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return a view of an array that can't be written into."""
    view = values.view()
    view.flags.writeable = False
    return view
