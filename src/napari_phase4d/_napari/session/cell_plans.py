"""The plan that finds, follows and measures the cells of a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from napari_phase4d._napari.session.phase_plans import Plan
from napari_phase4d._napari.session.state import Changed, State
from napari_phase4d.analysis import (
    Cells,
    CellSettings,
    cells_in,
    copied_labels,
    find_cells,
    measure,
    most_trusted,
    region_with_cell,
    with_empty_field,
)
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import light_for
from napari_phase4d.stacks import AXES
from napari_phase4d.task import UNWATCHED, Task

__all__ = ["plan_cell_by_methods", "plan_cells", "with_their_cells"]


#: A mask of a frame, or of all frames.
Region: TypeAlias = "NDArray[np.bool_] | xr.DataArray"


def plan_cells(
    state: State,
    method: str | None = None,
    settings: CellSettings | None = None,
    labels: NDArray[np.integer] | None = None,
    *,
    optics: Optics | None = None,
) -> Plan:
    """Plan to find the cells of a result, follow them, and measure each of them.

    Parameters
    ----------
    state : State
        The session.
    method : str, optional
        Of which result; default: the most reliable one.
    settings : CellSettings, optional
        How; default: as the recipe says.
    labels : ndarray of int, optional
        Cells that are there already, dims (y, x), (time, y, x) or (time, angle, y, x); they are
        taken as they are, and only followed. Lazy ones are never in memory whole.
    optics : Optics, optional
        The microscope of phase that does not say it.

    Raises
    ------
    ValueError
        If there is no result yet, or the labels do not fit it.
    """
    comparison = state.needed_outcome().comparison
    method = method or most_trusted(comparison.results)
    result = comparison.results[method]
    how = settings or state.recipe.cells or CellSettings()
    used = light_for(state.recipe.optics, result, optics)
    given = None if labels is None else labels_like(result, labels)
    known, wrapped = state.confidence.get(method), state.needed_reconstruction()["phase"]

    def work(task: Task) -> Cells:
        # A copy: somebody may paint while the cells are followed.
        kept = given if given is None else given.copy(data=copied_labels(given))
        trust = known
        if trust is None:
            trust = comparison.known_confidence(method, **task.calls)
        return cells_in(
            result, used, how, method=method, wrapped=wrapped, labels=kept, confidence=trust,
            **task.calls,
        )  # fmt: skip

    def receive(cells: Cells) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not comparison.results:
            raise Changed
        state.update(cells=how)
        # A recipe, and a script, can only find them anew, in the result most to be trusted.
        again = given is None and method == most_trusted(comparison.results)
        noted = now.recipe.changed(cells=how if again else None)
        state.outcome = replace(now, cells=cells, recipe=noted)
        state.cells = cells
        state.cells_changed.emit()

    return Plan("Finding cells" if labels is None else "Following cells", work, receive)


def plan_cell_by_methods(
    state: State,
    cell: int,
    receive: Callable[[dict[str, pd.DataFrame]], None],
    *,
    optics: Optics | None = None,
) -> Plan:
    """Plan to measure one cell, as it was found, in the result of every method.

    Parameters
    ----------
    state : State
        The session.
    cell : int
        Its number.
    receive : callable
        ``receive(tables)`` is told a table for each method.
    optics : Optics, optional
        The microscope of phase that does not say it.

    Raises
    ------
    ValueError
        If no cells have been found yet.
    """
    comparison, cells = state.needed_outcome().comparison, state.cells
    if cells is None:
        msg = "there are no cells yet; press Find cells"
        raise ValueError(msg)
    how = state.recipe.cells or CellSettings()
    wrapped = state.needed_reconstruction()["phase"]
    known = dict(state.confidence)
    used = light_for(state.recipe.optics, wrapped, optics)

    def work(task: Task) -> dict[str, pd.DataFrame]:
        trust = {
            method: known[method]
            if method in known
            else comparison.known_confidence(method, **task.calls)
            for method in comparison.results
        }
        # With all cells, since the others are no empty field.
        tables = {
            method: measure(
                with_empty_field(result, wrapped), cells.labels,
                used,
                object_index=how.object_index,
                refraction_increment_ml_per_g=how.refraction_increment_ml_per_g,
                oblique=how.oblique, confidence=trust[method],
                **task.calls,
            )
            for method, result in comparison.results.items()
        }  # fmt: skip
        return {method: table[table["cell"] == cell] for method, table in tables.items()}

    def take(tables: dict[str, pd.DataFrame]) -> None:
        if state.cells is not cells:
            raise Changed
        receive(tables)

    return Plan("Measuring the cell", work, take)


def with_their_cells(
    result: xr.DataArray,
    regions: Mapping[str, NDArray[np.bool_]],
    frames: Mapping[str, tuple[int, int]],
    labels: xr.DataArray | None,
    settings: CellSettings | None = None,
    task: Task = UNWATCHED,
) -> tuple[dict[str, Region], str]:
    """Let regions go along with the cells that they were drawn on.

    Parameters
    ----------
    result : DataArray
        Unwrapped phase.
    regions : mapping of str to ndarray of bool, shape (y, x)
        The regions.
    frames : mapping of str to (int, int)
        The time and angle at which each was drawn.
    labels : DataArray, optional
        The cells, if they have been found already.
    settings : CellSettings, optional
        How they are found else.
    task : Task, optional
        Who is told of it, and may stop it.

    Returns
    -------
    moved : dict
        The regions (time, angle, y, x), lazy, or as they are where they lie on no cell.
    still : str
        Which these are and why, in a sentence; "" if there are none.
    """
    try:
        found = labels
        if found is None:
            how = (settings or CellSettings()).finding
            found = find_cells(result, **how, **task.calls)
    except (ImportError, OSError) as error:
        return dict(regions), f"The regions stand still: {error}."
    moved: dict[str, Region] = {}
    still = []
    for name, region in regions.items():
        try:
            moved[name] = region_with_cell(region, frames[name], found, **task.calls)
        except (KeyError, ValueError):  # on no cell, or nobody knows where it was drawn
            moved[name] = region
            still.append(name)
    if not still:
        return moved, ""
    return moved, f"There is no cell in {' and '.join(still)} where it was drawn: it stands still."


def labels_like(result: xr.DataArray, labels: NDArray[np.integer]) -> xr.DataArray:
    """Return labels on the grid of a result; those without angle or time hold at all of them."""
    wanted = result.shape[4 - labels.ndim :] if labels.ndim != 3 else (
        result.shape[0], *result.shape[2:]
    )  # fmt: skip
    if labels.ndim not in (2, 3, 4) or labels.shape != wanted:
        msg = (
            f"the labels are {labels.shape}, but the result is {result.shape}; they must have the "
            "same pixels, and the same times where they have times"
        )
        raise ValueError(msg)
    axes = {2: AXES[2:], 3: ("time", *AXES[2:]), 4: AXES}[labels.ndim]
    named = xr.DataArray(labels, dims=axes)
    if labels.ndim < 4:
        missing = {d: result.sizes[d] for d in AXES if d not in axes}
        named = named.expand_dims(missing).transpose(*AXES)
    return result.copy(data=named.data).drop_attrs()
