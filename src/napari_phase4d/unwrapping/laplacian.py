"""The Laplacian-based estimate (LBE), in four dimensions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.unwrapping.ends import ends_along
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.spatial import border_of

__all__ = ["laplacian"]

TURN = 2 * np.pi
#: Transforms of one estimate, for the progress.
STEPS = 6


def laplacian(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    variant: str = "textbook",
    rounded: bool = False,
) -> NDArray[np.float32]:
    """Estimate the phase from the Laplacian of its wrapped values.

    Textbook form (Schofield & Zhu 2003): u = L^-1[cos w L(sin w) - sin w L(cos w)], with L the
    second-difference operator over time, angle, y and x that has no flux across the borders; its
    eigenvalues in the cosine transform are the sums of 2 cos(pi k / n) - 2.

    The form of PhaseTools (Barnhill et al. 2015) divides inside each transform by
    K = sum of (k + 1)^2 over all axes, k counted in samples:
    u = D^-1[D(c D^-1(K D(s))) / K] - D^-1[D(s D^-1(K D(c))) / K].

    Parameters
    ----------
    problem : Problem
        Pixels outside the mask count as phase 0.
    progress, cancelled : callable or None
        See `unwrap`.
    variant : str, optional
        "textbook" (default) or "phasetools".
    rounded : bool, optional
        Whether to add to the wrapped phase the number of turns that comes nearest to the
        estimate. Default False: the raw estimate, which is not congruent with the wrapped phase.

    Returns
    -------
    ndarray of shape (time, angle, y, x)
        In radians. The estimate's constant is open; the border of the boundary frame is set to
        the wrapped phase there (0 outside the mask).
    """
    wrapped = np.where(problem.mask, problem.wrapped, np.float32(0))
    watch = Watch(STEPS, "Laplacian estimate", progress, cancelled)
    estimate = (textbook if variant == "textbook" else phasetools)(wrapped, watch)
    estimate += level(wrapped, estimate, problem.first)
    if rounded:
        turns = np.round((estimate - problem.wrapped) / TURN).astype(np.float32)
        estimate = problem.wrapped + np.float32(TURN) * turns
    watch.step()
    return np.where(problem.mask, estimate, 0).astype(np.float32)


def textbook(wrapped: NDArray[np.float32], watch: Watch) -> NDArray[np.float32]:
    """Solve the discrete Poisson equation with free borders."""
    cosine, sine = np.cos(wrapped), np.sin(wrapped)
    watch.step()
    source = cosine * second_difference(sine)
    watch.step()
    source -= sine * second_difference(cosine)
    watch.step()
    spectrum = scipy.fft.dctn(source, type=2, norm="ortho", overwrite_x=True, workers=-1)
    watch.step()
    eigenvalues = sum_over_axes(wrapped.shape, lambda n: 2 * np.cos(np.pi * np.arange(n) / n) - 2)
    eigenvalues.flat[0] = 1  # the mean of the phase is open
    spectrum /= eigenvalues
    spectrum.flat[0] = 0
    estimate: NDArray[np.float32] = scipy.fft.idctn(spectrum, type=2, norm="ortho", workers=-1)
    watch.step()
    return estimate


def phasetools(wrapped: NDArray[np.float32], watch: Watch) -> NDArray[np.float32]:
    """Return the estimate as PhaseTools computes it."""
    factor = sum_over_axes(wrapped.shape, lambda n: (np.arange(n) + 1.0) ** 2)
    cosine, sine = np.cos(wrapped), np.sin(wrapped)
    watch.step()

    def term(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
        inner = scipy.fft.idctn(factor * scipy.fft.dctn(b, norm="ortho"), norm="ortho")
        watch.step()
        outer: NDArray[np.float32] = scipy.fft.idctn(
            scipy.fft.dctn(a * inner, norm="ortho") / factor, norm="ortho"
        )
        watch.step()
        return outer

    return term(cosine, sine) - term(sine, cosine)


def second_difference(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return for each pixel the sum of the differences of its neighbours to it."""
    total = np.zeros_like(values)
    for axis in range(values.ndim):
        step = np.diff(values, axis=axis)
        head, tail = ends_along(axis, values.ndim)
        total[head] += step
        total[tail] -= step
    return total


def sum_over_axes(
    shape: tuple[int, ...], values: Callable[[int], NDArray[np.floating]]
) -> NDArray[np.float32]:
    """Return the sum of a function of each axis' indices, on the whole grid."""
    total = np.zeros(shape, dtype=np.float32)
    for axis, n in enumerate(shape):
        line = values(n)
        total += line.reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return total


def level(
    wrapped: NDArray[np.float32], estimate: NDArray[np.float32], first: tuple[int, int]
) -> float:
    """Return what is missing to the phase at the border of the boundary frame."""
    edge = border_of(estimate.shape[2:])
    return float(np.median(wrapped[first][edge]) - np.median(estimate[first][edge]))
