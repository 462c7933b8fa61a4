"""What the session can do with a recording: open it, see its spectrum, find its views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import xarray as xr

from napari_phase4d._napari.session.opening import Opened, open_anything
from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import State
from napari_phase4d.holography import (
    FoundLobes,
    Lobe,
    find_lobes,
    lost_frames,
    lost_sentence,
    pair_distance,
    power_spectrum,
)
from napari_phase4d.io import RawLayout
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.recording import Recording

__all__ = ["plan_lobes", "plan_opening", "plan_spectrum"]

#: Frames averaged for the spectrum on screen.
SPECTRUM_FRAMES = 32
#: Frames that lost ones are looked for among.
LOST_FRAMES = 200


def plan_opening(
    state: State,
    source: object,
    content: str = "auto",
    title: str = "",
    raw: RawLayout | None = None,
) -> Plan:
    """Plan to open a file, folder, recipe or sample, see `open_anything`."""

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> Opened:
        return open_anything(source, content, raw)

    return Plan(title or "Opening", work, state.take, cancellable=False)


def plan_lobes(state: State) -> Plan:
    """Plan to find the lobes."""
    recording, recipe = state.needed_recording(), state.recipe
    angles = recipe.angles_deg
    if angles is not None and len(angles) != recipe.n_views:
        angles = None

    def work(
        progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> tuple[xr.DataArray, str, FoundLobes | ValueError]:
        spectrum, lost = looked_at(recording, progress, cancelled)
        try:
            found = found_lobes(recording, recipe.n_views, angles, progress, cancelled)
        except ValueError as error:
            # The spectrum is needed all the more, to place the lobes by hand.
            return spectrum, lost, error
        return spectrum, lost, found

    def receive(found: tuple[xr.DataArray, str, FoundLobes | ValueError]) -> None:
        state.check_is(recording)
        state.spectrum, state.lost, lobes = found
        state.spectrum_changed.emit()
        if isinstance(lobes, ValueError):
            raise lobes
        if len(lobes) < state.recipe.n_views:
            state.update(n_views=len(lobes), angles_deg=None)
        state.found = lobes
        state.set_lobes(with_known_views(lobes, recipe.lobes))

    return Plan("Finding the lobes", work, receive)


def looked_at(
    recording: Recording, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> tuple[xr.DataArray, str]:
    """Return the spectrum of a recording, and which frames the camera lost in a sentence."""
    spectrum = power_spectrum(
        recording, max_frames=SPECTRUM_FRAMES, progress=progress, cancelled=cancelled
    )
    number = min(recording.n_frames, LOST_FRAMES)
    lost = lost_frames(recording, number, progress=progress, cancelled=cancelled)
    return spectrum, lost_sentence(lost, number)


def found_lobes(
    recording: Recording,
    n_views: int,
    angles_deg: Sequence[float] | None,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> FoundLobes:
    """Return so many lobes, or as many as there are where there are fewer."""
    try:
        return find_lobes(
            recording, n_views, angles_deg=angles_deg, progress=progress, cancelled=cancelled
        )
    except ValueError as error:
        try:
            fewer = find_lobes(recording, None, progress=progress, cancelled=cancelled)
        except ValueError:
            raise error from None
        if not len(fewer) < n_views:
            raise
        return fewer


def plan_spectrum(state: State) -> Plan:
    """Plan to compute the spectrum alone, until something else is asked for."""
    recording = state.needed_recording()

    def work(
        progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> tuple[xr.DataArray, str]:
        return looked_at(recording, progress, cancelled)

    def receive(found: tuple[xr.DataArray, str]) -> None:
        # Another microscope leaves the frames, and so their spectrum, as they are.
        now = state.recording
        if now is not None and now.holograms.data is recording.holograms.data:
            state.spectrum, state.lost = found
            state.spectrum_changed.emit()

    return Plan("Computing the spectrum", work, receive, gives_way=True)


def with_known_views(found: Sequence[Lobe], known: Sequence[Lobe]) -> list[Lobe]:
    """Return lobes with the angle and sign that the user gave to the same views before."""
    if len(found) != len(known):
        return list(found)
    kept = []
    for lobe in found:
        nearest = min(known, key=lambda k: pair_distance(k.carrier, lobe.carrier))
        same = pair_distance(nearest.carrier, lobe.carrier) < lobe.radius
        known_view = replace(lobe, angle_deg=nearest.angle_deg, flip=nearest.flip)
        kept.append(known_view if same else lobe)
    return kept
