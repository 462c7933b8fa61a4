"""Where the command line writes to, and how it shows results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from napari_phase4d.holography import (
    FoundLobes,
    Lobe,
    angles_unknown,
    find_lobes,
    lobe_warnings,
)
from napari_phase4d.io import write_figure
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Outcome, Recipe, start_sentence
from napari_phase4d.plotting import comparison_figure, named_results, telling_frames
from napari_phase4d.task import ProgressCall
from napari_phase4d.unwrapping import METHODS, left_out_advice
from napari_phase4d.words import counted, printable

__all__ = [
    "NOISE_FRAMES",
    "bar",
    "console",
    "errors",
    "print_cells",
    "print_lobes",
    "print_missed_views",
    "print_notes",
    "print_start",
    "print_table",
    "print_verdict",
    "write_picture",
]


class PlainConsole(Console):
    """A console whose colours are set by the program alone, whatever the names of files hold."""

    def render_str(self, text: str, **how: Any) -> Text:
        """Return a string as rich prints it, with what can't be printed as escapes."""
        return super().render_str("\n".join(map(printable, text.split("\n"))), **how)


console = PlainConsole(highlight=False, soft_wrap=True)
errors = PlainConsole(stderr=True, highlight=False, soft_wrap=True)


#: Methods that weigh pixels by the amplitude, where it is known.
WITH_AMPLITUDE = ("directional-l1", "directional-growing")
#: Frames from the beginning of which the noise is measured.
NOISE_FRAMES = 8


def print_missed_views(outcome: Outcome, recipe: Recipe) -> None:
    """Say if one view was looked for where there are several: it may be the beat of two."""
    if outcome.recording is None or recipe.lobes or len(outcome.recipe.lobes) != 1:
        return
    found = len(find_lobes(outcome.recording, None))
    if found > 1:
        name = escape(outcome.recording.name)
        console.print(
            f"[yellow]{name} shows {found} views, but 1 was asked for, which may be the beat of "
            "two; give --angle once for each view, or --views.[/yellow]"
        )


@contextmanager
def bar() -> Iterator[ProgressCall]:
    """Show progress as one line that moves."""
    with Progress(console=console, transient=True) as display:
        task = display.add_task("", total=None)

        def report(done: int, total: int, message: str) -> None:
            display.update(task, completed=done, total=total, description=message)

        yield report


def print_notes(outcome: Outcome, advice: Sequence[str]) -> None:
    """Say what had to be assumed, and what is to be looked after, see `advice_on`."""
    if outcome.recording is not None:
        notes = list(outcome.recording.notes)
        notes += [f"{each[0].upper()}{each[1:]}." for each in advice]
    else:
        notes = list(outcome.reconstruction["phase"].attrs.get("notes", ()))
        unaided = [METHODS[m].label for m in WITH_AMPLITUDE if m in outcome.comparison.results]
        if unaided:
            notes.append(f"{' and '.join(unaided)} without the amplitude, which holograms give.")
    for result in outcome.comparison.results.values():
        if left_out := left_out_advice(result.attrs):
            notes.append(f"{left_out} (--whole-field).")
            break
    for note in notes:
        console.print(f"[yellow]{escape(note)}[/yellow]")


def print_start(outcome: Outcome) -> None:
    """Say which frame unwrapping started from."""
    console.print(start_sentence(outcome.recipe, outcome.scores))


def print_lobes(lobes: Sequence[Lobe], optics: Optics | None = None) -> None:
    """Print the views as a table, with warnings."""
    if not lobes:
        return
    table = Table(title="Views", title_justify="left")
    named = any(lobe.wavelength_um is not None for lobe in lobes)
    headings = ["view", "ky (1/px)", "kx (1/px)", "radius (1/px)", "angle (deg)", "flipped"]
    for heading in headings + ["wavelength (um)"] * named:
        table.add_column(heading, justify="right")
    unknown = angles_unknown(lobes)
    for i, lobe in enumerate(lobes, start=1):
        ky, kx = lobe.carrier
        angle = "?" if unknown else f"{lobe.angle_deg:g}"
        row = [str(i), f"{ky:.4f}", f"{kx:.4f}", f"{lobe.radius:.4f}", angle]
        light = "" if lobe.wavelength_um is None else f"{lobe.wavelength_um:g}"
        table.add_row(*row, "yes" if lobe.flip else "no", *[light] * named)
    console.print(table)
    if unknown:
        console.print(
            "A hologram can't tell the viewing angles: name them with run --angle, or views are "
            "numbered."
        )
    doubts = lobes.doubts if isinstance(lobes, FoundLobes) else ()
    own = None if optics is None else optics.wavelength_um
    for warning in (*doubts, *lobe_warnings(lobes, own)):
        console.print(f"[yellow]{warning}[/yellow]")


HEADINGS = {
    "seconds": "seconds",
    "peak_mb": "peak memory (MB)",
    "paper_mse_rad2": "paper's MSE (rad²)",
    "mse_rad2": "MSE (rad²)",
    "phasetools_mse_rad2": "as in PhaseTools",
    "wrong_cycles_percent": "wrong by a cycle (%)",
}


def print_table(frame: pd.DataFrame, title: str = "Unwrapping") -> None:
    """Print the comparison."""
    table = Table(title=title, title_justify="left")
    for column in frame.columns:
        table.add_column(
            HEADINGS.get(column, column), justify="left" if column == "method" else "right"
        )
    for row in frame.itertuples(index=False):
        table.add_row(*(cell(value) for value in row))
    console.print(table)


#: Columns of the summary of cells that are printed, with their headings and digits.
OF_CELLS = {
    "cell": ("cell", ".0f"),
    "parent": ("parent", ".0f"),
    "from (s)": ("from (s)", ".3g"),
    "to (s)": ("to (s)", ".3g"),
    "dry mass (pg)": ("dry mass (pg)", ".2f"),
    "dry mass error (pg)": ("+/-", ".2f"),
    "area (um^2)": ("area (um²)", ".1f"),
    "mass density (pg/um^2)": ("pg/um²", ".3f"),
    "volume (um^3)": ("volume (um³)", ".1f"),
    "speed (um/s)": ("speed (um/s)", ".2f"),
}
#: Cells of which a line is printed; the files have all.
MOST_CELLS = 40


def print_cells(outcome: Outcome) -> None:
    """Print a line for each cell, where cells were looked for."""
    if outcome.cells is None:
        return
    summary, label = outcome.cells.summary, METHODS[outcome.cells.method].label
    if summary.empty:
        console.print(f"[yellow]No cells were found in the result of {label}.[/yellow]")
        return
    many = f"{counted(len(summary), 'cell')} in the result of {label}; medians over its frames"
    table = Table(title=many, title_justify="left")
    columns = {name: look for name, look in OF_CELLS.items() if name in summary}
    for heading, _ in columns.values():
        table.add_column(heading, justify="right")
    for row in summary.head(MOST_CELLS).to_dict("records"):
        cells = ((name, float(row[name]), digits) for name, (_, digits) in columns.items())
        table.add_row(
            *(
                "" if value != value or (name == "parent" and not value) else f"{value:{digits}}"
                for name, value, digits in cells
            )
        )
    console.print(table)
    if outcome.recipe.cells is not None and outcome.recipe.cells.oblique:
        console.print("Phase of oblique views is multiplied by the cosine of their angle.")


def print_verdict(outcome: Outcome) -> None:
    """Say which result to use and how far; of results on disk if maps of confidence were made."""
    if outcome.comparison.held or outcome.recipe.confidence:
        console.print(f"[bold]{escape(outcome.comparison.verdict)}[/bold]")


def cell(value: object) -> str:
    """Return a value as it stands in a table."""
    if isinstance(value, str | int):
        return str(value)
    number = float(str(value))
    return "" if number != number else f"{number:.3f}"


def write_picture(outcome: Outcome, exact: xr.DataArray | None, path: Path) -> Path:
    """Write a picture of all results at some frames."""
    frames = telling_frames(outcome.reconstruction["phase"], outcome.recipe.start_frames[0])
    return write_figure(path, comparison_figure(named_results(outcome.comparison, exact), frames))
