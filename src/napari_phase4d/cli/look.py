"""What a file holds: the figures in words, and one picture of the recording."""

from __future__ import annotations

import math
import shutil
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from napari_phase4d.analysis import noise_figures, noise_sentence, residues
from napari_phase4d.cli.options import Dataset, Raw, Refocus, distance_of, raw_layout
from napari_phase4d.cli.printing import NOISE_FRAMES, bar, console, print_lobes
from napari_phase4d.holography import (
    Lobe,
    find_lobes,
    first_seen,
    fringe_contrast,
    lost_frames,
    lost_sentence,
    power_spectrum,
    reconstruct,
    times_of_views,
)
from napari_phase4d.io import check_figure, write_figure
from napari_phase4d.later import pd, xr
from napari_phase4d.machine import free_memory
from napari_phase4d.pipeline import (
    DEFAULT_METHODS,
    Needs,
    Recipe,
    estimated_seconds,
    needs_of,
    open_by,
    phase_needs,
    reconstruct_by,
    result_folders,
)
from napari_phase4d.plotting import Circle, look_figure
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import (
    SCORED_TIMES,
    methods_for,
    scores_of_some,
    scores_sentence,
    unwrap,
)
from napari_phase4d.warned import hearing, warn
from napari_phase4d.words import (
    counted,
    printable,
    size_in_words,
    time_in_words,
)

__all__ = ["info", "look"]

#: Frames that lost ones are looked for among.
LOST_FRAMES = 1000


def info(
    file: Annotated[
        Path,
        typer.Argument(
            help="Hologram video of any format, or a folder; or sample:euglena, sample:cells, "
            "sample:yeast."
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
        own = recording.sizes["angle"]
        if views not in (None, own):
            warn(f"the file of wrapped phase has {counted(own, 'view')}, whatever --views says")
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
    print_lobes(lobes, recording.optics)
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
    every = methods_for(None)
    choices = {
        "T/A": ("temporal-angular",),
        f"the usual {len(DEFAULT_METHODS)}": DEFAULT_METHODS,
        f"all {len(every)}": tuple(every),
    }
    for name, methods in choices.items():
        found = needs(methods)
        sizes = [size_in_words(n) for n in (found.in_memory, found.on_disk, found.disk)]
        time = time_in_words(seconds(methods)) if len(methods) < len(every) else ""
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
    console.print(f"[bold]{escape(printable(file.name))}[/bold]")
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
    with hearing():  # what there is to say of the phase has been said
        console.print(f"  {int(abs(residues(some)).sum())} residues{which}")
        scores = scores_of_some(phase)
    time, view = scores.attrs["best"]
    console.print(f"  safest boundary frame: {time},{view}. {scores_sentence(scores)}")


def first_frames(recording: Recording, lobes: list[Lobe]) -> xr.Dataset:
    """Reconstruct so many frames that their noise can be told."""
    with warnings.catch_warnings():
        # Those that are lost have been told, of the whole recording.
        warnings.filterwarnings("ignore", message=".* left out (as lost|in view)")
        return reconstruct(recording.first(NOISE_FRAMES), lobes)


def rate_of(recording: Recording) -> str:
    """Return the frame rate in words."""
    rate = recording.frame_rate_hz
    return "one frame" if rate is None else f"{counted(f'{rate:.4g}', 'frame')} a second"


#: Frames from the beginning that are looked at.
FRAMES = 24


def look(
    file: Annotated[
        Path, typer.Argument(help="Hologram video or a single hologram; or sample:euglena.")
    ],
    views: Annotated[
        int | None, typer.Option(help="Number of views, 1 to 6. Default: found by itself.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Where to save the picture: .png, .svg or .pdf. Default: look_NAME.png, here."
        ),
    ] = None,
    background: Annotated[
        str, typer.Option(help="What to remove: none, tilt, curvature, polynomial, zernike.")
    ] = "tilt",
    refocus: Refocus = None,
    dataset: Dataset = None,
    raw: Raw = None,
) -> None:
    """Show in one picture what a recording holds, for any number of views, even one."""
    recipe = Recipe().changed(
        recording=str(file),
        dataset=dataset,
        raw=raw_layout(raw),
        background=background,
        refocus_um=distance_of(refocus),
    )
    recording = open_by(recipe)
    if isinstance(recording, xr.DataArray):
        msg = f"{file.name} holds wrapped phase, not holograms; use info or compare on it"
        raise ValueError(msg)
    if out is None:
        out = Path(f"look_{result_folders([file], '.')[0].name}.png")
    check_figure(out)  # before the work
    recording = recording.first(FRAMES)
    with bar() as progress:
        lobes = find_lobes(recording, views, progress=progress)
        data = reconstruct_by(recipe, recording, lobes, progress)
        seen = frames_seen(data)
        shown = data.isel(time=seen)
        unwrapped = unwrap(shown["phase"][:1], method="spatial-2d", boundary=(0, 0))
        figures = noise_figures(shown.isel(time=slice(NOISE_FRAMES)))
        spectrum = power_spectrum(recording, max_frames=8, progress=progress)
    print_lobes(lobes, recording.optics)
    words = sentences(recording, data, figures)
    for line in words:
        console.print(escape(line))
    figure = look_figure(
        np.asarray(first_seen(recording), dtype=np.float32),
        spectrum,
        circles_of(lobes, shown),
        shown,
        unwrapped,
        title=recording.name,
        words=words,
    )
    write_figure(out, figure)
    console.print(f"The picture is [bold]{escape(str(out.resolve()))}[/bold]")


def frames_seen(data: xr.Dataset) -> NDArray[np.intp]:
    """Return the times at which all views are seen, or any where never all are."""
    times, whole = np.arange(data.sizes["time"]), data.attrs["lost_times"]
    some = np.setdiff1d(times, whole)
    every = np.setdiff1d(some, [time for time, _ in data.attrs["lost_views"]])
    return every if len(every) else some


def circles_of(lobes: Sequence[Lobe], data: xr.Dataset) -> list[Circle]:
    """Return the lobes to draw, in the order in which the reconstruction has the views."""
    order = {tuple(lobe.carrier): lobe for lobe in lobes}
    ordered = [order[tuple(note["carrier"])] for note in data.attrs["lobes"]]
    return [Circle(lobe.carrier, lobe.radius) for lobe in ordered]


def sentences(recording: Recording, data: xr.Dataset, figures: pd.DataFrame) -> list[str]:
    """Say in words what the picture can't show."""
    n_views, lost = len(figures), data.attrs["lost_times"]
    contrast = fringe_contrast(np.asarray(first_seen(recording), dtype=np.float32))
    lines = [
        f"{counted(recording.n_frames, 'frame')} looked at, {counted(n_views, 'view')}, "
        f"pixel in the sample "
        f"{recording.optics.pixel_um:.4g} um, fringe contrast {contrast:.2f}"
    ]
    if lost:
        listed = ", ".join(str(time) for time in lost)
        lines.append(f"Lost and left out: {counted(len(lost), 'frame')}, {listed}.")
    for view, times in times_of_views(data.attrs["lost_views"]).items():
        listed = ", ".join(str(time) for time in times)
        lines.append(
            f"Left out in view {view + 1}, as its fringes are gone or weak: "
            f"{counted(len(times), 'frame')}, {listed}."
        )
    for number, (note, visibility) in enumerate(
        zip(data.attrs["lobes"], figures["fringe_visibility"], strict=True), start=1
    ):
        ky, kx = note["carrier"]
        seen = "not known" if math.isnan(visibility) else f"{visibility:.2f}"
        lines.append(
            f"View {number}: carrier ({ky:.4f}, {kx:.4f}) 1/px, radius {note['radius']:.4f}, "
            f"fringe visibility {seen}"
        )
    lines.append(noise_sentence(figures))
    if "refocus_um" in data.attrs:
        lines.append(focus_sentence(data))
    lines.append(safest_sentence(data["phase"]))
    return lines


def focus_sentence(data: xr.Dataset) -> str:
    """Say how far the fields were refocused, and how the distance was found."""
    words = f"Refocused by {data.attrs['refocus_um']:.4g} um"
    if "focus_objects" in data.attrs:
        words += f", found for a {data.attrs['focus_objects']} object"
        if data.attrs["focus_at_the_end"]:
            words += " at the end of the search: there may be no focus within it"
    return words + "."


def safest_sentence(phase: xr.DataArray) -> str:
    """Say which frame unwrapping is best begun from."""
    if phase.sizes["time"] * phase.sizes["angle"] == 1:
        return "One frame of one view: unwrapping begins from it."
    scores = scores_of_some(phase)
    time, view = scores.attrs["best"]
    return (
        f"Safest frame to begin unwrapping from: {time},{view} (time,view counted from 0). "
        f"{scores_sentence(scores)}"
    )
