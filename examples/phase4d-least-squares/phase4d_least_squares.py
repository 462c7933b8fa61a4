"""Least-squares phase unwrapping, frame by frame: a method of one's own in one file."""

from __future__ import annotations

import numpy as np
from scipy.fft import dctn, idctn

from napari_phase4d.unwrapping import Method, Option, frame_by_frame


def least_squares(wrapped: np.ndarray, mask: np.ndarray, *, congruent: bool = True) -> np.ndarray:
    """Return the phase whose steps come nearest to the wrapped steps, in least squares.

    Ghiglia & Romero 1994, J. Opt. Soc. Am. A 11, 107: the Poisson equation of the wrapped steps,
    solved by cosine transforms. Pixels off the mask count as flat.

    Parameters
    ----------
    wrapped : ndarray of shape (y, x)
        Wrapped phase in radians.
    mask : ndarray of bool, same shape
        Pixels to unwrap.
    congruent : bool, optional
        Whether to add whole turns to the wrapped phase, those that come nearest. Default True.
    """
    divergence = np.zeros(wrapped.shape)
    for axis in (0, 1):
        steps = np.angle(np.exp(1j * np.diff(wrapped, axis=axis)))
        inside = np.delete(mask, 0, axis) & np.delete(mask, -1, axis)
        flow = np.insert(steps * inside, 0, 0, axis)
        divergence += np.diff(flow, axis=axis, append=0)
    y, x = (2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in wrapped.shape)
    eigenvalues = y[:, None] + x
    eigenvalues[0, 0] = 1  # the mean is open
    phase = idctn(dctn(divergence, norm="ortho") / eigenvalues, norm="ortho")
    phase += np.angle(np.exp(1j * (wrapped - phase))[mask].mean()) if mask.any() else 0
    if not congruent:
        return phase
    return wrapped + 2 * np.pi * np.round((phase - wrapped) / (2 * np.pi))


METHOD = Method(
    label="LSQ",
    source="Ghiglia & Romero 1994, J. Opt. Soc. Am. A 11, 107",
    summary="Each frame by itself, its steps met in least squares.",
    function=frame_by_frame(least_squares),
    options=(
        Option("congruent", True, "Add whole turns to the wrapped phase, the nearest to it."),
    ),
)
