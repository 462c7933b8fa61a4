"""The batch itself: file after file, whatever becomes of one of them."""

from __future__ import annotations

import errno
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from napari_phase4d.pipeline.batch.folders import (
    asked_for,
    complete,
    digest_of,
    made_whole,
    recovered,
    result_folders,
    write_note,
)
from napari_phase4d.pipeline.batch.lock import alone
from napari_phase4d.pipeline.batch.summary import (
    COMPLETE,
    DONE,
    FAILED,
    LOG,
    Summary,
    facts_of,
    facts_of_input,
)
from napari_phase4d.pipeline.places import make_folder, stacks_beside
from napari_phase4d.pipeline.provenance import Fingerprint, Hashing, Remembered, fingerprinting
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome, run
from napari_phase4d.pipeline.starting import found_anywhere
from napari_phase4d.pipeline.writing import checked_form, write_files
from napari_phase4d.task import Cancelled, CancelledCall, ProgressCall, Task
from napari_phase4d.words import (
    as_path,
    check_bool,
    check_call,
    counted,
    is_expected,
    local_path,
    sentence_of,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["run_batch"]

#: Faults after which no other file would fare better.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def run_batch(
    recipe: Recipe,
    files: Sequence[str | Path],
    out: str | Path,
    *,
    resume: bool = False,
    form: str | None = None,
    truth: xr.DataArray | None = None,
    scheduler: str | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    told: Callable[[str], None] | None = None,
    prepared: Callable[[Recipe], Recipe] | None = None,
    finished: Callable[[Outcome, Path], None] | None = None,
) -> pd.DataFrame:
    """Run a recipe on many files; one that fails does not stop the others.

    Each file gets a folder in ``out``, named after it, see `result_folders`. A folder is there
    only when all is in it: until then it has a hidden name. Older results are replaced only then,
    too. ``run.json`` in it notes the input and every result with size and SHA-256.
    ``out/summary.csv`` has a row a file and is renewed after each; ``out/batch.log`` keeps the
    lines that are told.

    Parameters
    ----------
    recipe : Recipe
        All settings but the recording.
    files : sequence of str or Path
        Recordings or wrapped phase; what is given twice is run once.
    out : str or Path
        Folder for the results; made if it is not there.
    resume : bool, optional
        Whether to leave what is complete as it is: where input, recipe, form and version are the
        same, by content, and all results are undamaged. Default: everything is run.
    form : str, optional
        "tiff" or "zarr", see `write_outcome`.
    truth : DataArray, optional
        Exact phase on the grid of every file, for the tables.
    scheduler : str, optional
        Address of a cluster to work on, see `run`.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.
    told : callable, optional
        ``told(line)`` with what came of each file, in one line.
    prepared : callable, optional
        ``prepared(recipe)`` returns the recipe to follow for a file, given the one with its name.
    finished : callable, optional
        ``finished(outcome, folder)`` for each file that was run, before its folder gets its name;
        what it writes there belongs to the results.

    Returns
    -------
    pandas.DataFrame
        One row a file: ``file``, ``folder``, ``status`` ("done", "complete already" or "failed"),
        ``seconds``, ``frames``, ``views``, ``boundary`` (the frame that was started from),
        ``results``, ``best_method`` (the one most to be trusted), ``doubtful_percent`` (of the
        object's pixels in its result, where the recipe asks for confidence), ``cells`` (how many
        were found, where it asks for them; ``out/cells.csv`` has a row for each), ``input_bytes``,
        ``input_sha256``, ``notes`` (what had to be assumed of the file), ``error``. Where only
        cells could not be found, the results are there all the same, and the file has failed.

    Raises
    ------
    OSError
        If ``out`` can't be written, is full, or another batch works there.
    ValueError
        If there is no such form.
    Cancelled
        If ``cancelled()`` returned True; what is complete stays, nothing is half-written.
    """
    if isinstance(files, str | Path):
        files = [files]
    check_bool("resume", resume)
    for name, call in {"told": told, "prepared": prepared, "finished": finished}.items():
        check_call(name, call)
    wish = Wish(
        recipe, resume, checked_form(form), truth, scheduler, cancelled, prepared, finished
    )
    for file in files:
        as_path(file)
    sources = list(dict.fromkeys(found_anywhere(file) for file in files))
    given = {found_anywhere(file): str(file) for file in reversed(files)}
    out = local_path(out)
    make_folder(out)
    folders = result_folders(sources, out)
    Summary.check_own(out)
    summary = Summary(out, [given[source] for source in sources], folders, told)
    with alone(out):
        for folder in folders:
            recovered(folder)
        summary.write()
        try:
            for number, (source, folder) in enumerate(zip(sources, folders, strict=True)):
                one_file(wish, summary, number, source, folder, progress)
        except (Cancelled, KeyboardInterrupt):
            summary.tell(f"Stopped; {summary.in_words()}. Go on with --resume.")
            raise
        summary.tell(f"{summary.in_words()}.")
    return summary.table


@dataclass(frozen=True)
class Wish:
    """What a batch is to do with each file; see `run_batch`."""

    recipe: Recipe
    resume: bool
    form: str | None
    truth: xr.DataArray | None
    scheduler: str | None
    cancelled: CancelledCall | None
    prepared: Callable[[Recipe], Recipe] | None
    finished: Callable[[Outcome, Path], None] | None
    remembered: Remembered = field(default_factory=Remembered)

    @cached_property
    def truth_digest(self) -> str | None:
        """What tells the exact phase from others, computed once."""
        return None if self.truth is None else digest_of(self.truth)

    def reference_of(self, recipe: Recipe) -> Fingerprint | None:
        """Return the fingerprint of the file that a recipe divides by, computed once."""
        if recipe.reference_file is None:
            return None
        return self.remembered(recipe.reference_file, Task(None, self.cancelled))


def one_file(
    wish: Wish,
    summary: Summary,
    number: int,
    source: str,
    folder: Path,
    progress: ProgressCall | None,
) -> None:
    """Run one file, or see that it is complete, and tell what came of it."""
    began = time.perf_counter()
    try:
        if wish.cancelled is not None and wish.cancelled():
            raise Cancelled
        report = summary.reporting(number, progress)
        status, facts = results_of(wish, source, folder, report)
    except Cancelled:
        raise
    except Exception as error:  # whatever a library raises on a bad file at night
        sentence, more = sentence_of(error), ""
        if not is_expected(error):
            sentence, more = f"{sentence}; {LOG} has the details", traceback.format_exc()
        summary.tell(f"failed: {sentence}", number, more)
        summary.note(number, FAILED, {"error": sentence, "seconds": seconds_since(began)})
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            msg = f"{sentence}; make room in {folder.parent} and go on with --resume"
            raise OSError(msg) from error
        return
    words = f"complete already in {folder}"
    if status != COMPLETE:
        words = f"{counted(facts['results'], 'result')} in {facts['seconds']:.0f} s -> {folder}"
    if status == FAILED:
        words = f"failed: {facts['error']}; {words}"
    summary.tell(words, number)
    summary.note(number, status, facts)


def results_of(
    wish: Wish, source: str, folder: Path, progress: ProgressCall | None
) -> tuple[str, dict[str, Any]]:
    """Return whether a file was run, failed in part or was complete already, and its facts."""
    began = time.perf_counter()
    with fingerprinting(source) as hashing:
        recipe = wish.recipe.changed(recording=source)
        if wish.prepared is not None:
            recipe = wish.prepared(recipe)
        reference = wish.reference_of(recipe)
        asked = asked_for(recipe, wish.form, wish.truth_digest, reference)
        if wish.resume:
            note = complete(folder, asked, hashing, Task(None, wish.cancelled))
            if note is not None and "error" not in note["facts"]:
                return COMPLETE, note["facts"] | facts_of_input(note["input"])
        with made_whole(folder) as partial:
            outcome = written(wish, recipe, hashing, reference, partial, progress)
            facts = facts_of(outcome, partial)
            known = hashing.result(
                Task(None, wish.cancelled)
            ).as_dict()  # asked again: is it still the same?
            facts["seconds"] = seconds_since(began)
            write_note(partial, asked, known, facts, Task(None, wish.cancelled))
    return (FAILED if "error" in facts else DONE), facts | facts_of_input(known)


def written(
    wish: Wish,
    recipe: Recipe,
    hashing: Hashing,
    reference: Fingerprint | None,
    folder: Path,
    progress: ProgressCall | None,
) -> Outcome:
    """Run a recipe and write what comes out into a folder."""
    with stacks_beside(folder, wish.form) as place:
        outcome = run(
            recipe,
            truth=wish.truth,
            progress=progress,
            cancelled=wish.cancelled,
            folder=place,
            scheduler=wish.scheduler,
        )
        source = hashing.result(Task(None, wish.cancelled))
        write_files(
            outcome,
            folder,
            Task(progress, wish.cancelled),
            form=wish.form,
            source=source,
            reference=reference,
        )
        if wish.finished is not None:
            wish.finished(outcome, folder)
    return outcome


def seconds_since(began: float) -> float:
    """Return the seconds since then, to the hundredth."""
    return round(time.perf_counter() - began, 2)
