"""Step 4: say which frame is thin, choose methods, run them."""

from __future__ import annotations

from magicgui.widgets import CheckBox, ComboBox, SpinBox
from qtpy.QtWidgets import QHBoxLayout

from napari_phase4d._napari.steps.methods import MethodRow
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.unwrapping import METHODS

__all__ = ["UnwrapStep"]


class UnwrapStep(Step):
    """Boundary frame, methods, Run."""

    title = "4  Unwrap"
    purpose = (
        "Choose a frame in which the object is thin: the methods start from it. "
        "Move the sliders to it and press the button, or type its numbers."
    )

    def build(self) -> None:
        """Make the widgets."""
        self._filling = False
        self.column.addLayout(self.form)
        self.time = self.field(
            "Thin time",
            SpinBox(name="boundary_time", min=0, max=1_000_000, tooltip="Frame number, from 0."),
        )
        self.angle = self.field(
            "Thin angle",
            ComboBox(
                name="boundary_angle",
                choices=[("–", 0)],
                tooltip="Viewing angle in which the object is thin.",
            ),
        )
        for widget in (self.time, self.angle):
            widget.changed.connect(lambda _: self.guarded(self._boundary_changed))
        self.use_view = self.button(
            "Use current view",
            "use_view",
            "Take the frame that the sliders show.",
            self.use_current,
        )
        self.suggest = self.button(
            "Suggest",
            "suggest",
            "Look for the frame that is safest to start from: that on which two different "
            "unwrappers agree most.",
            lambda: self.jobs.start(self.session.plan_boundary()),
        )
        both = QHBoxLayout()
        both.addWidget(self.use_view)
        both.addWidget(self.suggest)
        self.column.addLayout(both)
        self.mask = self.field(
            "Mask",
            CheckBox(
                name="mask",
                value=self.session.recipe.mask == "auto",
                text="object only (0 outside)",
                tooltip="Find the object in every frame and unwrap only that.",
            ),
        )
        self.methods = {
            method: MethodRow(method, ticked=method in self.session.recipe.methods)
            for method in METHODS
        }
        # Above the list, so that it is in view on a small screen too.
        self.go = self.button("Run", "run", "Unwrap with all ticked methods.", self.run)
        self.column.addWidget(self.go)
        for row in self.methods.values():
            self.column.addWidget(row)
        self.session.reconstruction_changed.connect(self._show)
        self.session.scores_changed.connect(self._show_suggestion)

    def use_current(self) -> None:
        """Take the frame that the sliders show as the thin one."""
        self.time.value, self.angle.value = self.presenter.current_frame()
        self._boundary_changed()

    def run(self) -> None:
        """Unwrap, in a thread."""
        self.session.update(
            mask="auto" if self.mask.value else None,
            methods=tuple(m for m, row in self.methods.items() if row.tick.isChecked()),
            options={m: row.changed() for m, row in self.methods.items() if row.changed()},
        )
        self.jobs.start(self.session.plan_unwrapping())

    def words_on_the_suggestion(self) -> str:
        """Say which frame was suggested and why."""
        scores = self.session.scores
        if scores is None:
            return ""
        time, angle = scores.attrs["best"]
        agree = 100 * scores.attrs["agreement"]
        return (
            f"Thin frame: time {time}, angle {float(scores['angle'][angle]):g}°. There, "
            f"{scores.attrs['basis']} agree on {agree:.3g} % of the object."
        )

    def _show_suggestion(self) -> None:
        self._show()
        self.presenter.go_to(*self.session.recipe.boundary[0])

    def _boundary_changed(self) -> None:
        """Take the thin frame as typed."""
        if not self._filling:
            self.session.update(boundary=((self.time.value, self.angle.value),))

    def _show(self) -> None:
        """Limit the numbers to the frames that there are."""
        phase = self.session.needed_reconstruction()["phase"]
        time, angle = self.session.recipe.boundary[0]
        angles = enumerate(phase["angle"].values)
        self._filling = True
        try:
            self.time.max = phase.sizes["time"] - 1
            self.angle.choices = [(f"{degrees:g}°", number) for number, degrees in angles]
            self.time.value, self.angle.value = time, angle
        finally:
            self._filling = False
