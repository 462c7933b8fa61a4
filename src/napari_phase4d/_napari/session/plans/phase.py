"""What the session can do from lobes to phase."""

from __future__ import annotations

import pandas as pd
import xarray as xr

from napari_phase4d._napari.session.opening import TruthCall
from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import State
from napari_phase4d.analysis import noise_figures
from napari_phase4d.holography import Focus
from napari_phase4d.pipeline import (
    find_place,
    focus_by,
    needs_of,
    reconstruct_by,
)
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import METHODS

__all__ = ["plan_focus", "plan_noise", "plan_reconstruction"]


def plan_reconstruction(state: State) -> Plan:
    """Plan to reconstruct wrapped phase and amplitude.

    Raises
    ------
    ValueError
        If there is no recording or no lobe yet.
    """
    recording, recipe = state.needed_recording(), state.recipe
    truth_for = state.truth_for
    lobes = state.needed_lobes()
    # Methods that need all frames at once can still be left out, and the start be named.
    few = [m for m in recipe.methods if METHODS[m].streams]
    modest = recipe.changed(methods=few, boundary=((0, 0),))
    place = find_place(recipe, needs_of(modest, recording, lobes))

    def work(
        progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> tuple[xr.Dataset, xr.DataArray | None]:
        data = reconstruct_by(recipe, recording, lobes, progress, cancelled, place=place)
        return data, known_truth(truth_for, data["phase"])

    def receive(found: tuple[xr.Dataset, xr.DataArray | None]) -> None:
        state.check_is(recording)
        state.leave_place(place)
        data, state.known_truth = found
        state.truth = state.known_truth
        # "auto" has become a number of micrometres.
        used = recipe.changed(refocus_um=data.attrs.get("refocus_um"))
        if state.recipe.refocus_um == recipe.refocus_um:
            state.update(refocus_um=used.refocus_um)
        state.set_reconstruction(data, used)

    return Plan("Reconstructing", work, receive)


def plan_focus(state: State) -> Plan:
    """Plan to find the distance at which the object is sharp.

    Raises
    ------
    ValueError
        If there is no recording or no lobe yet.
    """
    recording, recipe = state.needed_recording(), state.recipe
    lobes = state.needed_lobes()

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> Focus:
        return focus_by(recipe, recording, lobes, progress, cancelled)

    def receive(focus: Focus) -> None:
        state.check_is(recording)
        state.focus = focus
        state.update(refocus_um=round(focus.distance_um, 2))

    return Plan("Looking for the focus", work, receive)


def plan_noise(state: State) -> Plan:
    """Plan to measure how noisy the phase is, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data = state.needed_reconstruction()

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> pd.DataFrame:
        return noise_figures(data, progress, cancelled)

    def receive(noise: pd.DataFrame) -> None:
        state.check_phase(data)
        state.noise = noise
        state.noise_changed.emit()

    return Plan("Measuring the noise", work, receive, gives_way=True)


def known_truth(truth_for: TruthCall | None, phase: xr.DataArray) -> xr.DataArray | None:
    """Return the exact phase on the grid of wrapped phase, or None where it is not known."""
    if truth_for is None:
        return None
    try:
        return truth_for(phase).assign_attrs(pixel_ratio=phase.attrs["pixel_ratio"])
    except ValueError:  # such as other viewing angles than those that it is known for
        return None
