"""From files to unwrapped phase: by one method, by all side by side, or while one records."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
import typer
from numpy.typing import NDArray
from rich.markup import escape

from napari_phase4d.analysis import (
    as_truth,
    best_known,
    itoh_margin,
    order_shares,
    order_verdict,
    residues,
    steps_sentence,
)
from napari_phase4d.cli.options import (
    Typed,
    is_recipe,
    recipe_and_files,
    taking_settings,
    typed_optics,
    with_settings,
)
from napari_phase4d.cli.printing import (
    bar,
    console,
    errors,
    print_cells,
    print_lobes,
    print_missed_views,
    print_notes,
    print_start,
    print_table,
    print_verdict,
    write_picture,
)
from napari_phase4d.io import FromCamera, holds_phase, open_phase, open_truth
from napari_phase4d.later import xr
from napari_phase4d.pipeline import (
    LiveStatus,
    Outcome,
    Recipe,
    advice_on,
    checked_form,
    fingerprinting,
    found_anywhere,
    open_by,
    result_folder,
    run_batch,
    run_unwarned,
    sentence_of,
    stacks_beside,
    typed_into,
    watch,
    what_needs_holograms,
    without_holograms,
    write_files,
)
from napari_phase4d.sample import is_sample
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.task import Task
from napari_phase4d.unwrapping import METHODS, methods_for
from napari_phase4d.words import counted, printable

__all__ = ["compare_command", "run_command", "watch_command"]


@taking_settings()
def run_command(
    inputs: Annotated[
        list[Path], typer.Argument(help="Hologram videos; a .json among them is the recipe.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_output"),
    *,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave files whose results are complete as they are.")
    ] = False,
    form: Annotated[
        str | None,
        typer.Option(help="tiff or zarr: OME-TIFF (default), or OME-Zarr, also beyond memory."),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask.distributed scheduler to work on.")
    ] = None,
    **typed: Unpack[Typed],
) -> None:
    """Take recordings from file to unwrapped phase, table and recipe.

    Several files, or --resume, make a batch: a folder for each, and a summary.
    """
    checked_form(form)
    recipe, files = recipe_and_files(inputs)
    if resume and not files and recipe.recording:
        files = [Path(recipe.recording)]  # a batch of the one that the recipe names
    # Files that are given take the place of the recipe's own.
    sources = [str(file) for file in files] or [recipe.recording]
    turned = any(map(is_sample, sources))
    recipe = with_settings(recipe, turned=turned, **typed)
    adapt = partial(with_optics, numbers=typed_optics(typed))
    with stoppable():
        if len(files) > 1 or (files and resume):
            wishes = {"resume": resume, "form": form, "scheduler": scheduler}
            batch(recipe, files, out, prepared=adapt, **wishes)
        else:
            named = {"recording": found_anywhere(files[0])} if files else {}
            process(adapt(recipe.changed(**named)), out, form, scheduler)


def with_optics(recipe: Recipe, numbers: Mapping[str, float]) -> Recipe:
    """Return a recipe with the optics that were typed in; the rest is as the file says."""
    recipe = without_fields(recipe)
    if not numbers or not recipe.recording:
        return recipe
    opened = open_by(recipe.changed(optics=None))
    return recipe.changed(optics=typed_into(recipe.optics, numbers, opened))


def without_fields(recipe: Recipe) -> Recipe:
    """Return a recipe without what needs the fields of holograms, where the file holds phase."""
    if not recipe.recording or not what_needs_holograms(recipe) or not is_phase(recipe):
        return recipe
    return without_holograms(recipe)


def is_phase(recipe: Recipe) -> bool:
    """Say whether the recording of a recipe is wrapped phase, by what it says or holds."""
    if recipe.content != "auto":
        return recipe.content == "phase"
    if is_sample(recipe.recording):
        return isinstance(open_by(recipe), xr.DataArray)
    return holds_phase(recipe.recording, recipe.dataset)


def process(recipe: Recipe, folder: Path, form: str | None, scheduler: str | None) -> None:
    """Run one recording and write what comes out."""
    if not recipe.recording:
        run_unwarned(recipe)  # which says what is missing
    with (
        result_folder(folder, recipe) as kept,
        fingerprinting(recipe.recording) as hashing,
        stacks_beside(folder, form) as place,
    ):
        with bar() as progress:
            outcome = run_unwarned(recipe, task=Task(progress), folder=place, scheduler=scheduler)
        print_notes(outcome, advice_on(outcome, of_lobes=False))
        print_lobes(outcome.recipe.lobes, outcome.recipe.optics)
        print_missed_views(outcome, recipe)
        print_start(outcome)
        print_table(outcome.comparison.table)
        print_cells(outcome)
        with bar() as progress:
            source = hashing.result()
            written = write_files(outcome, folder, Task(progress), form=form, source=source)
            kept.settle(written, recipe.recording, source)
        if recipe.confidence:
            print_verdict(outcome)
    console.print(f"{counted(len(written), 'file')} written to [bold]{folder.resolve()}[/bold]")
    check_cells(outcome)


def check_cells(outcome: Outcome) -> None:
    """Raise ValueError where cells were asked for and could not be found."""
    error = outcome.cells_error
    if error is not None:
        msg = f"the results are written, but without their cells: {sentence_of(error)}"
        raise ValueError(msg) from error


#: The picture of all results.
PICTURE = "comparison.png"


@taking_settings(
    but=(
        "wavelength", "camera_pixel", "magnification", "frame_rate", "storage", "cells",
        "smallest_cell", "object_index", "increment", "oblique",
    ),
    method=Annotated[list[str] | None, typer.Option(help="Method id; default: all that suit.")],
)  # fmt: skip
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
    **typed: Unpack[Typed],
) -> None:
    """Put all methods side by side: table, picture, and where unwrapping has to fail."""
    recipe, files = recipe_and_files(inputs)
    if not typed.get("method") and not any(is_recipe(p) for p in inputs):
        typed["method"] = methods_for(typed.get("view_wavelength") or light_in(files))
    recipe = with_settings(recipe, **typed)
    exact = None if truth is None else open_truth(truth)
    if not files and not recipe.recording:
        msg = "give at least one file to compare the methods on"
        raise ValueError(msg)
    with stoppable():
        if len(files) > 1:
            batch(recipe, files, out, truth=exact, prepared=without_fields, finished=finish)
            return
        recording = found_anywhere(files[0] if files else recipe.recording)
        compare_one(without_fields(recipe.changed(recording=recording)), exact, out)


def light_in(files: Sequence[Path]) -> NDArray[np.float64] | None:
    """Return the wavelengths of the views of a file of phase, None of holograms or several."""
    if len(files) != 1 or not holds_phase(files[0]):
        return None
    return wavelengths_of(open_phase(files[0]))


def compare_one(recipe: Recipe, exact: xr.DataArray | None, out: Path) -> None:
    """Compare the methods on one file, and write what comes out."""
    with (
        result_folder(out, recipe, [PICTURE]) as kept,
        fingerprinting(recipe.recording) as hashing,
        stacks_beside(out, None) as place,
        bar() as progress,
    ):
        outcome = run_unwarned(recipe, truth=exact, task=Task(progress), folder=place)
        written = write_files(outcome, out, Task(progress), source=hashing.result())
        # Before anything is told: what the note lists is there, whatever fails then.
        known = truth_of(outcome)
        written.append(write_picture(outcome, known, out / PICTURE))
        kept.settle(written, recipe.recording, hashing.result())
    print_missed_views(outcome, recipe)
    tell_of(outcome, known, advice_on(outcome))
    console.print(f"{len(written)} files written to [bold]{out.resolve()}[/bold]")
    check_cells(outcome)


def truth_of(outcome: Outcome) -> xr.DataArray | None:
    """Return the exact phase of a run frame by frame as its results are, None without any."""
    return as_truth(outcome.truth, outcome.reconstruction["phase"])


def finish(outcome: Outcome, folder: Path) -> None:
    """Write the picture of one file of several, and print what `tell_of` does."""
    exact = truth_of(outcome)
    write_picture(outcome, exact, folder / PICTURE)
    tell_of(outcome, exact)


def tell_of(outcome: Outcome, exact: xr.DataArray | None, advice: Sequence[str] = ()) -> None:
    """Print the table and what is known of the steps."""
    print_notes(outcome, advice)
    print_start(outcome)
    print_table(outcome.comparison.table)
    try:
        print_itoh(outcome, exact)
    except OSError as error:  # results larger than memory
        console.print(f"[yellow]{escape(sentence_of(error))}[/yellow]")


def print_itoh(outcome: Outcome, exact: xr.DataArray | None) -> None:
    """Say where steps are too large, and which order suits the object."""
    results = outcome.comparison.results
    known, origin = best_known(results, exact)
    found = residues(outcome.reconstruction["phase"])
    console.print(steps_sentence(itoh_margin(known), origin))
    console.print(f"Residues in the wrapped phase: {int(abs(found).sum())}")
    ways = order_shares(known, outcome.recipe.start_frames[0])
    words = ", ".join(f"{METHODS[m].label} {100 * share:.2f} %" for m, share in ways.items())
    verdict = order_verdict(results, outcome.recipe.start_frames[0], exact)
    ahead = f"Of the steps on their way: {words}. " if has_steps(known) else ""
    console.print(f"{ahead}{verdict}")
    labels = outcome.comparison.table["method"]
    judged = outcome.comparison.held or outcome.recipe.confidence
    for method, sentence in (outcome.comparison.warnings() if judged else {}).items():
        console.print(f"[yellow]{labels[method]}: {sentence}[/yellow]")
    print_verdict(outcome)


def has_steps(phase: xr.DataArray) -> bool:
    """Say whether there is a way from frame to frame."""
    return max(phase.sizes["time"], phase.sizes["angle"]) > 1


#: What a shell gives for a program that Ctrl-C has ended.
STOPPED_BY_USER = 130


def batch(recipe: Recipe, files: Sequence[Path], out: Path, **options: Any) -> None:
    """Work on each file, see `run_batch`; of several, one that fails does not stop the others.

    Raises
    ------
    ValueError
        If any failed.
    """
    with bar() as progress:
        table = run_batch(recipe, files, out, progress=progress, told=tell, **options)
    console.print(f"The summary is in [bold]{(out / 'summary.csv').resolve()}[/bold]")
    failed = table[table["status"] == "failed"]
    if len(failed):
        names = ", ".join(printable(Path(file).name) for file in failed["file"])
        msg = f"{len(failed)} of {len(table)} files failed: {names}"
        raise ValueError(msg)


def tell(line: str) -> None:
    """Print a line of the log."""
    console.print(escape(line))


class ToldToEndError(KeyboardInterrupt):
    """The system wishes this program to end.

    It is not `KeyboardInterrupt` itself, after which Python may end with a code of its own.
    """


@contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C, and the wish of the system to end, stop the work with one sentence."""
    came: list[int] = []

    def stop(number: int, _: object) -> None:
        came.append(number)
        raise ToldToEndError

    with listening(stop):
        try:
            yield
        except KeyboardInterrupt:
            by = signal.Signals(came[0]).name if came else "Ctrl-C"
            errors.print(
                f"Stopped by {by}. What is written is whole; --resume goes on with a batch."
            )
            raise typer.Exit(128 + came[0] if came else STOPPED_BY_USER) from None


@contextmanager
def listening(
    stop: Callable[[int, object], None], names: Sequence[str] = ("SIGTERM", "SIGHUP")
) -> Iterator[None]:
    """Let the system's wishes to end call a function meanwhile; afterwards they do as before.

    What is ignored stays so, as under nohup; outside of the main thread nothing is listened to.
    """
    before: dict[int, Any] = {}
    for name in names:
        number = getattr(signal, name, None)
        if number is None or signal.getsignal(number) is signal.SIG_IGN:
            continue
        with suppress(ValueError):  # not in the main thread
            before[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- while one records ----------------------------------------------------------------------


#: Seconds between two lines of what is done at the end.
LINE_S = 2.0


@taking_settings(but=("confidence", "raw", "storage"))
def watch_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="A folder that gets an image a frame, a TIFF that gets pages, or a Zarr array "
            "that grows, there already or not; a .json beside it is the recipe."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_output"),
    frames: Annotated[int | None, typer.Option(help="End after so many frames.")] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Configuration of Micro-Manager (.cfg), or demo: its camera is started, and "
            "writes its frames into the folder."
        ),
    ] = None,
    patience: Annotated[
        float, typer.Option(help="End after so many seconds without a new frame.")
    ] = 30.0,
    frame_patience: Annotated[
        float,
        typer.Option(
            help="Give up a frame that was announced and is not whole after so many seconds."
        ),
    ] = 5.0,
    first_frames: Annotated[
        int | None,
        typer.Option(
            help="Find lobes, background and focus on so many frames at the beginning; default 8."
        ),
    ] = None,
    *,
    form: Annotated[
        str | None, typer.Option(help="tiff or zarr: OME-TIFF, or OME-Zarr (default).")
    ] = None,
    **typed: Unpack[Typed],
) -> None:
    """Work on a recording while it is written, and write its results when it is complete.

    It is complete after --frames, or --patience seconds without a new one. Ctrl-C ends it
    earlier, and writes the results of what has come; a second one gives them up.
    """
    recipe, files = recipe_and_files(inputs)
    source = the_one(recipe, files)
    recipe = with_settings(recipe, **typed)
    if first_frames is not None:
        recipe = recipe.changed(first_frames=first_frames)
    with ending() as came:
        outcome = watch(
            source if camera is None else FromCamera.configured(camera, source, frames),
            recipe,
            out,
            frames=frames,
            patience_s=patience,
            frame_patience_s=frame_patience,
            form=form,
            told=tell_event,
            status=tell_status,
            progress=Lines(),
            stopped=lambda: bool(came),
            optics_numbers=typed_optics(typed),
        )
    print_notes(outcome, ())
    print_lobes(outcome.recipe.lobes, outcome.recipe.optics)
    print_start(outcome)
    print_table(outcome.comparison.table)
    print_cells(outcome)
    n_frames = outcome.reconstruction.sizes["time"]
    console.print(f"{counted(n_frames, 'frame')}: results are in [bold]{out.resolve()}[/bold]")
    if came:
        raise typer.Exit(128 + came[0])


def the_one(recipe: Recipe, files: list[Path]) -> Path:
    """Return what is to be watched.

    Raises
    ------
    ValueError
        If it is not one folder or file.
    """
    named = files or ([Path(recipe.recording)] if recipe.recording else [])
    if len(named) != 1:
        msg = f"give one folder or file to watch, not {len(named)}"
        raise ValueError(msg)
    return named[0]


def tell_event(line: str) -> None:
    """Print what happened."""
    console.print(f"[yellow]{escape(line[:1].upper() + line[1:])}.[/yellow]")


def tell_status(status: LiveStatus) -> None:
    """Print how far it is."""
    console.print(status.sentence)


class Lines:
    """Prints how far what is done at the end is, now and then."""

    def __init__(self) -> None:
        self._next = time.monotonic() + LINE_S

    def __call__(self, done: int, total: int, message: str) -> None:
        """Take a step."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + LINE_S
            console.print(f"{escape(message)}: {done} of {total}")


@contextmanager
def ending() -> Iterator[list[int]]:
    """Give the signals that have come: the first is a wish to end well, a second one to give up.

    Yields
    ------
    list of int
        Empty until one comes.
    """
    came: list[int] = []

    def stop(number: int, _: object) -> None:
        came.append(number)
        if len(came) > 1:
            raise ToldToEndError

    with listening(stop, ("SIGINT", "SIGTERM", "SIGHUP")):
        try:
            yield came
        except KeyboardInterrupt:
            errors.print("Given up; no results are written.")
            raise typer.Exit(128 + came[0] if came else STOPPED_BY_USER) from None
