"""Step 5: look at the results side by side and save them."""

from __future__ import annotations

from pathlib import Path

from qtpy.QtWidgets import (
    QAbstractItemView,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
)

from napari_phase4d._napari.session import Plan
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.pipeline import write_outcome
from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["CompareStep"]


class CompareStep(Step):
    """Grid, table, save."""

    title = "5  Compare"
    purpose = "All results share sliders and contrast. Differences between methods are errors."

    def build(self) -> None:
        """Make the widgets."""
        row = QHBoxLayout()
        self.side_by_side = self.button(
            "Side by side",
            "side_by_side",
            "The newest result of every method in a grid.",
            self.presenter.side_by_side,
        )
        self.single = self.button(
            "One at a time", "one_at_a_time", "Leave the grid.", self.presenter.one_at_a_time
        )
        row.addWidget(self.side_by_side)
        row.addWidget(self.single)
        self.column.addLayout(row)
        self.table = QTableWidget(0, 2)
        self.table.setObjectName("result_table")
        self.table.setHorizontalHeaderLabels(("method", "seconds"))
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.table.verticalHeader().setVisible(False)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.column.addWidget(self.table)
        self.save = self.button(
            "Save results…",
            "save_results",
            "OME-TIFF of every result, table and recipe, into a folder.",
            self._ask_folder,
        )
        self.column.addWidget(self.save)
        self._fit_table()
        self.session.recording_changed.connect(self._clear)
        self.session.outcome_changed.connect(self._show)

    def save_to(self, folder: str | Path) -> None:
        """Write all results into a folder, in a thread."""
        outcome = self.session.needed_outcome()

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> list[Path]:
            return write_outcome(outcome, folder, progress, cancelled)

        self.jobs.start(Plan(f"Saving to {folder}", work, lambda _: None))

    def _ask_folder(self) -> None:
        self.session.needed_outcome()
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        if folder:
            self.save_to(folder)

    def _show(self) -> None:
        table = self.session.needed_outcome().comparison.table
        self.table.setRowCount(len(table))
        for row, (method, seconds) in enumerate(
            zip(table["method"], table["seconds"], strict=True)
        ):
            self.table.setItem(row, 0, QTableWidgetItem(str(method)))
            self.table.setItem(row, 1, QTableWidgetItem(f"{seconds:.2f}"))
        self._fit_table()

    def _clear(self) -> None:
        """Forget the results of another recording."""
        self.table.setRowCount(0)
        self._fit_table()

    def _fit_table(self) -> None:
        """Make the table as high as its rows."""
        header = self.table.horizontalHeader().sizeHint().height()
        rows = self.table.rowCount() * self.table.verticalHeader().defaultSectionSize()
        self.table.setFixedHeight(header + rows + 6)
