"""What a file holds."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
import xarray as xr
from rich.markup import escape
from rich.table import Table

from napari_phase4d.analysis import noise_figures, noise_sentence, residues
from napari_phase4d.cli.console import console
from napari_phase4d.cli.options import Dataset, Raw, raw_layout
from napari_phase4d.cli.printing import NOISE_FRAMES, print_lobes
from napari_phase4d.holography import (
    Lobe,
    find_lobes,
    first_seen,
    lost_frames,
    lost_sentence,
    reconstruct,
)
from napari_phase4d.machine import free_memory
from napari_phase4d.pipeline import (
    DEFAULT_METHODS,
    Needs,
    Recipe,
    estimated_seconds,
    needs_of,
    open_by,
    phase_needs,
)
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import METHODS, SCORED_TIMES, scores_of_some, scores_sentence
from napari_phase4d.words import counted, size_in_words, time_in_words

__all__ = ["info"]

#: Frames that lost ones are looked for among.
LOST_FRAMES = 1000


def info(
    file: Annotated[
        Path,
        typer.Argument(
            help="Hologram video of any format, or a folder; or sample:euglena, sample:yeast."
        ),
    ],
    views: Annotated[
        int | None, typer.Option(help="Number of views, 1 to 6. Default: found by itself.")
    ] = None,
    dataset: Dataset = None,
    raw: Raw = None,
) -> None:
    """Say what a recording holds, where its lobes are, and what a run would need."""
    if views is not None:
        Recipe().changed(n_views=views)  # a wrong number is said before anything is read
    recording = open_by(Recipe(recording=str(file), dataset=dataset, raw=raw_layout(raw)))
    if isinstance(recording, xr.DataArray):
        print_phase(file, recording)
        return
    height, width = recording.frame_shape
    first = first_seen(recording)
    console.print(f"[bold]{escape(recording.name)}[/bold]")
    console.print(
        f"  {counted(recording.n_frames, 'frame')} of {height} x {width} pixels, "
        f"{recording.holograms.dtype}, {size_in_words(recording.nbytes)}"
        f"{f', from {escape(recording.kind)}' if recording.kind else ''}"
    )
    console.print(
        f"  pixel in the sample {recording.optics.pixel_um:.4g} um, "
        f"wavelength {recording.optics.wavelength_um:.4g} um, {rate_of(recording)}"
    )
    console.print(f"  first frame: {first.min():g} to {first.max():g}, mean {first.mean():.4g}")
    if said := lost_words(recording):
        console.print(f"  [yellow]{said}[/yellow]")
    for note in recording.notes:
        console.print(f"  [yellow]{escape(note)}[/yellow]")
    try:
        lobes = find_lobes(recording, views)
    except ValueError as error:
        console.print(f"  [yellow]{escape(str(error))}[/yellow]")
        return
    print_lobes(lobes)
    console.print(noise_sentence(noise_figures(first_frames(recording, lobes))))
    print_needs(
        lambda methods: needs_of(Recipe(methods=methods), recording, lobes),
        lambda methods: estimated_seconds(Recipe(methods=methods), recording, lobes),
    )


def lost_words(recording: Recording) -> str:
    """Say which frames the camera lost, of all or of many of them."""
    number = min(recording.n_frames, LOST_FRAMES)
    return lost_sentence(lost_frames(recording, number), number)


def print_needs(
    needs: Callable[[tuple[str, ...]], Needs], seconds: Callable[[tuple[str, ...]], float]
) -> None:
    """Say what a run would need: memory, disk and time, with few methods or many."""
    table = Table(title="What a run needs, about", title_justify="left")
    for heading in ("methods", "memory", "or in parts", "disk", "time"):
        table.add_column(heading, justify="left" if heading == "methods" else "right")
    choices = {
        "T/A": ("temporal-angular",),
        f"the usual {len(DEFAULT_METHODS)}": DEFAULT_METHODS,
        f"all {len(METHODS)}": tuple(METHODS),
    }
    for name, methods in choices.items():
        found = needs(methods)
        sizes = [size_in_words(n) for n in (found.in_memory, found.on_disk, found.disk)]
        time = time_in_words(seconds(methods)) if len(methods) < len(METHODS) else ""
        table.add_row(name, *sizes, time)
    console.print(table)
    free = free_memory()
    left = shutil.disk_usage(Path.cwd()).free
    console.print(
        f"This machine has {size_in_words(free)} of memory free, and {size_in_words(left)} "
        "of disk here. What does not fit into memory is worked on in parts and lies on disk."
    )


def print_phase(file: Path, phase: xr.DataArray) -> None:
    """Say what a file of wrapped phase holds."""
    n_times, n_angles, height, width = phase.shape
    console.print(f"[bold]{escape(file.name)}[/bold]")
    console.print(
        f"  wrapped phase, {counted(n_times, 'time')}, {counted(n_angles, 'view')} of "
        f"{height} x {width} pixels"
    )
    angles = ", ".join(f"{a:g}" for a in phase["angle"].values)
    console.print(f"  viewing angles {angles} degrees")
    for note in phase.attrs.get("notes", ()):
        console.print(f"  [yellow]{escape(note)}[/yellow]")
    # First: the rest takes its time, and memory for its frames.
    print_needs(
        lambda methods: phase_needs(methods, phase.shape, finds_start=True),
        lambda methods: estimated_seconds(Recipe(methods=methods), phase),
    )
    some = phase.isel(time=slice(SCORED_TIMES)).compute()
    which = f" of the first {SCORED_TIMES} times" if n_times > SCORED_TIMES else ""
    console.print(f"  {int(abs(residues(some)).sum())} residues{which}")
    scores = scores_of_some(phase)
    time, view = scores.attrs["best"]
    console.print(f"  safest boundary frame: {time},{view}. {scores_sentence(scores)}")


def first_frames(recording: Recording, lobes: list[Lobe]) -> xr.Dataset:
    """Reconstruct so many frames that their noise can be told."""
    return reconstruct(recording.first(NOISE_FRAMES), lobes)


def rate_of(recording: Recording) -> str:
    """Return the frame rate in words."""
    rate = recording.frame_rate_hz
    return "one frame" if rate is None else f"{counted(f'{rate:.4g}', 'frame')} a second"
