"""A first look at a recording: one picture and the figures in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
import xarray as xr
from rich.markup import escape

from napari_phase4d.analysis import noise_figures, noise_sentence
from napari_phase4d.cli.console import console
from napari_phase4d.cli.options import Dataset, Raw, Refocus, distance_of, raw_layout
from napari_phase4d.cli.printing import NOISE_FRAMES, bar, print_lobes
from napari_phase4d.holography import Lobe, find_lobes, first_seen, fringe_contrast, power_spectrum
from napari_phase4d.io import write_figure
from napari_phase4d.pipeline import Recipe, open_by, reconstruct_by, result_folders
from napari_phase4d.plotting import Circle, look_figure
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import scores_of_some, scores_sentence, unwrap
from napari_phase4d.words import counted

__all__ = ["look"]

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
    recording = recording.first(FRAMES)
    with bar() as progress:
        lobes = find_lobes(recording, views, progress=progress)
        data = reconstruct_by(recipe, recording, lobes, progress)
        seen = np.setdiff1d(np.arange(data.sizes["time"]), data.attrs["lost_times"])
        shown = data.isel(time=seen)
        unwrapped = unwrap(shown["phase"][:1], method="spatial-2d", boundary=(0, 0))
        figures = noise_figures(shown.isel(time=slice(NOISE_FRAMES)))
        spectrum = power_spectrum(recording, max_frames=8, progress=progress)
    print_lobes(lobes)
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
    if out is None:
        out = Path(f"look_{result_folders([file], '.')[0].name}.png")
    write_figure(out, figure)
    console.print(f"The picture is [bold]{escape(str(out.resolve()))}[/bold]")


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
    for number, (note, visibility) in enumerate(
        zip(data.attrs["lobes"], figures["fringe_visibility"], strict=True), start=1
    ):
        ky, kx = note["carrier"]
        lines.append(
            f"View {number}: carrier ({ky:.4f}, {kx:.4f}) 1/px, radius {note['radius']:.4f}, "
            f"fringe visibility {visibility:.2f}"
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
