"""Many files by one recipe, unattended: whatever becomes of one, and what is told of each."""

from __future__ import annotations

import errno
import math
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from napari_phase4d.analysis import most_trusted
from napari_phase4d.io import write_table
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline.batch_folders import (
    alone,
    asked_for,
    complete,
    digest_of,
    made_whole,
    recovered,
    result_folders,
    write_note,
)
from napari_phase4d.pipeline.folder import checked_form, write_files
from napari_phase4d.pipeline.places import make_folder, stacks_beside
from napari_phase4d.pipeline.provenance import Fingerprint, Hashing, Remembered, fingerprinting
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome, advice_on, run_unwarned
from napari_phase4d.pipeline.starting import found_anywhere
from napari_phase4d.task import Cancelled, CancelledCall, ProgressCall, Task
from napari_phase4d.words import (
    advised_call,
    as_path,
    counted,
    is_expected,
    local_path,
    printable,
    sentence_of,
)

__all__ = ["run_batch"]

WAITING, DONE, COMPLETE, FAILED = "waiting", "done", "complete already", "failed"
COLUMNS = (
    "file", "folder", "status", "seconds", "frames", "views", "boundary", "results",
    "best_method", "doubtful_percent", "cells", "input_bytes", "input_sha256", "notes", "error",
)  # fmt: skip
#: Columns of whole numbers, which are not there for files that failed.
COUNTS = ("frames", "views", "results", "cells", "input_bytes")
LOG, TABLE, CELLS = "batch.log", "summary.csv", "cells.csv"
#: The table of cells in the folder of each file.
OF_FILE = "cell_summary.csv"


class Summary:
    """The log and the table of a batch, kept on disk after each file.

    Parameters
    ----------
    out : Path
        Folder of the batch.
    files : sequence of str
        All files, as they were given.
    folders : sequence of Path
        Where the results of each go.
    told : callable, optional
        ``told(line)`` for each line of the log.
    """

    def __init__(
        self,
        out: Path,
        files: Sequence[str],
        folders: Sequence[Path],
        told: Callable[[str], None] | None,
    ) -> None:
        self.out, self.files, self._told = out, files, told
        self._folders = folders
        self._cells: dict[int, pd.DataFrame] = {}
        self._rows: list[dict[str, Any]] = [
            {"file": readable(file), "folder": folder.name, "status": WAITING}
            for file, folder in zip(files, folders, strict=True)
        ]

    @staticmethod
    def check_own(out: Path) -> None:
        """Refuse a folder in which a table lies that no batch has made, or a pipe for its log.

        Raises
        ------
        OSError
            If there is one, or it can't be read.
        """
        begins_with = {TABLE: "number,file,folder,status", CELLS: "file,cell", LOG: ""}
        for name, begins in begins_with.items():
            path = out / name
            if not path.exists():
                continue
            if not path.is_file():
                msg = f"{path} is not a file, as that of a batch is; choose another --out"
                raise OSError(msg)
            with path.open("rb") as lines:
                if lines.read(len(begins)).decode(errors="replace") != begins:
                    msg = f"{path} is of no batch, and would be replaced; choose another --out"
                    raise OSError(msg)

    @property
    def table(self) -> pd.DataFrame:
        """One row a file, numbered from 1."""
        index = pd.RangeIndex(1, len(self._rows) + 1, name="number")
        table = pd.DataFrame(self._rows, columns=list(COLUMNS), index=index)
        return table.astype(dict.fromkeys(COUNTS, "Int64"))

    def count(self, status: str) -> int:
        """Return how many files are so far."""
        return sum(row["status"] == status for row in self._rows)

    def note(self, number: int, status: str, facts: dict[str, Any]) -> None:
        """Put what is known of file ``number``, from 0, into the table, and write it.

        Raises
        ------
        OSError
            If the table can't be written.
        """
        known = {name: value for name, value in facts.items() if name in COLUMNS}
        self._rows[number] |= {"status": status, **known}
        found = self._folders[number] / OF_FILE
        if status in (DONE, COMPLETE) and facts.get("cells") is not None and found.exists():
            cells = pd.read_csv(found)
            cells.insert(0, "file", self._rows[number]["file"])
            self._cells[number] = cells
        self.write()

    def write(self) -> None:
        """Write the table as it is."""
        for table in (TABLE, CELLS):
            for left in self.out.glob(f".{Path(table).stem}-*.csv"):  # by a batch that was killed
                left.unlink()
        write_table(self.out / TABLE, self.table)
        if self._cells:
            every = pd.concat([self._cells[number] for number in sorted(self._cells)])
            write_table(self.out / CELLS, every.set_index("file"))
        else:
            (self.out / CELLS).unlink(missing_ok=True)  # of an earlier batch

    def tell(self, words: str, number: int | None = None, more: str = "") -> None:
        """Write a line into the log and tell it; ``more`` goes into the log only."""
        line = words if number is None else f"{self.head(number)}: {words}"
        log = self.out / LOG
        with (
            suppress(OSError),  # a full disk is told of where results are written
            log.open("a", encoding="utf-8", errors="replace") as lines,
        ):
            lines.write(f"{line}\n{more}")
        if self._told is not None:
            self._told(line)

    def head(self, number: int) -> str:
        """Return what the lines on a file begin with."""
        name = printable(readable(Path(self.files[number]).name))
        return f"[{number + 1} of {len(self.files)}] {name}"

    def reporting(self, number: int, progress: ProgressCall | None) -> ProgressCall | None:
        """Let the progress on a file say which one it is."""
        head = self.head(number)
        return Task(progress).reworded(lambda message: f"{head}: {message}").progress

    def in_words(self) -> str:
        """Say what came of all files, in one line."""
        counts = [(self.count(status), status) for status in (DONE, COMPLETE, FAILED)]
        said = ", ".join(f"{count} {status}" for count, status in counts if count)
        return f"{counted(len(self.files), 'file')}: {said or 'nothing to do'}"


def readable(name: str) -> str:
    """Return a name as text that can be written; bytes that are no UTF-8 become "?"."""
    return name.encode(errors="replace").decode()


def facts_of(outcome: Outcome, folder: Path) -> dict[str, Any]:
    """Return what the summary says of a run, from what was written of it."""
    phase = outcome.reconstruction["phase"]
    results = outcome.comparison.results
    best = most_trusted(results)
    doubts = [f"{each[0].upper()}{each[1:]}." for each in advice_on(outcome)]
    facts = {
        "frames": int(phase.sizes["time"]),
        "views": int(phase.sizes["angle"]),
        "boundary": " ".join(f"{t},{a}" for t, a in outcome.recipe.start_frames),
        "results": len(results),
        "best_method": best,
        "notes": " ".join([*notes_of(outcome, phase), *doubts]),
        "doubts": doubts,
    }
    if outcome.cells is not None:
        facts["cells"] = len(outcome.cells.summary)
    if outcome.cells_error is not None:
        facts["error"] = f"without cells: {sentence_of(outcome.cells_error)}"
    table = pd.read_csv(folder / "table.csv", index_col="id")
    if "doubtful_percent" in table.columns:
        doubtful = float(table["doubtful_percent"].to_dict()[best])
        facts["doubtful_percent"] = None if math.isnan(doubtful) else doubtful
    return facts


def notes_of(outcome: Outcome, phase: xr.DataArray) -> Sequence[str]:
    """Return what had to be assumed of an input."""
    if outcome.recording is not None:
        return outcome.recording.notes
    return [str(note) for note in phase.attrs.get("notes", ())]


def facts_of_input(known: dict[str, Any]) -> dict[str, Any]:
    """Return what the summary says of an input."""
    return {"input_bytes": known.get("bytes"), "input_sha256": known.get("sha256")}


# ---- file after file ------------------------------------------------------------------------


#: Faults after which no other file would fare better.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


@advised_call(recipe="give Recipe(...), or Recipe.from_file(path)")
def run_batch(
    recipe: Recipe,
    files: str | Path | Iterable[str | Path],
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
    files : iterable of str or Path
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
        ``input_sha256``, ``notes`` (what had to be assumed of the file, and what is to be
        looked after in its phase), ``error``. Where only cells could not be found,
        the results are there all the same, and the file has failed.

    Raises
    ------
    OSError
        If ``out`` can't be written, is full, or another batch works there.
    ValueError
        If there is no such form.
    Cancelled
        If ``cancelled()`` returned True; what is complete stays, nothing is half-written.
    """
    files = [files] if isinstance(files, str | Path) else list(files)
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
    if status != COMPLETE:
        for doubt in facts["doubts"]:
            summary.tell(doubt, number)
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
        outcome = run_unwarned(
            recipe,
            truth=wish.truth,
            task=Task(progress, wish.cancelled),
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
