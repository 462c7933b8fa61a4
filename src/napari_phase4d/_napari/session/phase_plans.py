"""Long work as a plan, and the plans from a recording to phase: open, find views, reconstruct."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from queue import Empty
from typing import Any, Protocol

from napari_phase4d._napari.session.history import StepNumber
from napari_phase4d._napari.session.opening import Opened, TruthCall, open_anything
from napari_phase4d._napari.session.state import State
from napari_phase4d.analysis import noise_figures
from napari_phase4d.holography import (
    Focus,
    FoundLobes,
    Lobe,
    find_lobes,
    lost_frames,
    lost_sentence,
    pair_distance,
    power_spectrum,
)
from napari_phase4d.holography.lobes import wrapped_distance
from napari_phase4d.io import RawLayout
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline import find_place, focus_by, needs_of, reconstruct_by
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.unwrapping import METHODS

__all__ = [
    "Plan",
    "plan_focus",
    "plan_lobes",
    "plan_noise",
    "plan_opening",
    "plan_reconstruction",
    "plan_spectrum",
    "with_known_views",
]


class Parts(Protocol):
    """Where work puts what it has finished on the way."""

    def get_nowait(self) -> Any:
        """Return the next part; raise `queue.Empty` if there is none."""


@dataclass(frozen=True)
class Plan:
    """Work on a snapshot of the session, so that the user can go on while it runs.

    Parameters
    ----------
    title : str
        What the user sees.
    work : callable
        ``work(task)``; touches nothing but its own snapshot.
    receive : callable
        Takes the result into the session; to be called in the window's thread. It refuses a
        result for what has changed since. Where there is much to show it does so in steps, and
        returns them.
    cancellable : bool
        Whether the work looks at whether it is to stop; if not, its result is just not waited for.
    gives_way : bool
        Whether it runs unseen and ends as soon as other work is started.
    keeps_parts : bool
        Whether the work, when cancelled, returns what is finished instead of raising Cancelled.
    parts : SimpleQueue, or another that has get_nowait, optional
        Where the work puts what it has finished on the way; who runs it in a thread hands each to
        ``receive_part`` in the window's thread, at the latest before the whole is received.
    receive_part : callable, optional
        Takes one of them into the session.
    step : StepNumber
        Where it is said what the work warned of.
    """

    title: str
    work: Callable[[Task], Any]
    receive: Callable[[Any], Iterator[None] | None]
    cancellable: bool = True
    gives_way: bool = False
    keeps_parts: bool = False
    parts: Parts | None = None
    receive_part: Callable[[Any], None] | None = None
    step: StepNumber = StepNumber.COMPARE

    def next_part(self) -> bool:
        """Take one finished part into the session; return whether there was one."""
        if self.parts is None or self.receive_part is None:
            return False
        try:
            part = self.parts.get_nowait()
        except Empty:
            return False
        self.receive_part(part)
        return True

    def run(self) -> None:
        """Do the work here and now."""
        for _ in self.receive(self.work(UNWATCHED)) or ():
            pass


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

    def work(task: Task) -> Opened:
        opened = open_anything(source, content, raw)
        if not isinstance(opened.content, Recording):
            # What is wrong with phase is said here, where another file can be opened.
            wrapped_stack(opened.content)
        return opened

    return Plan(title or "Opening", work, state.take, cancellable=False, step=StepNumber.RECORDING)


def plan_lobes(state: State) -> Plan:
    """Plan to find the lobes."""
    recording, recipe = state.needed_recording(), state.recipe
    n_views = recipe.wanted_views
    angles, light = (
        None if known is None or len(known) != n_views else known
        for known in (recipe.angles_deg, recipe.wavelengths_um)
    )

    def work(task: Task) -> tuple[xr.DataArray, str, FoundLobes | ValueError]:
        spectrum, lost = looked_at(recording, task)
        try:
            found = found_lobes(recording, n_views, angles, light, task)
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
        if n_views is not None and len(lobes) < n_views:
            state.update(n_views=None, angles_deg=None)
        state.found = lobes
        state.set_lobes(with_known_views(lobes, recipe.lobes))

    return Plan("Finding the lobes", work, receive, step=StepNumber.LOBES)


def looked_at(recording: Recording, task: Task) -> tuple[xr.DataArray, str]:
    """Return the spectrum of a recording, and which frames the camera lost in a sentence."""
    spectrum = power_spectrum(recording, max_frames=SPECTRUM_FRAMES, **task.calls)
    number = min(recording.n_frames, LOST_FRAMES)
    lost = lost_frames(recording, number, **task.calls)
    return spectrum, lost_sentence(lost, number)


def found_lobes(
    recording: Recording,
    n_views: int | None,
    angles_deg: Sequence[float] | None,
    wavelengths_um: Sequence[float] | None,
    task: Task,
) -> FoundLobes:
    """Return so many lobes, or as many as there are where there are fewer."""
    try:
        return find_lobes(
            recording,
            n_views,
            angles_deg=angles_deg,
            wavelengths_um=wavelengths_um,
            **task.calls,
        )
    except ValueError as error:
        try:
            fewer = find_lobes(recording, None, **task.calls)
        except ValueError:
            raise error from None
        if n_views is None or not len(fewer) < n_views:
            raise
        return fewer


def plan_spectrum(state: State) -> Plan:
    """Plan to compute the spectrum alone, until something else is asked for."""
    recording = state.needed_recording()

    def work(task: Task) -> tuple[xr.DataArray, str]:
        return looked_at(recording, task)

    def receive(found: tuple[xr.DataArray, str]) -> None:
        # Another microscope leaves the frames, and so their spectrum, as they are.
        now = state.recording
        if now is not None and now.holograms.data is recording.holograms.data:
            state.spectrum, state.lost = found
            state.spectrum_changed.emit()

    return Plan("Computing the spectrum", work, receive, gives_way=True, step=StepNumber.LOBES)


def with_known_views(found: Sequence[Lobe], known: Sequence[Lobe]) -> list[Lobe]:
    """Return lobes with what the user told of the same views before: angle, sign, wavelength."""
    if len(found) != len(known):
        return list(found)
    kept = []
    for lobe in found:
        nearest = min(known, key=lambda k: pair_distance(k.carrier, lobe.carrier))
        pair = nearest.carrier, lobe.carrier
        same = pair_distance(*pair) < lobe.radius
        # The sign belongs to one of the pair of lobes, and the other one may have been found.
        is_other = pair_distance(*pair) < wrapped_distance(*pair)
        known_view = replace(
            lobe,
            angle_deg=nearest.angle_deg,
            flip=nearest.flip != is_other,
            wavelength_um=nearest.wavelength_um,
        )
        kept.append(known_view if same else lobe)
    return kept


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

    def work(task: Task) -> tuple[xr.Dataset, xr.DataArray | None]:
        data = reconstruct_by(recipe, recording, lobes, **task.calls, place=place)
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

    return Plan("Reconstructing", work, receive, step=StepNumber.PHASE)


def plan_focus(state: State) -> Plan:
    """Plan to find the distance at which the object is sharp.

    Raises
    ------
    ValueError
        If there is no recording or no lobe yet.
    """
    recording, recipe = state.needed_recording(), state.recipe
    lobes = state.needed_lobes()

    def work(task: Task) -> Focus:
        return focus_by(recipe, recording, lobes, **task.calls)

    def receive(focus: Focus) -> None:
        state.check_is(recording)
        state.focus = focus
        state.update(refocus_um=round(focus.distance_um, 2))

    return Plan("Looking for the focus", work, receive, step=StepNumber.PHASE)


def plan_noise(state: State) -> Plan:
    """Plan to measure how noisy the phase is, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data = state.needed_reconstruction()

    def work(task: Task) -> pd.DataFrame:
        return noise_figures(data, **task.calls)

    def receive(noise: pd.DataFrame) -> None:
        state.check_phase(data)
        state.noise = noise
        state.noise_changed.emit()

    return Plan("Measuring the noise", work, receive, gives_way=True, step=StepNumber.PHASE)


def known_truth(truth_for: TruthCall | None, phase: xr.DataArray) -> xr.DataArray | None:
    """Return the exact phase on the grid of wrapped phase, or None where it is not known."""
    if truth_for is None:
        return None
    try:
        return truth_for(phase).assign_attrs(pixel_ratio=phase.attrs["pixel_ratio"])
    except ValueError:  # such as other viewing angles than those that it is known for
        return None
