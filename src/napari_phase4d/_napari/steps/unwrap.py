"""Step 4: say which frame is thin, choose methods with their options, run them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from magicgui.widgets import CheckBox, ComboBox
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QSizePolicy,
)

from napari_phase4d._napari.session import plan_scores, plan_unwrapping
from napari_phase4d._napari.steps.methods import MethodList
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.widgets.boundary_map import BoundaryMap
from napari_phase4d._napari.widgets.view_strip import Thumbnail
from napari_phase4d.later import xr
from napari_phase4d.pipeline import phase_needs, start_words
from napari_phase4d.unwrapping import (
    METHODS,
    ORDERS,
    best_frame,
    left_out_advice,
    object_in,
    scores_sentence,
)
from napari_phase4d.words import size_in_words, time_in_words, view_of

__all__ = ["UnwrapStep"]

#: What is said of the outline.
WHOLE_FIELD = "No single object stands out of this frame: all of it is unwrapped."
ROUND_THE_OBJECT = "The green line is round what is unwrapped where only the object is."


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
        self.outline = self.button(
            "Outline",
            "show_object",
            "Show in green what is taken for the object, over the wrapped phase.",
            self._show_object,
        )
        self.outline.setCheckable(True)
        self.outline.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        # Above the list, so that it is in view on a small screen too.
        self.column.addLayout(self.row(self.mask.native, self.outline, self.go))
        self.presenter.showing_changed.connect(self._mark_outline)
        self.list = MethodList(self.session.recipe.methods)
        self.list.ticked.connect(lambda method: self.guarded(lambda: self._ticked(method)))
        self.list.ticked_on.connect(self.boundary.show_path_of)
        self.list.option_changed.connect(lambda m: self.guarded(lambda: self._option_changed(m)))
        self.methods = self.list.rows
        self.column.addWidget(self.list)
        self.session.recipe_changed.connect(self._show_settings)
        for signal in (
            self.session.recipe_changed,
            self.session.reconstruction_changed,
            self.session.estimate_changed,
        ):
            signal.connect(self._show_needs)
        self.session.reconstruction_changed.connect(self._show_settings)
        self._show_settings()

    def frame_changed(self) -> None:
        """Follow the sliders."""
        self.boundary.frame_changed()

    def doubts(self) -> Sequence[str]:
        """Return what the results themselves note of how they were made."""
        result = next(iter(self.session.results.values()), None)
        advice = "" if result is None else left_out_advice(result.attrs)
        return (advice,) if advice else ()

    def run(self) -> None:
        """Unwrap, in a thread."""
        self.jobs.start(plan_unwrapping(self.session))

    def _show_object(self) -> None:
        """Show or hide the outline of the object; the button says which it is."""
        wanted = self.outline.isChecked()
        try:
            self.presenter.show_object(wanted=wanted, then=self._say_outline)
        except ValueError:
            self._mark_outline()
            raise

    def _say_outline(self, data: xr.Dataset) -> None:
        """Say what the line is that has come up."""
        frame = self.presenter.current_frame()
        is_all = object_in(np.asarray(data["phase"].data[frame])).all()
        self.said.emit(WHOLE_FIELD if is_all else ROUND_THE_OBJECT)

    def _mark_outline(self) -> None:
        self.outline.setChecked(self.presenter.shows_object)

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
        data, methods = self.session.reconstruction, self.session.to_run
        if data is None or not methods:
            self.go.setText("Run")
            return
        needs = phase_needs(methods, data["phase"].shape)
        size = needs.in_memory if self.session.place is None else needs.on_disk
        told = [size_in_words(size)]
        known = self.session.estimate
        if known is not None and known[0] == methods:
            told.insert(0, time_in_words(known[1]))
        self.go.setText(f"Run (about {', '.join(told)})")

    def _show_settings(self) -> None:
        """Show what the recipe says; only methods that make sense for the phase can be ticked."""
        recipe, data = self.session.recipe, self.session.reconstruction
        with self.own_change():
            self.mask.value = recipe.mask == "auto"
            self.list.show_choice(self.session.to_run, recipe.options)
            self.list.show_suiting({m: self.session.why_unsuited(m) for m in METHODS})
            self.list.say_what_lacks(() if data is None else data["phase"].shape[:2])


MANY_METHODS_PATH = "temporal-angular"
#: Letters that the list of them shows at least.
LETTERS_OF_A_PATH = 4
#: Along what each method goes, and in which order.
WAYS = "; ".join(f"{METHODS[name].label}: {', then '.join(dims)}" for name, dims in ORDERS.items())


class BoundaryPart(Step):
    """Times and angles as a map: click on a frame in which the object is thin."""

    title = "Boundary"
    purpose = (
        "Methods start from the star, the safest frame. Click on another thin one instead; "
        "Shift-click adds one."
    )

    def build(self) -> None:
        """Make the widgets."""
        self.column.setContentsMargins(0, 0, 0, 0)
        self._shown: xr.Dataset | None = None
        self.map = BoundaryMap()
        self.map.setObjectName("boundary_map")
        self.column.addWidget(self.map)
        self.start = self.text("", "start_words")
        self.column.addWidget(self.start)
        self.thumbnail = Thumbnail()
        self.column.addWidget(self.thumbnail)
        self.use_view = self.button(
            "Use this view",
            "use_view",
            "Start from the frame that the sliders show.",
            self.use_current,
        )
        self.automatic = self.button(
            "Automatic",
            "automatic",
            "Start from the safest frame again, the star, and show it: that on which the frame "
            "alone and all frames together agree most.",
            self.start_automatically,
        )
        self.path = self.watched(
            ComboBox(
                name="path",
                choices=[(METHODS[method].label, method) for method in ORDERS],
                value=MANY_METHODS_PATH,
                tooltip="Whose way through the frames is drawn: first pass blue, second red. "
                f"{WAYS}.",
            )
        )
        for button in (self.use_view, self.automatic):
            button.setStyleSheet("padding: 4px 2px;")
        self.column.addLayout(
            self.row(self.use_view, self.automatic, self.label("Arrows"), self.path.native)
        )
        self.path.native.setMinimumContentsLength(LETTERS_OF_A_PATH)
        self.path.changed.connect(lambda _: self._show_path())
        self.map.frame_clicked.connect(
            lambda t, a, more: self.guarded(lambda: self._clicked(t, a, more=more))
        )
        self.map.frame_hovered.connect(self._describe)
        self.map.left.connect(self._describe_boundary)
        self.session.reconstruction_changed.connect(self._show)
        self.session.calibration_changed.connect(self._show)
        self.session.scores_changed.connect(self._show)
        self.session.recipe_changed.connect(self._show_boundary)
        self.session.recording_changed.connect(self._show)
        self._show()
        self._show_path()

    def frame_changed(self) -> None:
        """Outline the frame that the sliders show."""
        if self._shows_present_frames():
            self.map.set_current(self.presenter.current_frame())

    def _shows_present_frames(self) -> bool:
        """Say whether the map has been told of the phase that there is now."""
        data = self.session.reconstruction
        return data is not None and data is self._shown

    def use_current(self) -> None:
        """Start from the frame that the sliders show."""
        self.session.update(boundary=(self.presenter.current_frame(),))

    def start_automatically(self) -> None:
        """Start from the safest frame again, which may have to be looked for first."""
        self.session.needed_reconstruction()
        self.session.update(boundary="auto")
        if self.session.scores is None:
            self.jobs.start(plan_scores(self.session), then=self._show_best)
        else:
            self._show_best()

    def _show_best(self) -> None:
        scores = self.session.scores
        if scores is not None:
            self.presenter.go_to(*best_frame(scores))
            self.said.emit(f"{self.words_on_the_start()} {scores_sentence(scores)}")

    def words_on_the_start(self) -> str:
        """Say which frame a run would start from, and who chose it."""
        data = self.session.reconstruction
        if data is None:
            return ""
        frames = self.session.start_frames
        if not frames:
            return "Start: the safest frame, which is being looked for …"
        automatic = self.session.recipe.boundary == "auto"
        words = start_words(frames, found=automatic, of=data["phase"])
        if automatic or any(is_safe(self.session.scores, *frame) for frame in frames):
            return words
        scores = self.session.scores
        if scores is not None and any(np.isnan(scores.values[frame]) for frame in frames):
            return f"{words[:-1]}; how safe it is is not known."
        return f"{words[:-1]}, not safe: ★ is safer."

    def _clicked(self, time: int, angle: int, *, more: bool) -> None:
        """Start from the frame that was clicked on, or from that one too; show it."""
        boundary = self.session.start_frames
        if not more:
            boundary = ((time, angle),)
        elif (time, angle) not in boundary:
            boundary = (*boundary, (time, angle))
        elif len(boundary) > 1:
            boundary = tuple(frame for frame in boundary if frame != (time, angle))
        self.session.update(boundary=boundary)
        self.presenter.go_to(time, angle)
        self._describe(time, angle)

    def _show(self) -> None:
        """Show the frames that there are, with their scores."""
        data = self._shown = self.session.reconstruction
        self.start.setText(self.words_on_the_start())
        self.map.setEnabled(data is not None)
        if data is None:
            self.map.set_frames([], [])
            self.thumbnail.show_frame(None, "The frames appear here once there is phase.")
            return
        self.map.set_frames_of(data["phase"])
        scores = self.session.scores
        self.map.set_scores(None if scores is None else scores.values)
        self.map.set_best(None if scores is None else tuple(scores.attrs["best"]))
        self.map.setCursor(Qt.CursorShape.PointingHandCursor)
        self._show_boundary()
        self.frame_changed()

    def _show_boundary(self) -> None:
        if self._shows_present_frames():
            self.start.setText(self.words_on_the_start())
            self.map.set_boundaries(list(self.session.start_frames))
            self._describe_boundary()

    def _show_path(self) -> None:
        self.map.set_path(self.path.value)

    def show_path_of(self, method: str) -> None:
        """Draw the path of a method, where it has one."""
        if method in ORDERS:
            self.path.value = method

    def _describe_boundary(self) -> None:
        if self._shows_present_frames() and self.session.reconstruction is not None:
            time, angle = next(iter(self.session.start_frames), self.presenter.current_frame())
            shape = self.session.reconstruction["phase"].shape
            self._describe(min(time, shape[0] - 1), min(angle, shape[1] - 1))

    def _describe(self, time: int, angle: int) -> None:
        """Show one frame and say how safe it is."""
        data = self.session.reconstruction
        if data is None:
            return
        phase = data["phase"]
        chosen = (time, angle) in self.session.start_frames
        lines = [
            f"<b>{'Start: ' if chosen else ''}time {time} ({float(phase['time'][time]):.3g} s), "
            f"{view_of(phase, angle, 'angle ')}</b>",
            words_on_score(self.session.scores, time, angle),
        ]
        frame = np.asarray(phase.data[time, angle])
        mask = object_in(frame) if self.session.recipe.mask == "auto" else None
        self.thumbnail.show_frame(frame, "<br>".join(lines), mask)


#: Shares of the object on which methods agree, from which on a frame is safe, and rather safe.
SAFE, RATHER_SAFE = 0.99, 0.95


def is_safe(scores: Any, time: int, angle: int) -> bool:
    """Say whether a frame is at least rather safe, the safest, or nothing is known of it yet."""
    if scores is None or (time, angle) == tuple(scores.attrs["best"]):
        return True
    return float(scores.values[time, angle]) > RATHER_SAFE


def words_on_score(scores: Any, time: int, angle: int) -> str:
    """Say how safe a frame is, and why."""
    if scores is None:
        return "Its safety is being looked at …"
    score = float(scores.values[time, angle])
    if np.isnan(score):
        return "How safe it is is not known: it was not looked at, or shows nothing to judge by."
    best = (time, angle) == tuple(scores.attrs["best"])
    verdict = "safe" if score > SAFE else "rather safe" if score > RATHER_SAFE else "not safe"
    if best:
        verdict = "the safest"
    return (
        f"Score {score:.3f}, {verdict}: {scores.attrs['basis']} agree on about "
        f"{100 * score:.3g} % of the object."
    )
