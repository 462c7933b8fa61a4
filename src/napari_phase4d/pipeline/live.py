"""Phase while one records: from a recording that grows to the result of a run, frame by frame."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_tracks import check_follower
from napari_phase4d.holography.lobes import lobe_doubts, with_wavelengths
from napari_phase4d.holography.reconstruction import FEW_LOST
from napari_phase4d.io import Arrival, Arriving, FromCamera, arriving_at
from napari_phase4d.later import xr
from napari_phase4d.machine import cores
from napari_phase4d.optics import Optics, with_typed_numbers
from napari_phase4d.pipeline.feed import (
    FIRST_FRAMES,
    Feed,
    Listener,
    LiveStatus,
    Settled,
    check_live,
    recording_at_the_end,
    settle,
    stacked,
)
from napari_phase4d.pipeline.folder import checked_form, write_files
from napari_phase4d.pipeline.guarding import result_folder
from napari_phase4d.pipeline.places import Place, stacks_beside
from napari_phase4d.pipeline.provenance import Fingerprint, fingerprint
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome, advice_on, cells_by
from napari_phase4d.pipeline.starting import found_anywhere
from napari_phase4d.pipeline.stored import GrowingStack, Shelf
from napari_phase4d.recording import Recording
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Threads, Watch, in_threads
from napari_phase4d.unwrapping import METHODS, Causal, causal_methods, noted
from napari_phase4d.unwrapping.objects import left_out_note
from napari_phase4d.words import as_path, check_call, check_type, counted, shown

__all__ = ["shown_method", "watch"]

#: Seconds without a new frame after which a recording is taken as complete.
PATIENCE_S = 30.0
#: Seconds for which a frame is waited for that was announced.
FRAME_PATIENCE_S = 5.0
#: The same of a camera, whose files are whole, and in order.
DROPPED_S = 0.5
#: So often it is said of a view that its fringes are gone, or back: a beam may flicker.
MOST_TOLD = 10
#: Methods whose phase is told, the first that is run.
SHOWN = ("temporal-angular", "angular-temporal", "temporal", "angular", "spatial-2d")

#: A frame's phase (angle, y, x) by each method, with what it was made of: "wrapped", "amplitude".
Results = Mapping[str, NDArray[np.float32]]


def watch(
    source: str | Path | FromCamera,
    recipe: Recipe,
    out: str | Path,
    *,
    frames: int | None = None,
    patience_s: float = PATIENCE_S,
    frame_patience_s: float = FRAME_PATIENCE_S,
    form: str | None = None,
    begun: Callable[[xr.DataArray], None] | None = None,
    arrived: Callable[[int, Results], None] | None = None,
    told: Callable[[str], None] | None = None,
    status: Callable[[LiveStatus], None] | None = None,
    progress: ProgressCall | None = None,
    stopped: CancelledCall | None = None,
    cancelled: CancelledCall | None = None,
    optics_numbers: Mapping[str, float] | None = None,
) -> Outcome:
    """Work on a recording while it is written, and write its results when it is complete.

    Lobes, background and the view to start from are found on the first frames. From then on the
    phase of each frame is there as soon as it has come, by the methods that need the past only
    (`napari_phase4d.unwrapping.CAUSAL`); those along time do not start anew where the object gets
    thin again (``split`` is False). All other methods, WL1 among them, are run once, at the end.
    What is written is that of a run with the recipe that is written too: of the finished recording
    it gives the same numbers, to the last bit.

    Parameters
    ----------
    source : str, Path or FromCamera
        A folder into which images are written, one a frame; a TIFF to which pages are appended;
        or a Zarr array that grows along its time. It need not be there yet. Or a camera, which is
        started, and whose frames are written into its folder; it ends when the camera does.
    recipe : Recipe
        All settings; its recording does not count. Boundary "auto" is the safest view of the
        first frame.
    out : str or Path
        Folder for the results.
    frames : int, optional
        End after so many frames. Default: as many as come.
    patience_s : float, optional
        End after so many seconds without anything new. Default 30.
    frame_patience_s : float, optional
        Give up a frame after so many seconds that was announced, by its own file or by a later
        one, and is not whole. It is NaN in all results. Default 5.
    form : str, optional
        "tiff" or "zarr" (default).
    begun : callable, optional
        ``begun(like)`` once, before the first frame is told: a stack (time, angle, y, x) of one
        frame, whose axes and notes are those of all that are told; its values do not count.
    arrived : callable, optional
        ``arrived(index, results)`` after each frame, in the thread that called: "wrapped",
        "amplitude" and the id of each method that needs the past only, with its phase
        (angle, y, x).
    told : callable, optional
        ``told(line)``: what is to be known of single frames, such as one that never came.
    status : callable, optional
        ``status(LiveStatus)`` once a second: how far it is.
    progress : callable, optional
        ``progress(done, total, message)`` of what is done at the end.
    stopped : callable, optional
        If it returns True, no more frames are waited for; the results are written.
    cancelled : callable, optional
        If it returns True, all is given up, and nothing is written.
    optics_numbers : mapping of str to float, optional
        Fields of `Optics` that hold, as they are typed in. The others are those of the recipe's
        microscope or the paper's, but a pixel that the file names stays, unless camera pixel and
        magnification are both given.

    Returns
    -------
    Outcome
        As `run` gives it; its stacks lie in the folder, and its recipe names all that was found.

    Raises
    ------
    OSError, TypeError, ValueError
        If no frame came, a setting does not fit, or the folder can't be written.
    Cancelled
        If ``cancelled()`` returned True.

    Warns
    -----
    UserWarning
        Where ``told`` is not given: of what is probably wrong with the phase, as `run` does; and
        if another recording is begun in the place of the one that is watched, which ends it, or
        frames are removed or written over after they were read. With ``told`` this is told.

    See Also
    --------
    run : The same of a recording that is complete.

    Examples
    --------
    >>> from pathlib import Path
    >>> import tifffile
    >>> import napari_phase4d as p4d
    >>> from napari_phase4d.pipeline import watch
    >>> exact = p4d.simulation.swimming_euglena((64, 64), 4, pixel_um=0.7)
    >>> video = p4d.simulation.multiplexed_video(exact["phase"])
    >>> Path("camera").mkdir()
    >>> for number, frame in enumerate(video.holograms.values):
    ...     tifffile.imwrite(f"camera/frame_{number:04}.tif", frame)
    >>> lobes = p4d.find_lobes(video, 2)
    >>> recipe = p4d.Recipe(lobes=tuple(lobes), methods=("temporal-angular",))
    >>> found = watch("camera", recipe, "results", frames=4)
    >>> found.comparison.results["temporal-angular"].sizes["time"]
    4
    """
    check_type("recipe", recipe, Recipe, "give Recipe(...), or Recipe.from_file(path)")
    for name, call in (("begun", begun), ("arrived", arrived), ("told", told), ("status", status)):
        check_call(name, call)
    check_limits(frames, patience_s, frame_patience_s)
    check_live(recipe)
    numbers = dict(optics_numbers or {})
    # What no microscope has is refused before one waits for frames.
    with_typed_numbers(recipe.optics or Optics(), numbers, None)
    checked_form(form)
    if recipe.cells is not None:
        check_follower()
    camera = source if isinstance(source, FromCamera) else None
    path = as_path(source if camera is None else camera.folder).expanduser()
    out = as_path(out)
    if out.resolve() == path.resolve():
        msg = f"{out} is what is watched; choose another folder for the results"
        raise ValueError(msg)
    if camera is None:
        arriving = arriving_at(path, frame_patience_s, recipe.dataset)
    else:
        stopped = until_ended(camera, stopped)
        arriving = arriving_at(path, DROPPED_S, whole=True)
    listener = Listener(told, status, stopped, Task(None, cancelled))
    feed = Feed(arriving, frames, patience_s, listener)
    recipe = recipe.changed(recording=found_anywhere(path))
    with (
        result_folder(out, recipe) as kept,
        stacks_beside(out, form) as where,
        nullcontext() if camera is None else camera,
    ):
        place = Place(Shelf(where), Threads())
        try:
            n_first = recipe.first_frames or FIRST_FRAMES
            gathered = feed.gather(n_first)
            unseen = Task(None, cancelled)
            settled = settle(recipe, arriving, gathered[:n_first], unseen, numbers)
            listener.tell(found_sentence(settled))
            light = settled.first.optics.wavelength_um
            for doubt in lobe_doubts(with_wavelengths(settled.recipe.lobes, light)):
                listener.insist(doubt)
            live = Live(settled, arriving, place.shelf, listener, arrived, unseen)
            if begun is not None:
                begun(live.like())
            live.follow(gathered, feed)
            listener.line()
            if camera is not None:
                finish(camera, listener)
            outcome = live.outcome(place, Task(progress))
            for advice in advice_on(outcome, FEW_LOST, of_lobes=False):
                listener.insist(advice)
            print_of = fingerprint_of(arriving, listener, Task(None, cancelled))
            outcome = with_notes(outcome, listener.notes)
            written = write_files(outcome, out, Task(progress), form=form, source=print_of)
            kept.settle(written, outcome.recipe.recording, print_of)
        finally:
            arriving.close()
            place.close()
    return outcome


def shown_method(methods: Iterable[str]) -> str:
    """Return which of several is told and shown of a recording that grows.

    Parameters
    ----------
    methods : iterable of str
        Ids of methods; others, as "amplitude", do not count.

    Returns
    -------
    str
        The id of the one that needs the past only and goes furthest; "wrapped" if there is none.

    See Also
    --------
    watch : Tells the results of all of them.

    Examples
    --------
    >>> from napari_phase4d.pipeline import shown_method
    >>> shown_method(["wrapped", "amplitude", "spatial-2d", "temporal-angular"])
    'temporal-angular'
    """
    there = set(methods)
    return next((method for method in SHOWN if method in there), "wrapped")


def until_ended(camera: FromCamera, stopped: CancelledCall | None) -> CancelledCall:
    """Return what says that no more frames come; a camera is stopped where that is wished."""

    def ended() -> bool:
        if stopped is not None and stopped():
            camera.stop()
        return camera.ended

    return ended


def finish(camera: FromCamera, listener: Listener) -> None:
    """Stop a camera, and say what it lost."""
    camera.finish()
    if camera.dropped:
        listener.tell(
            f"the camera took {counted(camera.dropped, 'frame')} that its buffer had no room for"
        )


def check_limits(frames: int | None, patience_s: float, frame_patience_s: float) -> None:
    """Refuse numbers of frames and seconds that can't be meant."""
    if frames is not None and (not isinstance(frames, int) or frames < 1):
        msg = f"frames must be a number of frames, 1 or more, but is {shown(frames)}"
        raise ValueError(msg)
    for name, seconds in (("patience_s", patience_s), ("frame_patience_s", frame_patience_s)):
        if not seconds > 0:
            msg = f"{name} must be a number of seconds above 0, but is {shown(seconds)}"
            raise ValueError(msg)


def found_sentence(settled: Settled) -> str:
    """Say what was found on the first frames."""
    n_views, (_, view) = len(settled.recipe.lobes), settled.recipe.start_frames[0]
    first = counted(settled.first.n_frames, "frame")
    start = view % n_views + 1  # the last ones may be counted from the end
    return f"found on the first {first}: {counted(n_views, 'view')}; start at view {start}"


def with_notes(outcome: Outcome, notes: Sequence[str]) -> Outcome:
    """Return an outcome whose recording notes what happened to it."""
    recording = outcome.recording
    assert recording is not None  # it was watched
    return replace(outcome, recording=replace(recording, notes=(*recording.notes, *notes)))


def gone_sentence(name: str, n_frames: int) -> str:
    """Say that the results are of frames that are not there any more."""
    were, they = ("was", "it was") if n_frames == 1 else ("were", "they were")
    return (
        f"{counted(n_frames, 'frame')} of {name} {were} removed or written over since {they} "
        "read: the results are of what came, and a run of what lies there gives others"
    )


def fingerprint_of(arriving: Arriving, listener: Listener, task: Task) -> Fingerprint:
    """Return what tells the recording from others; its name alone if it is another by now."""
    told = set(arriving.gone)
    with suppress(OSError):
        found = fingerprint(arriving.path, cancelled=task.cancelled)
        if not arriving.look_back(task):
            return found
    if arriving.gone - told:
        listener.note(gone_sentence(arriving.path.name, len(arriving.gone)))
    return Fingerprint(arriving.path.name)


class Fringes:
    """Says when the fringes of a view are gone, while a blocked beam can still be mended.

    Parameters
    ----------
    n_views : int
        Views of every frame.
    """

    def __init__(self, n_views: int) -> None:
        self._gone: frozenset[int] = frozenset()
        self._every = frozenset(range(n_views))
        self._told = Counter[int]()

    def changed(self, phase: NDArray[np.float32]) -> str:
        """Say what is other than before in the next frame (angle, y, x); "" if nothing is."""
        gone = frozenset(np.flatnonzero(np.isnan(phase).all(axis=(1, 2))).tolist())
        self._told.update(gone ^ self._gone)
        told = frozenset(view for view in self._every if self._told[view] <= MOST_TOLD)
        last = frozenset(view for view in gone ^ self._gone if self._told[view] == MOST_TOLD)
        changes = (
            ((gone - self._gone) & told, "gone or weak"),
            ((self._gone - gone) & told, "back"),
        )
        said = [
            f"the fringes of {self._views(views)} are {what}" for views, what in changes if views
        ]
        if last:
            said.append(f"and so on: of {self._views(last)} no more is said")
        self._gone = gone
        return ", ".join(said)

    def _views(self, views: frozenset[int]) -> str:
        if views == self._every:
            return "all views" if len(views) > 1 else "the view"
        numbers = " and ".join(str(view + 1) for view in sorted(views))
        return f"view{'s' if len(views) > 1 else ''} {numbers}"


class Live:
    """The work on frames that come.

    Parameters
    ----------
    settled : Settled
        What no later frame changes.
    arriving : Arriving
        What they come from.
    shelf : Shelf
        Where the stacks grow.
    listener : Listener
        Who is told how far it is.
    arrived : callable or None
        See `watch`.
    task : Task
        Who may stop it.
    """

    def __init__(
        self,
        settled: Settled,
        arriving: Arriving,
        shelf: Shelf,
        listener: Listener,
        arrived: Callable[[int, Results], None] | None,
        task: Task,
    ) -> None:
        self._settled, self._arriving = settled, arriving
        self._shelf, self._listener = shelf, listener
        self._arrived, self._cancelled = arrived, task.cancelled
        recipe = settled.recipe
        # Phases of several wavelengths can't be held against each other as they are.
        one_light = settled.work.light is None
        chosen = causal_methods(recipe.methods if one_light else (), recipe.options)
        n_views = len(settled.work.angles)
        boundaries = [(time, angle % n_views) for time, angle in recipe.start_frames]
        self._causal = Causal(chosen, boundaries, finds_mask=recipe.mask == "auto")
        self._shown = shown_method(chosen)
        shape = settled.work.stack_shape(1)[1:]
        names = ("wrapped", "amplitude", *chosen)
        self._stacks: dict[str, GrowingStack] = {n: shelf.growing(n, shape) for n in names}
        self._shares: list[tuple[float, ...]] = []
        self._fringes = Fringes(n_views)

    def like(self) -> xr.DataArray:
        """Return a frame of phase whose axes and notes are those of all; no values."""
        first = self._settled.first
        shares = [(0.0,) * len(self._settled.work.angles)] * first.n_frames
        return self._axes(first, shares)["phase"].isel(time=[0])

    def follow(self, gathered: Sequence[Arrival], feed: Feed) -> None:
        """Work on the frames that are there, and on all that come."""
        at_once = 2 * cores()
        for start in range(0, len(gathered), at_once):
            self._more(gathered[start : start + at_once])
        for batch in feed.batches(at_once):
            self._more(batch)

    def _more(self, arrivals: Sequence[Arrival]) -> None:
        """Work on the next frames."""
        phase, amplitude, shares = self._reconstructed(arrivals)
        found = {
            "wrapped": phase,
            "amplitude": amplitude,
            **self._causal.more(phase, self._cancelled),
        }
        for name, values in found.items():
            self._stacks[name].add(values)
        self._shares += shares
        shown = found[self._shown]
        known = shown[np.isfinite(shown)]
        late = time.monotonic() - arrivals[-1].since
        now = replace(self._listener.now, done=len(self._shares), delay_s=late)
        if known.size:
            now = replace(now, low=float(known.min()), high=float(known.max()))
        self._listener.now = now
        if self._arrived is not None:
            for values in found.values():
                values.flags.writeable = False  # they wait to be written
            for place, arrival in enumerate(arrivals):
                self._arrived(arrival.index, {n: values[place] for n, values in found.items()})
        self._listener.heed(self._arriving)
        for arrival, frame in zip(arrivals, phase, strict=True):
            if arrival.frame is not None and (said := self._fringes.changed(frame)):
                self._listener.tell(f"frame {self._arriving.label(arrival.index)}: {said}")

    def _reconstructed(
        self, arrivals: Sequence[Arrival]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], list[tuple[float, ...]]]:
        """Return phase and amplitude (time, angle, y, x), NaN where a frame is lost."""
        work = self._settled.work
        frames = Recording.from_frames(stacked(arrivals, self._arriving))
        phase = np.empty(work.stack_shape(len(arrivals)), dtype=np.float32)
        amplitude = np.empty_like(phase)

        def into_place(index: int) -> tuple[float, ...]:
            return work.read(frames, index, phase[index], amplitude[index])

        if len(arrivals) == 1:
            return phase, amplitude, [into_place(0)]
        counting = Watch(len(arrivals), "reconstruct", Task(None, self._cancelled))
        shares = list(in_threads(into_place, range(len(arrivals)), counting, wait=True))
        return phase, amplitude, shares

    # ---- at the end ----

    def outcome(self, place: Place, task: Task) -> Outcome:
        """Give all stacks their names, and run the methods that look at all frames."""
        recipe = self._settled.recipe
        if gone := self._arriving.look_back(Task(task.progress, self._cancelled)):
            self._listener.note(gone_sentence(self._arriving.path.name, len(gone)))
        recording = recording_at_the_end(self._settled, self._arriving)
        data = self._dataset(recording)
        results = {method: self._result(method, data["phase"]) for method in self._causal.methods}
        late = tuple(m for m in recipe.methods if m not in results)
        if late:
            labels = ", ".join(METHODS[m].label for m in late)
            self._listener.tell(f"all frames are there; unwrapping by {labels}")
        comparison = place.unwrap(
            recipe.changed(methods=late),
            data["phase"],
            data["amplitude"],
            None,
            Task(task.progress, self._cancelled),
        )
        comparison = comparison.with_results(results, self._causal.seconds, recipe.methods)
        following = Task(task.progress, self._cancelled)
        cells = cells_by(recipe, comparison, data["phase"], following)
        return Outcome(recording, recipe, data, comparison, cells=cells)

    def _dataset(self, recording: Recording) -> xr.Dataset:
        """Return phase and amplitude as they lie, with their axes and notes."""
        plan = self._axes(recording, self._shares)
        plan["phase"] = self._put("wrapped", plan["phase"], (-math.pi, math.pi))
        plan["amplitude"] = self._put("amplitude", plan["amplitude"])
        return plan

    def _axes(self, recording: Recording, shares: Sequence[Sequence[float]]) -> xr.Dataset:
        """Return phase and amplitude whose axes and notes alone count."""
        import dask.array as da  # which takes a tenth of a second

        work = self._settled.work
        shape = work.stack_shape(len(shares))
        empty = da.broadcast_to(da.zeros(1, dtype=np.float32), shape)
        return work.as_dataset(recording, empty, empty, shares)

    def _result(self, method: str, phase: xr.DataArray) -> xr.DataArray:
        """Return what a method gave as it lies, noted as `run_method` does."""
        causal, options = self._causal, self._settled.recipe.options.get(method, {})
        mask = "auto" if causal.finds_mask else "none" if causal.all_usable else "given"
        attrs = noted(method, options, causal.boundaries, mask=mask, amplitude=True)
        attrs |= left_out_note(causal.smooth_left_out)
        result = phase.copy(deep=False).rename(method)
        result.attrs = {**phase.attrs, "units": "rad", **attrs}
        return self._put(method, result)

    def _put(
        self, name: str, stack: xr.DataArray, limits: tuple[float, float] | None = None
    ) -> xr.DataArray:
        """Give a stack that is complete its name."""
        grown = self._stacks[name]
        grown.finished()
        return self._shelf.put(name, stack, limits or grown.limits or (0.0, 0.0))
