"""Step 4: say which frame is thin, choose methods, run them."""

from __future__ import annotations

from typing import Any

from magicgui.widgets import CheckBox
from qtpy.QtWidgets import QGridLayout

from napari_phase4d._napari.session import plan_unwrapping
from napari_phase4d._napari.steps.boundary import BoundaryPart
from napari_phase4d._napari.steps.methods import MethodRow
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.pipeline import phase_needs
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import size_in_words, time_in_words

__all__ = ["UnwrapStep"]

COLUMNS = 2


class UnwrapStep(Step):
    """Boundary frame, methods, Run."""

    title = "4  Unwrap"

    def build(self) -> None:
        """Make the widgets."""
        self.explanation.hide()
        self.boundary = BoundaryPart(self.session, self.jobs, self.presenter)
        self.boundary.failed.connect(self.failed)
        self.boundary.said.connect(self.said)
        self.column.addWidget(self.boundary)
        self.mask = self.watched(
            CheckBox(
                name="mask",
                value=self.session.recipe.mask == "auto",
                text="object only",
                tooltip="Find the object in every frame, unwrap only that, and set the rest to 0.",
            )
        )
        self.when_changed(self.mask, self._mask_changed)
        self.go = self.button(
            "Run", "run", "Unwrap with all ticked methods, one after another.", self.run
        )
        # Above the list, so that it is in view on a small screen too.
        self.column.addLayout(self.row(self.mask.native, self.go))
        self.methods = {
            method: MethodRow(method, ticked=method in self.session.recipe.methods)
            for method in METHODS
        }
        grid = QGridLayout()
        grid.setVerticalSpacing(0)
        rows = -(-len(self.methods) // COLUMNS)
        for number, row in enumerate(self.methods.values()):
            grid.addWidget(row, number % rows, number // rows)
            row.tick.toggled.connect(lambda _, m=row.method: self.guarded(lambda: self._ticked(m)))
            row.option_changed.connect(
                lambda m=row.method: self.guarded(lambda: self._option_changed(m))
            )
            row.ticked_on.connect(self.boundary.show_path_of)
            if row.panel is not None:
                row.more.toggled.connect(lambda shown, row=row: self._show_options(row, shown))
        self.column.addLayout(grid)
        for row in self.methods.values():
            if row.panel is not None:
                self.column.addWidget(row.panel)
        self.session.recipe_changed.connect(self._show_settings)
        for signal in (
            self.session.recipe_changed,
            self.session.reconstruction_changed,
            self.session.estimate_changed,
        ):
            signal.connect(self._show_needs)

    def frame_changed(self) -> None:
        """Follow the sliders."""
        self.boundary.frame_changed()

    def run(self) -> None:
        """Unwrap, in a thread."""
        self.jobs.start(plan_unwrapping(self.session))

    def _show_options(self, shown_row: MethodRow, shown: Any) -> None:
        """Show the options of one method at a time."""
        for row in self.methods.values():
            if row.panel is not None and row is not shown_row and shown:
                row.more.setChecked(False)
        assert shown_row.panel is not None
        shown_row.panel.setVisible(bool(shown))

    def _mask_changed(self) -> None:
        self.session.update(mask="auto" if self.mask.value else None)

    def _ticked(self, method: str) -> None:
        """Put a method into the recipe or out of it, in the order in which they are shown."""
        if not self.filling:
            chosen = set(self.session.recipe.methods) ^ {method}
            self.session.update(methods=tuple(m for m in METHODS if m in chosen))

    def _option_changed(self, method: str) -> None:
        if not self.filling:
            options = {**self.session.recipe.options, method: self.methods[method].changed()}
            self.session.update(options={m: o for m, o in options.items() if o})

    def _show_needs(self) -> None:
        """Say on the button how long a run will take and how much memory, about."""
        data, methods = self.session.reconstruction, self.session.recipe.methods
        if data is None or not methods:
            self.go.setText("Run")
            return
        needs = phase_needs(methods, data["phase"].shape)
        size = needs.in_memory if self.session.place is None else needs.on_disk
        told = [size_in_words(size)]
        if self.session.estimate is not None:
            told.insert(0, time_in_words(self.session.estimate[1]))
        self.go.setText(f"Run (about {', '.join(told)})")

    def _show_settings(self) -> None:
        """Show what the recipe says."""
        recipe = self.session.recipe
        with self.own_change():
            self.mask.value = recipe.mask == "auto"
            for method, row in self.methods.items():
                options = recipe.options.get(method, {})
                row.show_choice(ticked=method in recipe.methods, options=options)
