"""What of a comparison a picture or movie shows."""

from __future__ import annotations

import xarray as xr

from napari_phase4d.evaluation.comparison import Comparison

__all__ = ["EXACT", "named_results", "telling_frames"]

#: Name under which the truth is shown.
EXACT = "exact"


def named_results(
    comparison: Comparison, truth: xr.DataArray | None = None
) -> dict[str, xr.DataArray]:
    """Return the truth, where it is known, and every result by the name of its method."""
    labels = comparison.table["method"]
    named = {str(labels[method]): result for method, result in comparison.results.items()}
    return named if truth is None else {EXACT: truth, **named}


def telling_frames(
    phase: xr.DataArray, boundary: tuple[int, int], also: tuple[int, int] | None = None
) -> list[tuple[int, int]]:
    """Return frames worth a picture: the thin one, half way, and the last from both ends.

    Parameters
    ----------
    phase : xarray.DataArray
        Any of the stacks, dims (time, angle, y, x).
    boundary : tuple of int
        The optically thin frame (time, angle); negative numbers count from the end.
    also : tuple of int, optional
        One more frame, such as the one on screen, instead of the one half way.
    """
    last, far = phase.sizes["time"] - 1, phase.sizes["angle"] - 1
    t, a = boundary
    frames = [(t % (last + 1), a % (far + 1)), also or (last // 2, 0), (last, 0), (last, far)]
    return list(dict.fromkeys(frames))
