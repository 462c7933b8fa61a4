"""How the session can measure regions of a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import Changed, State
from napari_phase4d.analysis import Comparison, measure, most_trusted
from napari_phase4d.optics import REFRACTION_INCREMENT_ML_PER_G, Optics
from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["Masks", "plan_measuring"]

#: Regions by name, as masks (y, x), (time, y, x) or (time, angle, y, x).
Masks = Mapping[str, NDArray[np.bool_]]


def plan_measuring(
    state: State,
    method: str | None = None,
    regions: Masks | Callable[[], Masks] | None = None,
    *,
    optics: Optics | None = None,
    object_index: float | None = None,
    refraction_increment_ml_per_g: float = REFRACTION_INCREMENT_ML_PER_G,
) -> Plan:
    """Plan to measure regions of a result over time.

    Parameters
    ----------
    state : State
        The session.
    method : str, optional
        Of which result; default: the most reliable one.
    regions : mapping of str to ndarray, or callable that returns one, optional
        Masks by name; default: the whole object.
    optics : Optics, optional
        The microscope of phase that does not say it.
    object_index : float, optional
        Refractive index of the object, for height and volume.
    refraction_increment_ml_per_g : float, optional
        How much a gram of dry matter in a millilitre raises the refractive index.

    Raises
    ------
    ValueError
        If there is no result yet.
    """
    comparison = state.needed_outcome().comparison
    result = comparison.results[method or most_trusted(comparison.results)]
    used = optics_of(state, result, optics or Optics())
    noted = {"refraction increment (mL/g)": refraction_increment_ml_per_g}
    if object_index is not None:
        noted["object index"] = object_index

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> pd.DataFrame:
        if regions is None:
            masks: Masks = {"object": object_in(comparison, result)}
        else:
            masks = regions() if callable(regions) else regions
        measured = measure(
            result,
            masks,
            used,
            object_index=object_index,
            refraction_increment_ml_per_g=refraction_increment_ml_per_g,
            progress=progress,
            cancelled=cancelled,
        )
        return measured.assign(**noted)

    def receive(measured: pd.DataFrame) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not comparison.results:
            raise Changed
        state.measured = measured
        state.measured_changed.emit()

    return Plan("Measuring", work, receive)


def optics_of(state: State, result: xr.DataArray, own: Optics) -> Optics:
    """Return the microscope; of phase that does not say it, the user's own."""
    if state.recipe.optics is not None:
        return state.recipe.optics
    noted = result.attrs.get("wavelength_um", own.wavelength_um)
    return replace(own, wavelength_um=float(noted))


def object_in(comparison: Comparison, result: xr.DataArray) -> Any:
    """Return the mask of the object: of results on disk, what they were unwrapped in.

    Raises
    ------
    ValueError
        If results on disk were unwrapped in the whole field.
    """
    if comparison.problem is not None:
        return comparison.object_mask().values.astype(bool)
    if result.attrs.get("mask") == "auto":
        return result.data != 0
    msg = "the object was not looked for in this recording; draw a region to measure"
    raise ValueError(msg)
