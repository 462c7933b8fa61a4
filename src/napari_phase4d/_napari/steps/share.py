"""The tab of step 5 that saves and shares."""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from magicgui.widgets import FloatSpinBox
from qtpy.QtGui import QGuiApplication
from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.session import Plan, plan_saving
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.viewing.pointing import table_of_regions
from napari_phase4d.analysis import in_memory
from napari_phase4d.io import OME_TIFF, write_figure, write_movie
from napari_phase4d.later import xr
from napari_phase4d.plotting import (
    EXACT,
    comparison_figure,
    movie_frames,
    named_results,
    phase_limits,
    telling_frames,
)
from napari_phase4d.task import Task

__all__ = ["SharePart", "folder_without_results"]

MOVIES = "MP4 (*.mp4);;GIF (*.gif)"
FIGURES = "PNG (*.png);;SVG (*.svg)"
RECIPES = "Recipe (*.json)"


class SharePart(Step):
    """Everything to files, a movie, a figure, the recipe, a script."""

    title = "Save"
    summary = "Files are written whole or not at all."

    def build(self) -> None:
        """Make the widgets."""
        self.save = self.button(
            "Save everything…",
            "save_results",
            "Phase, amplitude and every result as OME-TIFF with times, angles and pixel, tables, "
            "measurements and regions as CSV, and the recipe, into a folder.",
            self._ask_folder,
        )
        self.movie = self.button(
            "Movie…",
            "save_movie",
            "All results over time, a row for each viewing angle: MP4 or GIF.",
            lambda: self._ask_file("Movie", movie_name(), MOVIES, self.save_movie),
        )
        self.rate = self.watched(
            FloatSpinBox(
                name="movie_rate",
                value=6,
                min=0.1,
                max=50,
                step=1,
                tooltip="Frames per second of the movie.",
            )
        )
        self.rate.native.setSuffix(" frames/s")
        self.figure = self.button(
            "Figure…",
            "save_figure",
            "All results at the thin frame, the frame on screen and the last one: PNG or SVG.",
            lambda: self._ask_file("Figure", "comparison.png", FIGURES, self.save_figure),
        )
        self.recipe = self.button(
            "Recipe…",
            "save_recipe",
            "All settings, to open again in step 1 or to run in a terminal.",
            lambda: self._ask_file("Recipe", "recipe.json", RECIPES, self.save_recipe),
        )
        self.script = self.button(
            "Copy as Python",
            "copy_script",
            "A script on the clipboard that computes every array again, bit for bit.",
            self.copy_script,
        )
        self.column.addWidget(self.save)
        self.column.addLayout(self.row(self.movie, self.rate.native))
        self.column.addWidget(self.figure)
        self.column.addLayout(self.row(self.recipe, self.script))
        self.column.addStretch()

    def save_to(self, folder: str | Path) -> None:
        """Write all results into a folder, in a thread."""
        regions = table_of_regions(self.presenter.viewer.layers)
        self.jobs.start(
            plan_saving(self.session, folder, regions),
            then=lambda: self.said.emit(f"All results are in {folder}; step 1 opens them again."),
        )

    def save_movie(self, path: str | Path) -> None:
        """Write a movie of all results, in a thread."""
        stacks, rate = self.stacks(), float(self.rate.value)
        n_frames = len(next(iter(stacks.values())))

        def work(task: Task) -> Path:
            shown = [stacks[EXACT]] if EXACT in stacks else list(stacks.values())
            some = [in_memory(s[:: max(1, len(s) // 16), :, ::2, ::2]).values for s in shown]
            limits = phase_limits(some)
            frames = movie_frames(stacks, limits, title=self.session.name)
            return write_movie(path, frames, rate, n_frames=n_frames, **task.calls)

        self._start(Path(path), work, "The movie is")

    def save_figure(self, path: str | Path) -> None:
        """Write a figure of all results at some frames, in a thread."""
        stacks = self.stacks()
        outcome, frame = self.session.needed_outcome(), self.presenter.current_frame()
        phase = outcome.reconstruction["phase"]
        frames = telling_frames(phase, outcome.recipe.start_frames[0], frame)
        self._start(
            Path(path),
            lambda *_: write_figure(path, comparison_figure(stacks, frames)),
            "The figure is",
        )

    def save_recipe(self, path: str | Path) -> None:
        """Write all settings."""
        self.session.recipe.to_file(path)
        self.said.emit(f"The recipe is in {path}.")

    def copy_script(self) -> None:
        """Put a script on the clipboard that computes the results again."""
        QGuiApplication.clipboard().setText(self.session.script())
        self.said.emit("The script is on the clipboard; paste it into a file and run it.")

    def stacks(self) -> dict[str, xr.DataArray]:
        """Return what is compared: the truth, where it is known, and every result by its name."""
        comparison = self.session.needed_outcome().comparison
        return named_results(comparison, self.session.truth)

    def _start(
        self,
        path: Path,
        write: Callable[[Task], Any],
        words: str,
    ) -> None:
        def say() -> None:
            self.said.emit(f"{words} in {path}.")

        self.jobs.start(Plan(f"Saving to {path}", write, lambda _: None), then=say)

    def _ask_folder(self) -> None:
        self.session.needed_outcome()
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        if folder:
            self.save_to(folder_without_results(Path(folder), self.session.recipe.recording))

    def _ask_file(self, title: str, name: str, filters: str, save: Callable[[str], None]) -> None:
        if name != "recipe.json":
            self.session.needed_outcome()
        path, _ = QFileDialog.getSaveFileName(self, title, name, filters)
        if path:
            save(path)


def movie_name() -> str:
    """Return what a movie is called at first; MP4 only where it can be written."""
    return "comparison.mp4" if importlib.util.find_spec("av") else "comparison.gif"


def folder_without_results(folder: Path, recording: str = "") -> Path:
    """Return a folder, or a new one in it where results of another run would be replaced.

    So too where it holds the frames of the recording, which results would be taken for.
    """
    is_input = bool(recording) and folder.resolve() == Path(recording).resolve()
    if (
        not is_input
        and not any(folder.glob(f"*{OME_TIFF}"))
        and not (folder / "recipe.json").exists()
    ):
        return folder
    names = (folder / f"results_{number}" for number in itertools.count(1))
    return next(name for name in names if not name.exists())
