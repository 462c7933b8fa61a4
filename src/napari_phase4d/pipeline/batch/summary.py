"""What a batch tells of each file: a line in the log, a row in the summary."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from napari_phase4d.analysis import most_trusted
from napari_phase4d.io import write_table
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.task import ProgressCall, Task
from napari_phase4d.words import counted, sentence_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["COMPLETE", "DONE", "FAILED", "LOG", "Summary", "facts_of", "facts_of_input"]

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
        """Refuse a folder in which a table lies that no batch has made.

        Raises
        ------
        OSError
            If there is one, or it can't be read.
        """
        for name, begins in ((TABLE, "number,file,folder,status"), (CELLS, "file,cell")):
            path = out / name
            if not path.exists():
                continue
            with path.open("rb") as lines:
                if lines.read(len(begins)).decode(errors="replace") != begins:
                    msg = f"{path} is of no batch, and would be replaced; choose another --out"
                    raise OSError(msg)

    @property
    def table(self) -> pd.DataFrame:
        """One row a file, numbered from 1."""
        import pandas as pd

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
            import pandas as pd

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
            import pandas as pd

            every = pd.concat([self._cells[number] for number in sorted(self._cells)])
            write_table(self.out / CELLS, every.set_index("file"))

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
        name = readable(Path(self.files[number]).name)
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
    import pandas as pd

    phase = outcome.reconstruction["phase"]
    results = outcome.comparison.results
    best = most_trusted(results)
    facts = {
        "frames": int(phase.sizes["time"]),
        "views": int(phase.sizes["angle"]),
        "boundary": " ".join(f"{t},{a}" for t, a in outcome.recipe.start_frames),
        "results": len(results),
        "best_method": best,
        "notes": " ".join(notes_of(outcome, phase)),
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
