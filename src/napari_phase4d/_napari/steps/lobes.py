"""Step 2: find the views in the Fourier spectrum, and correct them by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from magicgui.widgets import ComboBox
from qtpy.QtCore import QElapsedTimer, QTimer, Signal

from napari_phase4d._napari.session import plan_lobes, with_known_views
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.widgets.section import Turning
from napari_phase4d._napari.widgets.spectrum_canvas import LobeTable, SpectrumCanvas, changed_lobe
from napari_phase4d._napari.widgets.view_strip import ViewStrip
from napari_phase4d.holography import (
    MAX_VIEWS,
    FoundLobes,
    Lobe,
    Preview,
    angles_unknown,
    lobe_warnings,
    pair_distance,
)
from napari_phase4d.later import xr
from napari_phase4d.recording import Recording

__all__ = ["LobesStep"]

#: The preview follows the mouse, but no oftener than this.
PREVIEW_EVERY_MS = 15
#: Width of the preview next to the spectrum, in pixels.
PREVIEW_WIDTH = 124
SPECTRUM_HEIGHT = 232
#: Where a further circle is put, and its radius if it is the first, in cycles per pixel.
NEW_CARRIER, NEW_RADIUS = (0.25, 0.0), 0.08
#: Degrees from one place that is tried for it to the next.
TURN_DEG = 30
#: Said first of what was in doubt, where the other choice has been taken.
OTHER_TAKEN = "This is the other choice. Of the first it was said:"


def free_place(lobes: Sequence[Lobe]) -> tuple[float, float]:
    """Return a carrier (ky, kx) at which neither a circle lies nor the one opposite."""
    far = math.hypot(*NEW_CARRIER)
    turned = [math.radians(turn) for turn in range(0, 180, TURN_DEG)]
    places = [NEW_CARRIER, *((far * math.cos(a), far * math.sin(a)) for a in turned)]

    def nearest(place: tuple[float, float]) -> float:
        return min((pair_distance(lobe.carrier, place) for lobe in lobes), default=math.inf)

    clear = [p for p in places if nearest(p) > (lobes[0].radius if lobes else NEW_RADIUS)]
    return clear[0] if clear else max(places, key=nearest)


class LobesStep(Step):
    """Spectrum with circles, the wrapped phase they give, a table, and warnings.

    Signals
    -------
    settled()
        The views have been found, and nothing in them is in doubt.
    """

    settled = Signal()

    title = "2  Lobes"
    purpose = (
        "Each view is a bright spot away from the middle. Press Find, or drag the circles: "
        "inside to move, on the line to resize."
    )
    grows = True

    def build(self) -> None:
        """Make the widgets."""
        self._drawn: xr.DataArray | None = None
        #: What was found first, and the other choice; and the views of each when it was left.
        self._choices: tuple[FoundLobes, ...] = ()
        self._left: list[list[Lobe]] = []
        self._previewed: tuple[Recording, int, Preview] | None = None
        self._build_buttons()
        self.canvas = SpectrumCanvas()
        self.canvas.setMinimumHeight(SPECTRUM_HEIGHT)
        self.canvas.setToolTip(
            "Brightness: power on a logarithmic scale. Drag a circle, or choose it and use the "
            "arrow keys; double click to add one; wheel to zoom."
        )
        self.strip = ViewStrip()
        self.strip.setToolTip("Wrapped phase of the frame on screen, as the circles give it.")
        self.column.addWidget(Turning(self.canvas, self.strip, PREVIEW_WIDTH), 1)
        self.frequency = self.text("", "frequency")
        self.column.addWidget(self.frequency)
        self.table = LobeTable()
        self.column.addWidget(self.table)
        self.warnings = self.text("", "lobe_warnings")
        self.column.addWidget(self.warnings)
        self.other = self.button(
            "Try the other choice",
            "other_lobes",
            "Take the next best choice of views; press again to come back.",
            self.take_other,
        )
        self.other.setVisible(False)
        self.column.addLayout(self.row(self.other))
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._since_preview = QElapsedTimer()
        self._timer.timeout.connect(self._show_preview)
        self._listen()
        self._show()

    def _build_buttons(self) -> None:
        self.n_views = self.watched(
            ComboBox(
                name="n_views",
                choices=[("auto", 0), *((str(n), n) for n in range(1, MAX_VIEWS + 1))],
                value=0,
                tooltip=f"Multiplexed views, 1 to {MAX_VIEWS}; auto counts them.",
            )
        )
        self.when_changed(
            self.n_views, lambda: self.session.update(n_views=self.n_views.value or None)
        )
        self.find = self.button("Find", "find_lobes", "Look for the views.", self.find_lobes)
        self.add = self.button("Add", "add_lobe", "One more circle, to drag.", self.add_lobe)
        self.remove = self.button(
            "Remove", "remove_lobe", "Remove the chosen view, or the last.", self.remove_lobe
        )
        self.flip = self.button(
            "Flip",
            "flip_lobe",
            "Take the conjugate of the chosen view: where a dense object looks dark.",
            self.flip_lobe,
        )
        self.undo = self.button(
            "Undo", "undo_lobes", "Take back the last change.", self.session.undo_lobes
        )
        self.column.addLayout(self.row(self.label("Views"), self.n_views.native, self.find))
        self.column.addLayout(self.row(self.add, self.remove, self.flip, self.undo))

    def _listen(self) -> None:
        self.canvas.lobes_edited.connect(
            lambda lobes: self.session.set_lobes(lobes, undoable=False)
        )
        self.canvas.edit_started.connect(self.session.remember_lobes)
        self.canvas.frequency_shown.connect(self._show_frequency)
        self.canvas.left.connect(self.frequency.clear)
        self.canvas.selected.connect(self._select)
        self.canvas.removal_wanted.connect(lambda i: self.guarded(lambda: self._remove(i)))
        self.canvas.place_wanted.connect(lambda ky, kx: self.guarded(lambda: self._place(ky, kx)))
        self.table.typed.connect(
            lambda row, column, item: self.guarded(lambda: self._typed(row, column, item))
        )
        self.table.itemSelectionChanged.connect(
            lambda: self.canvas.select(self.table.currentRow())
        )
        self.session.recording_changed.connect(self._show)
        self.session.spectrum_changed.connect(self._show)
        self.session.lobes_changed.connect(self._show)
        self.session.recipe_changed.connect(self._show_settings)

    def frame_changed(self) -> None:
        """Let the preview follow the time slider."""
        self._start()

    def find_lobes(self) -> None:
        """Find the views, in a thread."""
        self.jobs.start(plan_lobes(self.session), then=self._go_on)

    def _go_on(self) -> None:
        if not self.doubts():
            self.settled.emit()

    def add_lobe(self) -> None:
        """Add a view where there is none yet."""
        self._place(*free_place(self.session.lobes))

    def _place(self, ky: float, kx: float) -> None:
        """Add a view at a frequency."""
        self.session.needed_recording()
        lobes = self.session.lobes
        if len(lobes) >= MAX_VIEWS:
            msg = f"{len(lobes)} views are the most that can be worked on; remove one first"
            raise ValueError(msg)
        radius = lobes[0].radius if lobes else NEW_RADIUS
        angle = max((lobe.angle_deg for lobe in lobes), default=-1.0) + 1
        self.session.set_lobes([*lobes, Lobe((ky, kx), radius, angle)])
        self.canvas.select(len(lobes))

    def remove_lobe(self) -> None:
        """Remove the chosen view, or the last one."""
        if not self.session.lobes:
            msg = "there is no lobe to remove"
            raise ValueError(msg)
        self._remove(self._chosen())

    def _remove(self, index: int) -> None:
        lobes = self.session.lobes
        lobes.pop(index)
        self.session.set_lobes(lobes)

    def flip_lobe(self) -> None:
        """Take the conjugate of the chosen view, or of the last one."""
        lobes = self.session.lobes
        if not lobes:
            msg = "there is no lobe to flip; press Find first"
            raise ValueError(msg)
        index = self._chosen()
        lobes[index] = replace(lobes[index], flip=not lobes[index].flip)
        self.session.set_lobes(lobes)

    def _chosen(self) -> int:
        """Return the number of the chosen view, of the last one if none is."""
        row = self.table.currentRow()
        return row if 0 <= row < len(self.session.lobes) else len(self.session.lobes) - 1

    def _select(self, index: int) -> None:
        """Choose in the table what is chosen in the spectrum."""
        if index >= 0 and index != self.table.currentRow():
            self.table.selectRow(index)

    def _typed(self, row: int, column: int, item: Any) -> None:
        """Take what was typed into the table; a wrong number leaves all as it was."""
        lobes = self.session.lobes
        try:
            lobes[row] = changed_lobe(lobes[row], column, item)
            self.session.set_lobes(lobes)
        finally:
            self._show()

    def _show_settings(self) -> None:
        with self.own_change():
            self.n_views.value = self.session.recipe.n_views or 0

    def _show(self) -> None:
        lobes = self.session.lobes
        self._follow_undo()
        if self._drawn is not self.session.spectrum:
            self._drawn = self.session.spectrum
            self.canvas.set_spectrum(self._drawn)
        self.canvas.set_lobes(lobes)
        self.table.fill(lobes)
        self.warnings.setText("<br>".join(f"⚠ {words}" for words in self.doubts()))
        self.warnings.setVisible(bool(self.warnings.text()))
        found = self._as_found()
        self.other.setVisible(found is not None and bool(found.other))
        self._follow()

    def _as_found(self) -> FoundLobes | None:
        """Return what was found, while its circles stay as they were found."""
        found = self.session.found
        return found if found is not None and at_same(found, self.session.lobes) else None

    def _choice(self) -> int | None:
        """Return which of the two choices is taken: 0 for the first; None before the second."""
        found = self.session.found
        return next((n for n, choice in enumerate(self._choices) if choice is found), None)

    def _follow_undo(self) -> None:
        """Let that choice be taken whose circles have come back, with what is said of it."""
        if self._choice() is not None and self._as_found() is None:
            lobes = self.session.lobes
            back = next((choice for choice in self._choices if at_same(choice, lobes)), None)
            self.session.found = back or self.session.found

    def doubts(self) -> Sequence[str]:
        """Return what the finder could not know, and which circles can't be right."""
        found = self._as_found()
        recording = self.session.recording
        own = None if recording is None else recording.optics.wavelength_um
        return (*(found.doubts if found else ()), *lobe_warnings(self.session.lobes, own))

    def take_other(self) -> None:
        """Take the next best choice of views; the same button comes back."""
        found = self.session.found
        if found is None or not found.other:
            msg = "there is no other choice of views"
            raise ValueError(msg)
        now = self._choice()
        if now is None:
            doubts = (f"{OTHER_TAKEN} {found.doubts_of_views[-1]}",)
            second = FoundLobes(found.other, 1 - found.chance, doubts, list(found))
            self._choices, self._left, now = (found, second), [list(found), list(second)], 0
        wanted, lobes = 1 - now, self.session.lobes
        if at_same(self._choices[now], lobes):  # with the angles that were typed in
            self._left[now] = lobes
        self.session.found = self._choices[wanted]
        self.session.set_lobes(with_known_views(self._left[wanted], lobes))

    def _start(self) -> None:
        """Show the preview soon; moves that follow each other must not put it off."""
        if not self._timer.isActive():
            shown = self._since_preview
            passed = int(shown.elapsed()) if shown.isValid() else 0
            self._timer.start(max(0, PREVIEW_EVERY_MS - passed))

    def _follow(self) -> None:
        """Show the preview of moved circles with them, in one picture, if the last is old enough.

        Where the window is painted without a graphics card, each picture takes 10 ms.
        """
        known = self._previewed
        old = self._since_preview.isValid() and self._since_preview.hasExpired(PREVIEW_EVERY_MS)
        if old and known is not None and known[0] is self.session.recording:
            self._show_preview()
        else:
            self._start()

    def showEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        """Bring the preview up to date when the step is opened."""
        super().showEvent(event)
        self._start()

    def _show_preview(self) -> None:
        """Show the wrapped phase of the frame on screen, while the step is open."""
        self._since_preview.start()
        if not self.isVisible():
            return
        lobes, recording = self.session.lobes, self.session.recording
        if recording is None or not lobes:
            self.strip.set_views([], [])
            return
        try:
            frame = self.presenter.current_time()
            distance = self.session.recipe.refocus_um
            phases = self._preview_of(recording, frame).phases(
                lobes,
                self.session.recipe.window,
                refocus_um=distance if isinstance(distance, float) else 0.0,
                optics=recording.optics,
            )
        except (OSError, ValueError):  # such as a circle that is being dragged out of the plane
            self.strip.set_views([], [])
            return
        unknown = angles_unknown(lobes)
        captions = [f"{i + 1}: {caption_of(lobe, unknown)}" for i, lobe in enumerate(lobes)]
        self.strip.set_views(phases, captions)

    def _preview_of(self, recording: Recording, frame: int) -> Preview:
        """Return the preview of a frame; its transform is kept while the frame stays."""
        known = self._previewed
        if known is None or known[0] is not recording or known[1] != frame:
            self._previewed = (recording, frame, Preview(recording.raw_frame(frame)))
        return self._previewed[2]  # type: ignore[index] # set above

    def _show_frequency(self, ky: float, kx: float) -> None:
        words = f"mouse at ky {ky:+.3f}, kx {kx:+.3f} cycles/px"
        recording = self.session.recording
        if recording is not None:
            pixel = recording.optics.pixel_um
            words += f" = {ky / pixel:+.2f}, {kx / pixel:+.2f} cycles/µm"
        self.frequency.setText(words)


def at_same(some: Sequence[Lobe], others: Sequence[Lobe]) -> bool:
    """Say whether two choices of views have the same carriers."""
    return [lobe.carrier for lobe in some] == [lobe.carrier for lobe in others]


def caption_of(lobe: Lobe, unknown: bool) -> str:
    """Return the angle of a view in a few letters, or its wavelength where it has its own."""
    if lobe.wavelength_um is None:
        return "?" if unknown else f"{lobe.angle_deg:g}°"
    return f"{1000 * lobe.wavelength_um:g} nm"
