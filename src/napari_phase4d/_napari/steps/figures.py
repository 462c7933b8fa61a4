"""The tab of step 5 with the table of figures."""

from __future__ import annotations

from pathlib import Path

from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.widgets.result_table import ResultTable
from napari_phase4d.io import write_table

__all__ = ["FiguresPart"]

#: Columns of the table: heading, what it means, and how it is written if not with three digits.
HEADINGS = {
    "method": ("method", "The unwrapping method."),
    "seconds": ("s", "Seconds, the shared two-dimensional step included."),
    "doubtful_percent": (
        "doubt %",
        "Pixels of the object that are trusted less than 0.5, in percent. The maps of trust err "
        "on the side of doubt.",
    ),
    "mse_rad2": ("MSE rad²", "Mean squared error against the chosen truth, in square radians."),
    "wrong_cycles_percent": (
        "wrong %",
        "Pixels that are off by at least one cycle against the chosen truth, in percent.",
    ),
    "peak_mb": ("MB", "Most memory beyond what was there before, in megabytes.", ".1f"),
}


class FiguresPart(Step):
    """Table of the methods: seconds, doubtful pixels, errors."""

    title = "Table"
    summary = "One line a method; click on a heading to sort."

    def build(self) -> None:
        """Make the widgets."""
        self.table = ResultTable("result_table")
        self.table.setMinimumHeight(120)
        self.column.addWidget(self.table, 1)
        self.copy = self.button(
            "Copy", "copy_table", "Put the table on the clipboard.", self._copy
        )
        self.save = self.button(
            "Save as CSV…", "save_table", "Write the table to a file.", self._ask_file
        )
        self.column.addLayout(self.row(self.copy, self.save))
        for signal in (
            self.session.recording_changed,
            self.session.reconstruction_changed,
            self.session.outcome_changed,
            self.session.confidence_changed,
            self.session.truth_changed,
        ):
            signal.connect(self._show)

    def save_to(self, path: str | Path) -> None:
        """Write the table as CSV."""
        path = write_table(path, self.session.needed_outcome().comparison.table)
        self.said.emit(f"The table is in {path}.")

    def _ask_file(self) -> None:
        self.session.needed_outcome()
        path, _ = QFileDialog.getSaveFileName(self, "Table", "table.csv", "CSV (*.csv)")
        if path:
            self.save_to(path)

    def _copy(self) -> None:
        self.table.copy()
        self.said.emit("The table is on the clipboard.")

    def _show(self) -> None:
        outcome = self.session.outcome
        if outcome is None:
            self.table.clear_rows()
            return
        table = outcome.comparison.table
        said = {
            row: words[:1].upper() + words[1:]
            for row, method in enumerate(table.index)
            if (words := self.session.warnings.get(str(method), ""))
        }
        self.table.show_frame(table.reset_index(drop=True), HEADINGS, said)
