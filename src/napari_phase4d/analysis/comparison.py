"""Several methods run on one problem, their results side by side, and what each of them cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

from numpy.typing import ArrayLike

from napari_phase4d.analysis.balance import MISSING_MASS
from napari_phase4d.analysis.confidence import (
    REFERENCE,
    chances_of_right,
    judged_of,
    reference_of,
    trust_map,
)
from napari_phase4d.analysis.differences import OF_TRUTH, as_truth, errors, in_order, table_of
from napari_phase4d.analysis.objects import object_of, read_when_needed
from napari_phase4d.analysis.slips import Tally, slip_words, tally_of
from napari_phase4d.analysis.verdict import Verdict, counting_turns, verdict_on
from napari_phase4d.later import pd, xr
from napari_phase4d.machine import Measured, measured
from napari_phase4d.stack import Block, stack_of
from napari_phase4d.stacks import wavelengths_of, without_masked, wrapped_stack
from napari_phase4d.stacks.coordinates import scaled_like
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.unwrapping import (
    METHODS,
    Problem,
    check_method,
    label_of,
    methods_for,
    options_by_id,
    run_method,
    settle_plateaus,
    shown_field,
)
from napari_phase4d.unwrapping.running import as_methods
from napari_phase4d.words import check_call, shown

__all__ = ["Comparison", "compare", "compare_on"]

T = TypeVar("T")

#: Name of the share of the object that is in doubt in directional L1, where that was not run.
OF_REFERENCE = "tally of the reference"


@dataclass(frozen=True, repr=False)
class Comparison:
    """Results of several methods on one problem.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of each method.
    table : pandas.DataFrame
        One row a method: its label, seconds, peak memory in MB; the share of the object's pixels
        that are doubtful in percent, where asked for with `with_doubt`; and against truth,
        where given, the mean squared error in rad^2 and the share of pixels wrong by a turn in
        percent.
    problem : Problem
        What was unwrapped, in memory or on disk.
    phase : DataArray
        The wrapped phase.
    """

    results: Mapping[str, xr.DataArray]
    table: pd.DataFrame
    problem: Problem
    phase: xr.DataArray

    def __repr__(self) -> str:
        sizes = ", ".join(f"{name} {size}" for name, size in self.phase.sizes.items())
        return f"<Comparison of {len(self.results)} methods on {sizes}>\n{self.table}"

    @property
    def held(self) -> bool:
        """Whether all of it is held in memory."""
        return self.problem.held

    def reference(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.DataArray:
        """Return the result of directional L1, computed now if it was not among the methods."""
        task = Task(progress, cancelled)
        if REFERENCE in self.results:
            return self.results[REFERENCE]
        try:
            return scaled_like(reference_of(self.problem, task), self.phase)
        finally:
            self.problem.forget_field()

    def confidence(
        self,
        method: str,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> xr.DataArray:
        """Return the chance, from 0 to 1, that each pixel of a method's result is right.

        See `napari_phase4d.confidence`. The first call may unwrap by directional L1, which the
        others are held against. Where results lie on disk, so do these maps.

        Raises
        ------
        TypeError, ValueError
            If there is no result of such a method; id and label are both taken for it.
        """
        (found,) = self.confidences([method], progress, cancelled).values()
        return found

    def known_confidence(
        self,
        method: str,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> xr.DataArray | None:
        """Return `confidence` of a method; of results on disk, None unless it is known already."""
        known = self.held or self.knows_confidence(method)
        return self.confidence(method, progress, cancelled) if known else None

    def knows_confidence(self, method: str) -> bool:
        """Say whether `confidence` of a method has been computed."""
        return self.problem.knows(map_name(self._run(method)))

    def _run(self, method: str) -> str:
        """Return the id of a method that was run, or of the one that all are held against."""
        known = isinstance(method, str) and method in self.results
        found = method if known else check_method(method, {})
        if found not in self.results and found != REFERENCE:
            there = ", ".join(map(str, self.results)) or "none"
            msg = f"there is no result of {shown(method)}; there are those of: {there}"
            raise ValueError(msg)
        return found

    def confidences(
        self,
        methods: Sequence[str] | None = None,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> dict[str, xr.DataArray]:
        """Return `confidence` of several methods by their ids, by default all; each once.

        All at once take less time than one by one.
        """
        task = Task(progress, cancelled)
        wanted = list(self.results) if methods is None else [self._run(m) for m in methods]
        if not all(self.problem.knows(map_name(m)) for m in wanted):
            self._judge(wanted, task)
        return {m: self._known_map(m) for m in wanted}

    def _known_map(self, method: str) -> xr.DataArray:
        """Return the map of confidence of a method, with the times and places of the phase."""
        known: xr.DataArray = self.problem.known(map_name(method))
        placed = scaled_like(known, self.phase)
        if placed is not known:  # made before `on_grid_of`; kept, to be the same when asked again
            self.problem.note(map_name(method), placed)
        return placed

    def _judge(self, methods: Sequence[str], task: Task = UNWATCHED) -> None:
        """Make maps of confidence of methods, one thread at a time: it ends with tidying up.

        Of directional L1, if it was not run, no more is kept than how much of it is in doubt: the
        verdict needs no more, and what lies on disk would have to be read once more for it.
        """
        with self.problem.locks.together:
            missing = [m for m in methods if not self.problem.knows(map_name(m))]
            own = REFERENCE not in self.results and not self.problem.knows(OF_REFERENCE)
            if missing or own:
                try:
                    self._make_maps(missing, task, own=own)
                finally:
                    self.problem.forget_field()
                    self.problem.tidy()

    def _make_maps(self, methods: Sequence[str], task: Task, *, own: bool) -> None:
        """Make maps of confidence of methods, or find out how much of directional L1 is in doubt.

        Parameters
        ----------
        methods : sequence of str
            Ids of the methods.
        task : Task
            Who is told of it, and may stop it.
        own : bool
            Whether nothing is known of directional L1 yet, which was not run.
        """
        problem = self.problem
        reference = self.results.get(REFERENCE)
        if reference is None and self.held:
            reference = self.reference(**task.calls)
        results = {m: self.results.get(m) for m in methods}
        if own and not (self.held and methods):
            results[REFERENCE] = reference
        found = chances_of_right(problem, results, reference, task)
        for method in methods:
            trust = trust_map(problem, found[method], method, method)
            problem.once(map_name(method), partial(identity, trust))
        if REFERENCE in found and REFERENCE not in self.results:
            tally = tally_of(problem, {}, {REFERENCE: found[REFERENCE]}, task.quiet)
            problem.once(OF_REFERENCE, lambda: tally.doubtful_share(REFERENCE))

    def tally(
        self,
        maps: Mapping[str, xr.DataArray] | None = None,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> Tally:
        """Count what is in doubt in each frame's object, and on how much of it results differ.

        Parameters
        ----------
        maps : mapping of str to DataArray, optional
            What `confidence` gave for methods; default all of them.
        progress, cancelled : callable, optional
            ``progress(done, total, message)``; ``cancelled()`` stops the work.
        """
        task = Task(progress, cancelled)
        counted = self.confidences(**task.calls) if maps is None else dict(maps)
        known = self._known_tally(counted)
        return self._count(counted, task) if known is None else known

    def _known_tally(self, counted: dict[str, xr.DataArray]) -> Tally | None:
        """Return the tally of maps if these, of the same results, were counted last."""
        name = tally_name(counted)
        if not self.problem.knows(name):
            return None
        maps, results, found = self.problem.known(name)
        now = dict(counting_turns(self.results))
        return found if same(maps, counted) and same(results, now) else None

    def _count(self, counted: dict[str, xr.DataArray], task: Task) -> Tally:
        """Count what is in doubt, one thread at a time: it ends with tidying up."""
        problem, results = self.problem, dict(counting_turns(self.results))
        with problem.locks.together:
            if (known := self._known_tally(counted)) is not None:
                return known
            maps_on = {method: stack_of(trust) for method, trust in counted.items()}
            found = tally_of(problem, results, maps_on, task)
            problem.note(tally_name(counted), (counted, results, found))
            problem.tidy()
        return found

    def warnings(self) -> dict[str, str]:
        """Say of which methods whole objects may be a cycle off, and in how many frames.

        Of directional L1, whose mass is added up, also in how many of these an object misses mass.
        """
        slipped, problem = self.tally().slipped, self.problem
        missing = problem.known(MISSING_MASS) if problem.knows(MISSING_MASS) else None
        said = {
            method: slip_words(slipped[method], missing if method == REFERENCE else None)
            for method in self.results
        }
        return {method: sentence for method, sentence in said.items() if sentence}

    @property
    def verdict(self) -> Verdict:
        """One sentence: which result to use, how much is in doubt, where methods disagree most.

        It also holds what it says as numbers, see `Verdict`. When first asked for, `confidences`
        are computed.

        Raises
        ------
        ValueError
            If there is no result.
        """
        if not self.results:
            msg = "there is no result yet to give a verdict on; run at least one method"
            raise ValueError(msg)
        labels = {str(m): str(self.table["method"][m]) for m in self.results}
        tally, own = self.tally(), None
        if REFERENCE not in self.results:
            if not self.problem.knows(OF_REFERENCE):
                self._judge([])
            own = self.problem.known(OF_REFERENCE)
        return verdict_on(self.problem, self.results, tally, labels, self.phase, own)

    def against(self, truth: xr.DataArray | Any) -> Comparison:
        """Return the same results, with the columns of the table that need truth for this one.

        Nothing is unwrapped again.

        Parameters
        ----------
        truth : DataArray, array_like or None
            Exact phase in radians, of the shape of the phase; None removes these columns.

        Raises
        ------
        ValueError
            If the truth has another shape.
        """
        exact = as_truth(truth, self.phase)
        table = self.table.drop(columns=list(OF_TRUTH), errors="ignore")
        rows = [errors(self.results[str(method)], exact) for method in table.index]
        return replace(self, table=in_order(table.join(pd.DataFrame(rows, index=table.index))))

    def with_doubt(self, maps: Mapping[str, xr.DataArray]) -> Comparison:
        """Return the same results, with the share of doubtful pixels in the table.

        The column ``doubtful_percent`` is the share in percent of the object's pixels whose
        confidence is below 0.5. The object is what is neither empty field nor left out by a given
        mask; where no object is found, all usable pixels count.

        Parameters
        ----------
        maps : mapping of str to DataArray
            Method id to what `confidence` gave for it. Methods without a map get NaN; with no map
            at all the column goes.

        Raises
        ------
        ValueError
            If there is a map of a method that was not compared.
        """
        unknown = [method for method in maps if method not in self.results]
        if unknown:
            msg = f"there is no result of {unknown[0]!r}; there are {', '.join(self.results)}"
            raise ValueError(msg)
        table = self.table.drop(columns="doubtful_percent", errors="ignore")
        if maps:
            tally = self.tally(maps)
            shares = {method: 100 * tally.doubtful_share(method) for method in maps}
            column = [shares.get(str(method), float("nan")) for method in table.index]
            table = table.assign(doubtful_percent=column)
        return replace(self, table=in_order(table))

    def with_results(
        self,
        results: Mapping[str, xr.DataArray],
        seconds: Mapping[str, float],
        order: Sequence[str],
    ) -> Comparison:
        """Return the comparison with results that were found on another way.

        Parameters
        ----------
        results : mapping of str to DataArray
            Unwrapped phase of further methods, which notes how it was made.
        seconds : mapping of str to float
            What each of them took.
        order : sequence of str
            All methods, in the order in which they are to be.
        """
        both = {**self.results, **results}
        rows = {str(m): dict(row) for m, row in self.table.iterrows()} | {
            m: {
                "method": label_of(m, result.attrs.get("options", {})),
                "seconds": seconds[m],
                "peak_mb": float("nan"),
            }
            for m, result in results.items()
        }
        table = table_of({m: rows[m] for m in order})
        return replace(self, results={m: both[m] for m in order}, table=table)

    def on_grid_of(self, phase: xr.DataArray, results: Mapping[str, xr.DataArray]) -> Comparison:
        """Return the comparison with other times and places of the same pixels.

        Nothing is computed again: what is known of the phase is shared with this one.

        Parameters
        ----------
        phase : DataArray
            The wrapped phase, with its new coordinates and notes.
        results : mapping of str to DataArray
            The results, with theirs.
        """
        # The problem stays the same one: of two that share a place on disk, each would write its
        # own maps over those of the other.
        return replace(self, results=results, phase=phase)

    def object_mask(self) -> xr.DataArray:
        """Return what of the usable field is not empty, in the form of the phase.

        A sheet that lies whole turns above the empty field looks like it. It belongs to the object
        where that is known: directional L1 is among the methods, or `confidence` has been asked.

        Frames that say nothing hold no object. Of results on disk it is held in memory as well,
        in a byte a pixel.
        """
        with self.object_by_blocks() as mask:
            return mask.load()

    @contextmanager
    def object_by_blocks(self, task: Task = UNWATCHED) -> Iterator[xr.DataArray]:
        """Give what `object_mask` returns; of results on disk, to be read a block at a time.

        It can be read until the block of code ends: what it follows from is removed then.

        Parameters
        ----------
        task : Task, optional
            Who may stop it.
        """
        problem = self.problem
        with problem.locks.together:  # or another thread could remove what is still to be read
            try:
                mask = problem.result(self._object_values(task), "object", {"units": "1"})
                yield scaled_like(mask, self.phase)
            finally:
                problem.tidy()

    def _object_values(self, task: Task) -> Any:
        """Return the mask of the object (time, angle, y, x), lazy where the phase lies on disk."""
        problem, blocks = self.problem, self.problem.blocks()
        if REFERENCE in self.results:
            settle_plateaus(problem, judged_of(self.results[REFERENCE], problem), task)
        read = partial(object_of, problem, shown_field(problem, task))
        watch = Watch(len(blocks), "looking for the object", task.quiet)
        for block in blocks:
            watch.step()
            if read(block).any():
                break
        else:
            read = partial(object_of, problem, None)
        shape = problem.given.shape
        return read(Block(0, shape[0])) if problem.held else read_when_needed(read, blocks, shape)


def map_name(method: str) -> str:
    """Return by which name a problem knows the map of confidence of a method."""
    return f"confidence of {method}"


def tally_name(methods: Iterable[str]) -> str:
    """Return by which name a problem knows what was counted in maps of some methods."""
    return f"tally of {', '.join(methods)}"


def identity(found: T) -> T:
    """Return what is given."""
    return found


def same(one: Mapping[str, xr.DataArray], other: Mapping[str, xr.DataArray]) -> bool:
    """Say whether two mappings hold the same stacks, not equal ones."""
    return one.keys() == other.keys() and all(one[k] is other[k] for k in one)


def compare(
    phase: xr.DataArray | ArrayLike,
    methods: Sequence[str] | None = None,
    boundary: tuple[int, int] | Sequence[tuple[int, int]] = (0, 0),
    truth: xr.DataArray | ArrayLike | None = None,
    *,
    mask: xr.DataArray | ArrayLike | None = None,
    amplitude: xr.DataArray | ArrayLike | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Unwrap with several methods and put the figures next to each other.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, see `unwrap`. An array of float32 is held as it is, not
        copied: leave its numbers alone as long as you ask for confidence.
    methods : sequence of str, optional
        Ids or labels among `METHODS`. Default: all that suit the phase: those that need several
        wavelengths only where it has them.
    boundary, mask, amplitude, cancelled
        See `unwrap`.
    truth : DataArray or array_like, optional
        Exact phase of the same frames; they are found by their coordinates, where it has any.
    options : mapping, optional
        Id or label of a method to the options of that method.
    progress : callable, optional
        ``progress(done, total, message)`` after each step of a method; the message begins with
        the method and how many there are, such as "T/A (4 of 6): ".
    finished : callable, optional
        ``finished(method, comparison)`` after each method, with all results so far, so that they
        are not lost if the rest is cancelled or fails. They may be looked at straight away;
        the methods of that comparison that compute have to wait until `compare` has ended.

    Returns
    -------
    Comparison
        The two-dimensional unwrapping and the registration are computed once; their time is
        counted in every method that uses them, their memory in the first.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    unwrap : One method.
    Comparison.confidence : How far to trust each pixel of a result.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> methods = ["spatial-2d", "temporal-angular"]
    >>> found = p4d.compare(sample["wrapped"], methods, truth=sample["phase"])
    >>> list(found.table["method"])
    ['2-D', 'T/A']
    >>> found.results["temporal-angular"].dims
    ('time', 'angle', 'y', 'x')
    """
    chosen = list(METHODS) if methods is None else as_methods(methods)
    options = {} if options is None else options
    if not isinstance(options, Mapping) or not all(
        isinstance(own, Mapping) for own in options.values()
    ):
        msg = (
            f"options must map method ids to their options, but is {shown(options)}; give "
            '{"laplacian": {"borders": "mirror"}}, or leave them out'
        )
        raise TypeError(msg)
    check_call("finished", finished)
    options = options_by_id(options)
    chosen = list(dict.fromkeys(check_method(method, {}) for method in chosen))
    mask = without_masked(phase, mask)
    stack = wrapped_stack(phase, mask=mask)
    if methods is None:
        chosen = methods_for(wavelengths_of(stack))
    problem = Problem(stack, boundary, mask, amplitude)
    try:
        return compare_on(problem, chosen, truth, options, progress, cancelled, finished)
    finally:
        problem.forget_field()


def compare_on(
    problem: Problem,
    methods: Sequence[str],
    truth: xr.DataArray | Any,
    options: Mapping[str, Mapping[str, Any]],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Run several methods one after the other, wherever their phase lies; see `compare`.

    Parameters
    ----------
    problem : Problem
        Wrapped phase with its mask and boundary frames, in memory or on disk.
    methods : sequence of str
        Ids of the methods.
    truth : DataArray, array_like or None
        Exact phase of the same frames in radians, None where it is not known.
    options : mapping
        Method id to the options of that method.
    progress, cancelled, finished : callable, optional
        See `compare`.

    Returns
    -------
    Comparison
        Unwrapped phase of every method in radians, and their table.
    """
    task = Task(progress, cancelled)
    exact = as_truth(truth, problem.template)
    so_far = Comparison({}, table_of({}), problem, problem.template)
    rows: dict[str, dict[str, Any]] = {}
    for place, method in enumerate(methods, 1):
        own_options = options.get(method, {})
        label = label_of(method, own_options)
        head = f"{label} ({place} of {len(methods)})"
        report = task.reworded(partial("{}: {}".format, head))
        cost = cost_of(problem, method, report, own_options)
        rows[method] = row_of(label, cost, exact)
        results = {**so_far.results, method: cost.result}
        so_far = replace(so_far, results=results, table=table_of(rows))
        if finished is not None:
            finished(method, so_far)
    return so_far


def cost_of(
    problem: Problem, method: str, task: Task, options: Mapping[str, Any]
) -> Measured[xr.DataArray]:
    """Run one method, and count the time of the shared steps that others have done for it."""
    shared = dict(problem.seconds)
    problem.used.clear()
    cost = measured(partial(run_method, problem, method, task, options))
    shared_seconds = sum(shared.get(step, 0.0) for step in problem.used)
    return replace(cost, seconds=cost.seconds + shared_seconds)


def row_of(label: str, cost: Measured[xr.DataArray], truth: xr.DataArray | None) -> dict[str, Any]:
    """Return what the table says of one result."""
    own = {"method": label, "seconds": cost.seconds, "peak_mb": cost.peak_mb}
    return own | errors(cost.result, truth)
