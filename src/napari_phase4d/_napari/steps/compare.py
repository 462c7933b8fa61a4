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
from napari_phase4d.evaluation import best_known, order_verdict
from napari_phase4d.pipeline import write_outcome
from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["CompareStep"]


#: Columns of the table: heading and what it means.
COLUMNS = {
    "method": ("method", "The unwrapping method."),
    "seconds": ("s", "Seconds, the shared two-dimensional step included."),
    "peak_mb": ("MB", "Largest memory at one time, in megabytes."),
    "mse_rad2": ("MSE rad²", "Mean squared error against the exact phase."),
    "wrong_cycles_percent": ("wrong %", "Pixels that are off by at least one cycle."),
}


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
        self.table = QTableWidget(0, 0)
        self.table.setObjectName("result_table")
        self.table.verticalHeader().setVisible(False)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.column.addWidget(self.table)
        self.margin = self.button(
            "Where are steps too large?",
            "show_margin",
            "Maps of the step to the next time, angle, y and x, in half cycles: where it is "
            "red, the step is too large for unwrapping along that dimension.",
            lambda: self.jobs.start(self.session.plan_margin()),
        )
        self.column.addWidget(self.margin)
        self.confidence = self.button(
            "How far to trust them?",
            "show_confidence",
            "Maps of each result's chance to be right, from 0 to 1: dark where it is more likely "
            "off by a cycle.",
            lambda: self.jobs.start(self.session.plan_confidence()),
        )
        self.column.addWidget(self.confidence)
        self.save = self.button(
            "Save results…",
            "save_results",
            "OME-TIFF of every result, table and recipe, into a folder.",
            self._ask_folder,
        )
        self.column.addWidget(self.save)
        self._fit_table()
        self.session.recording_changed.connect(self._clear)
        self.session.reconstruction_changed.connect(self._clear)
        self.session.outcome_changed.connect(self._show)
        self.session.confidence_changed.connect(self._show_warnings)

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

    def words_on_the_steps(self) -> str:
        """Say along which dimensions steps are too large, and which order suits the object."""
        if self.session.margin is None:
            return ""
        outcome, truth = self.session.outcome, self.session.truth
        results = {} if outcome is None else outcome.comparison.results
        boundary = self.session.recipe.boundary if outcome is None else outcome.recipe.boundary
        _, basis = best_known(results, truth)
        shares = ", ".join(
            f"{str(name).removeprefix('along_')} {100 * stack.attrs['share_beyond']:.2g} %"
            for name, stack in self.session.margin.data_vars.items()
        )
        verdict = order_verdict(results, boundary[0], truth)
        return f"Steps beyond half a cycle, by {basis}: {shares}. {verdict}"

    def words_on_confidence(self) -> str:
        """Say which results are least to be trusted, and where whole objects may have slipped."""
        maps, warnings = self.session.confidence, self.session.warnings
        if not maps:
            return ""
        labels = self.session.needed_outcome().comparison.table["method"]
        doubtful = {m: 100 * float((c.values < 0.5).mean()) for m, c in maps.items()}
        shares = ", ".join(f"{labels[m]} {share:.2g} %" for m, share in doubtful.items())
        said = ""
        if warnings:
            slipped = ", ".join(labels[m] for m in warnings)
            said = f" Whole objects may be a cycle off in some frames of {slipped}; "
            said += "the table's tooltips say in how many."
        return f"Pixels more likely wrong than right: {shares}.{said}"

    def _show_warnings(self) -> None:
        """Note at each method in the table whether whole objects may have slipped."""
        table = self.session.needed_outcome().comparison.table
        for row, method in enumerate(table.index):
            words = self.session.warnings.get(str(method), "")
            self.table.item(row, 0).setToolTip(words[:1].upper() + words[1:])

    def _show(self) -> None:
        table = self.session.needed_outcome().comparison.table
        shown = [name for name in COLUMNS if name in table.columns]
        self.table.setColumnCount(len(shown))
        self.table.setHorizontalHeaderLabels([COLUMNS[name][0] for name in shown])
        for column, name in enumerate(shown):
            self.table.horizontalHeaderItem(column).setToolTip(COLUMNS[name][1])
            widths = QHeaderView.ResizeMode
            wanted = widths.ResizeToContents if name == "method" else widths.Stretch
            self.table.horizontalHeader().setSectionResizeMode(column, wanted)
        self.table.setRowCount(len(table))
        for row in range(len(table)):
            for column, name in enumerate(shown):
                value = table[name].iloc[row]
                words = value if isinstance(value, str) else f"{value:.3g}"
                self.table.setItem(row, column, QTableWidgetItem(words))
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
