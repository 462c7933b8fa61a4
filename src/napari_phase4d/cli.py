"""The command line: napari-phase4d demo | info | run | compare | reproduce."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
import xarray as xr
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from napari_phase4d.evaluation import (
    best_known,
    comparison_figure,
    itoh_margin,
    named_results,
    order_shares,
    order_verdict,
    residues,
    telling_frames,
)
from napari_phase4d.holography import Lobe, find_lobes, lobe_warnings
from napari_phase4d.io import open_phase, write_figure
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import (
    Outcome,
    Recipe,
    found_anywhere,
    needed_bytes,
    open_by,
    run,
    working_bytes,
    write_outcome,
)
from napari_phase4d.progress import ProgressCall
from napari_phase4d.recording import Recording
from napari_phase4d.sample import euglena_sample
from napari_phase4d.unwrapping import METHODS, score_boundaries

__all__ = ["app", "main"]

app = typer.Typer(
    help="From a multiplexed off-axis hologram video to unwrapped phase.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
console = Console(highlight=False, soft_wrap=True)
errors = Console(stderr=True, highlight=False, soft_wrap=True)


def main() -> None:
    """Run the command line; a wrong input ends it with one sentence instead of a traceback."""
    try:
        app()
    except (OSError, TypeError, ValueError) as error:
        errors.print(f"[red]Error:[/red] {escape(str(error))}")
        raise SystemExit(1) from None


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for pictures and results.")] = Path(
        "demo_output"
    ),
    headless: Annotated[
        bool, typer.Option("--headless", help="Run to the end without waiting for a user.")
    ] = False,
) -> None:
    """Show the whole chain on a simulated hologram video of a swimming euglena."""
    if not headless:
        from napari_phase4d._napari.demo import open_demo

        open_demo()
        return
    console.print("Simulating a hologram video: a euglena, two views, 40 frames ...")
    sample = euglena_sample()
    recipe = Recipe(
        recording=sample.recording.source,
        angles_deg=sample.angles_deg,
        boundary=(sample.boundary,),
    )
    with bar() as progress:
        plain = run(recipe, sample.recording, progress=progress)
        truth = sample.truth(plain.reconstruction["phase"])
        outcome = run(plain.recipe, sample.recording, truth, progress)
    print_lobes(outcome.recipe.lobes)
    print_table(outcome.comparison.table)
    written = write_outcome(outcome, out)
    picture = out / "comparison.png"
    write_picture(outcome, truth, picture)
    from napari_phase4d._napari.demo import picture_of_the_window

    screenshot = picture_of_the_window(out / "window.png")
    console.print(f"\nResults are in [bold]{out.resolve()}[/bold]:")
    for path in [screenshot, picture, *written]:
        console.print(f"  {path.name}")


# Options that several commands have.
Views = Annotated[int | None, typer.Option(help="Number of views, 1 to 6.")]
Angles = Annotated[
    list[float] | None, typer.Option(help="Viewing angle in degrees; once for each view.")
]
Boundary = Annotated[
    str | None, typer.Option(help="Optically thin frame as TIME,ANGLE, counted from 0.")
]
Confidence = Annotated[
    bool, typer.Option(help="Also write how far to trust each pixel of each result.")
]


@app.command()
def info(
    file: Annotated[
        Path,
        typer.Argument(
            help="Hologram video: TIFF, folder of images, NPY, NPZ; or sample:euglena, "
            "sample:yeast."
        ),
    ],
    views: Annotated[int, typer.Option(help="Number of views to look for, 1 to 6.")] = 2,
    dataset: Annotated[str | None, typer.Option(help="Which array of an NPZ file.")] = None,
) -> None:
    """Say what a recording holds, where its lobes are, and what a run would need."""
    recording = open_by(Recipe(recording=str(file), dataset=dataset))
    if isinstance(recording, xr.DataArray):
        print_phase(file, recording)
        return
    height, width = recording.frame_shape
    first = recording.frame(0)
    console.print(f"[bold]{escape(recording.name)}[/bold]")
    console.print(
        f"  {recording.n_frames} frames of {height} x {width} pixels, "
        f"{recording.holograms.dtype}, {megabytes(recording.nbytes)}"
    )
    console.print(
        f"  pixel in the sample {recording.optics.pixel_um:.4g} um, "
        f"wavelength {recording.optics.wavelength_um:.4g} um, {rate_of(recording)}"
    )
    console.print(f"  first frame: {first.min():g} to {first.max():g}, mean {first.mean():.4g}")
    for note in recording.notes:
        console.print(f"  [yellow]{escape(note)}[/yellow]")
    try:
        lobes = find_lobes(recording, views)
    except ValueError as error:
        console.print(f"  [yellow]{escape(str(error))}[/yellow]")
        return
    print_lobes(lobes)
    console.print(
        f"A run with all {len(METHODS)} methods needs about "
        f"{megabytes(needed_bytes(recording, lobes, list(METHODS)))} of memory."
    )


def print_phase(file: Path, phase: xr.DataArray) -> None:
    """Say what a file of wrapped phase holds."""
    n_times, n_angles, height, width = phase.shape
    console.print(f"[bold]{escape(file.name)}[/bold]")
    console.print(
        f"  wrapped phase, {n_times} times, {n_angles} views of {height} x {width} pixels"
    )
    angles = ", ".join(f"{a:g}" for a in phase["angle"].values)
    console.print(f"  viewing angles {angles} degrees; {int(abs(residues(phase)).sum())} residues")
    for note in phase.attrs.get("notes", ()):
        console.print(f"  [yellow]{escape(note)}[/yellow]")
    scores = score_boundaries(phase)
    time, view = scores.attrs["best"]
    console.print(
        f"  safest boundary frame {time},{view}: {scores.attrs['basis']} agree on "
        f"{100 * scores.attrs['agreement']:.2f} % of the object"
    )
    need = working_bytes(phase.nbytes, list(METHODS), frame=phase[0, 0].nbytes)
    console.print(
        f"A run with all {len(METHODS)} methods needs about {megabytes(need)} of memory."
    )


@app.command("run")
def run_command(
    inputs: Annotated[
        list[Path], typer.Argument(help="Hologram videos; a .json among them is the recipe.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_output"),
    views: Views = None,
    angle: Angles = None,
    boundary: Boundary = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Method id; may be given several times.")
    ] = None,
    wavelength: Annotated[float | None, typer.Option(help="Wavelength in um.")] = None,
    camera_pixel: Annotated[float | None, typer.Option(help="Camera pixel in um.")] = None,
    magnification: Annotated[float | None, typer.Option(help="From sample to camera.")] = None,
    frame_rate: Annotated[float | None, typer.Option(help="Frames per second.")] = None,
    *,
    confidence: Confidence = False,
) -> None:
    """Take recordings from file to unwrapped phase, table and recipe."""
    recipe, files = recipe_and_files(inputs)
    recipe = with_settings(
        recipe, views, angle, boundary, method, frame_rate, confidence=confidence
    )
    numbers = {
        "wavelength_um": wavelength,
        "camera_pixel_um": camera_pixel,
        "magnification": magnification,
    }
    typed = {name: number for name, number in numbers.items() if number is not None}
    if not files:
        process(recipe, typed, out)
    else:
        batch(
            lambda file, folder: process(
                recipe.changed(recording=found_anywhere(file)), typed, folder
            ),
            files,
            out,
        )


@app.command("compare")
def compare_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="Wrapped phase (OME-TIFF of this program, NPY, NPZ, TIFF) or hologram videos; "
            "a .json among them is the recipe."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_compare"),
    truth: Annotated[
        Path | None, typer.Option(help="Exact or published phase on the same grid.")
    ] = None,
    views: Views = None,
    angle: Angles = None,
    boundary: Boundary = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Method id; default: all of them.")
    ] = None,
    *,
    confidence: Confidence = False,
) -> None:
    """Put all methods side by side: table, picture, and where unwrapping has to fail."""
    recipe, files = recipe_and_files(inputs)
    all_methods = None if any(p.suffix == ".json" for p in inputs) else list(METHODS)
    recipe = with_settings(
        recipe, views, angle, boundary, method or all_methods, None, confidence=confidence
    )
    exact = None if truth is None else open_phase(truth)
    if not files and not recipe.recording:
        msg = "give at least one file to compare the methods on"
        raise ValueError(msg)

    def compare_one(file: Path, folder: Path) -> None:
        with bar() as progress:
            outcome = run(
                recipe.changed(recording=found_anywhere(file)), truth=exact, progress=progress
            )
        print_notes(outcome)
        print_table(outcome.comparison.table)
        print_itoh(outcome, exact)
        written = write_outcome(outcome, folder)
        picture = folder / "comparison.png"
        write_picture(outcome, exact, picture)
        console.print(f"{len(written) + 1} files written to [bold]{folder.resolve()}[/bold]")

    batch(compare_one, files or [Path(recipe.recording)], out)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures, table and movies.")] = Path(
        "reproduction"
    ),
    movies: Annotated[bool, typer.Option(help="Also write the movies.")] = True,
) -> None:
    """Reproduce the paper's table, its Figs. 2 and 4, and its visualizations."""
    from napari_phase4d.reproduction import reproduce as reproduce_all
    from napari_phase4d.reproduction import write_reproduction

    with bar() as progress:
        found = reproduce_all(progress)
        print_table(found.table, "Budding yeast, 6 angles, 19 times")
        written = write_reproduction(found, out, movies=movies, progress=progress)
    console.print(f"{len(written)} files written to [bold]{out.resolve()}[/bold]:")
    for path in written:
        console.print(f"  {path.name}")


def recipe_and_files(inputs: Sequence[Path]) -> tuple[Recipe, list[Path]]:
    """Tell the recipe from the recordings."""
    recipes = [p for p in inputs if p.suffix == ".json"]
    if len(recipes) > 1:
        msg = "give one recipe at most"
        raise ValueError(msg)
    recipe = Recipe.from_file(recipes[0]) if recipes else Recipe()
    return recipe, [p for p in inputs if p.suffix != ".json"]


def with_settings(
    recipe: Recipe,
    views: int | None,
    angles: Sequence[float] | None,
    boundary: str | None,
    methods: Sequence[str] | None,
    frame_rate: float | None,
    *,
    confidence: bool = False,
) -> Recipe:
    """Return a recipe with what was typed in."""
    changes: dict[str, object] = {
        "n_views": len(angles) if angles and views is None else views,
        "angles_deg": tuple(angles) if angles else None,
        "methods": tuple(methods) if methods else None,
        "frame_rate_hz": frame_rate,
        "boundary": (frame_numbers(boundary),) if boundary else None,
        "confidence": confidence or None,
    }
    return recipe.changed(**{k: v for k, v in changes.items() if v is not None})


def batch(work: Callable[[Path, Path], None], files: Sequence[Path], out: Path) -> None:
    """Work on each file; of several, one that fails does not stop the others."""
    if len(files) == 1:
        work(files[0], out)
        return
    failed = []
    for file, folder in zip(files, result_folders(files, out), strict=True):
        console.print(f"[bold]{escape(file.name)}[/bold]")
        try:
            work(file, folder)
        except (OSError, TypeError, ValueError) as error:
            failed.append(file.name)
            errors.print(f"[red]Error:[/red] {escape(str(error))}")
    if failed:
        msg = f"{len(failed)} of {len(files)} files failed: {', '.join(failed)}"
        raise ValueError(msg)


def result_folders(files: Sequence[Path], out: Path) -> list[Path]:
    """Return a folder for every file: its name, numbered where two files share it."""
    folders: list[Path] = []
    for file in files:
        candidates = (
            out / f"{file.stem.replace(':', '_')}{end}"
            for end in ("", *(f"_{i}" for i in range(2, 10**6)))
        )
        folders.append(next(c for c in candidates if c not in folders))
    return folders


def process(recipe: Recipe, typed: dict[str, float], folder: Path) -> None:
    """Run one recording, with the optics that were typed in, and write what comes out."""
    if typed and recipe.recording:
        known = recipe.optics or optics_of(open_by(recipe))
        recipe = recipe.changed(optics=replace(known, **typed))
    with bar() as progress:
        outcome: Outcome = run(recipe, progress=progress)
    print_notes(outcome)
    print_lobes(outcome.recipe.lobes)
    print_table(outcome.comparison.table)
    written = write_outcome(outcome, folder)
    console.print(f"{len(written)} files written to [bold]{folder.resolve()}[/bold]")


def optics_of(opened: Recording | xr.DataArray) -> Optics:
    """Return the microscope that a file names, or the paper's."""
    return opened.optics if isinstance(opened, Recording) else Optics()


def print_notes(outcome: Outcome) -> None:
    """Say what had to be assumed."""
    recording, optics = outcome.recording, outcome.recipe.optics
    if recording is None:
        notes = outcome.reconstruction["phase"].attrs.get("notes", ())
    else:
        notes = recording.notes if optics is None else ()
    for note in notes:
        console.print(f"[yellow]{escape(note)}[/yellow]")


def frame_numbers(text: str) -> tuple[int, int]:
    """Read TIME,ANGLE."""
    try:
        time, angle = (int(part) for part in text.split(","))
    except ValueError as error:
        msg = f"--boundary takes two frame numbers TIME,ANGLE such as 0,0, but got {text!r}"
        raise ValueError(msg) from error
    return time, angle


@contextmanager
def bar() -> Iterator[ProgressCall]:
    """Show progress as one line that moves."""
    with Progress(console=console, transient=True) as display:
        task = display.add_task("", total=None)

        def report(done: int, total: int, message: str) -> None:
            display.update(task, completed=done, total=total, description=message)

        yield report


def print_lobes(lobes: Sequence[Lobe]) -> None:
    """Print the views as a table, with warnings."""
    if not lobes:
        return
    table = Table(title="Views", title_justify="left")
    for heading in ("view", "ky (1/px)", "kx (1/px)", "radius (1/px)", "angle (deg)", "flipped"):
        table.add_column(heading, justify="right")
    for i, lobe in enumerate(lobes, start=1):
        ky, kx = lobe.carrier
        flip = "yes" if lobe.flip else "no"
        table.add_row(
            str(i), f"{ky:.4f}", f"{kx:.4f}", f"{lobe.radius:.4f}", f"{lobe.angle_deg:g}", flip
        )
    console.print(table)
    for warning in lobe_warnings(lobes):
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


def cell(value: object) -> str:
    """Return a value as it stands in a table."""
    if isinstance(value, str):
        return value
    number = float(str(value))
    return "" if number != number else f"{number:.3f}"


def print_itoh(outcome: Outcome, exact: xr.DataArray | None) -> None:
    """Say where steps are too large, and which order suits the object."""
    results = outcome.comparison.results
    known, origin = best_known(results, exact)
    shares = ", ".join(
        f"{str(name).removeprefix('along_')} {100 * margin.attrs['share_beyond']:.2f} %"
        for name, margin in itoh_margin(known).data_vars.items()
    )
    found = residues(outcome.reconstruction["phase"])
    console.print(f"Steps beyond half a cycle, by {origin}: {shares}")
    console.print(f"Residues in the wrapped phase: {int(abs(found).sum())}")
    ways = order_shares(known, outcome.recipe.boundary[0])
    words = ", ".join(f"{METHODS[m].label} {100 * share:.2f} %" for m, share in ways.items())
    verdict = order_verdict(results, outcome.recipe.boundary[0], exact)
    console.print(f"Of the steps on their way: {words}. {verdict}")
    labels = outcome.comparison.table["method"]
    for method, sentence in outcome.comparison.warnings().items():
        console.print(f"[yellow]{labels[method]}: {sentence}[/yellow]")


def write_picture(outcome: Outcome, exact: xr.DataArray | None, path: Path) -> None:
    """Write a picture of all results at some frames."""
    frames = telling_frames(outcome.reconstruction["phase"], outcome.recipe.boundary[0])
    write_figure(path, comparison_figure(named_results(outcome.comparison, exact), frames))


def megabytes(size: int) -> str:
    """Return a size in the unit that suits it."""
    return f"{size / 2**20:.1f} MB" if size < 2**30 else f"{size / 2**30:.1f} GB"


def rate_of(recording: Recording) -> str:
    """Return the frame rate in words."""
    rate = recording.frame_rate_hz
    return "one frame" if rate is None else f"{rate:.4g} frames a second"


if __name__ == "__main__":
    main()
