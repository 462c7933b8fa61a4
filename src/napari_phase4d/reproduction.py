"""The paper's table and figures, from this program.

Dardikman, Singh & Shaked compare eight methods on a simulated budding yeast (their Fig. 2 and the
errors below it) and five on a recorded euglena (Fig. 4). Here the yeast is
`napari_phase4d.simulation.budding_yeast`, and the euglena's hologram video is simulated with a
physical model and goes through the whole chain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from napari_phase4d.analysis import Comparison, compare
from napari_phase4d.io import write_figure, write_movie, write_table
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline import PAPER_METHODS, Recipe, run
from napari_phase4d.pipeline.guarding import ResultFolder, guarded_folder
from napari_phase4d.pipeline.provenance import Fingerprint
from napari_phase4d.plotting import comparison_figure, movie_frames, phase_limits
from napari_phase4d.sample import euglena_sample
from napari_phase4d.simulation import budding_yeast
from napari_phase4d.task import UNWATCHED, Task, Watch
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import local_path

__all__ = [
    "PAPER_MSE",
    "Reproduction",
    "check_reproduction_folder",
    "reproduce",
    "write_reproduction",
]

#: Mean squared errors in rad^2 that the paper reports for its simulation (section 3).
PAPER_MSE: Mapping[str, float] = MappingProxyType(
    {
        "spatial-2d": 2.55,
        "angular": 1.70,
        "temporal": 0.95,
        "temporal-angular": 0.79,
        "angular-temporal": 0.82,
        "laplacian": 8.68,
        "region-growing": 6.15,
        "dilate-erode": 12.79,
    }
)
#: Methods that the paper ran in PhaseTools.
IN_PHASETOOLS = ("laplacian", "region-growing", "dilate-erode")
#: The frames of Fig. 2: t = 1 and 12 minutes from 0 and 25 degrees.
FIG_2_FRAMES = ((0, 0), (0, 5), (11, 0), (11, 5))
#: The frames of Fig. 4: the thin one, and a thick one from both angles.
FIG_4_FRAMES = ((0, 0), (0, 1), (30, 0), (30, 1))

#: What is written beside the movies.
TABLE, FIG_2, FIG_4 = "table.csv", "figure_2.png", "figure_4.png"

Stacks: TypeAlias = "dict[str, xr.DataArray]"
#: Name, title, stack and colour scale.
Movie: TypeAlias = "tuple[str, str, xr.DataArray, tuple[float, float]]"


@dataclass(frozen=True)
class Reproduction:
    """What corresponds to the paper's section 3.

    Parameters
    ----------
    table : pandas.DataFrame
        One row a method: the paper's error, this program's, that of PhaseTools' variant (all
        mean squared errors in rad^2), and the share of wrong cycles in percent.
    yeast, euglena : dict of str to DataArray
        The columns of Fig. 2 and Fig. 4: title to phase (time, angle, y, x).
    """

    table: pd.DataFrame
    yeast: Stacks
    euglena: Stacks


def reproduce(task: Task = UNWATCHED) -> Reproduction:
    """Run the paper's eight methods on the yeast, and its five on the euglena's hologram video.

    Raises
    ------
    Cancelled
        If ``cancelled()`` returned True.
    """
    data = budding_yeast()
    ours = on_the_yeast(data, tuple(PAPER_MSE), "textbook", task)
    theirs = on_the_yeast(data, IN_PHASETOOLS, "phasetools", task)
    table = pd.DataFrame(
        {
            "method": ours.table["method"],
            "paper_mse_rad2": pd.Series(PAPER_MSE),
            "mse_rad2": ours.table["mse_rad2"],
            "phasetools_mse_rad2": theirs.table["mse_rad2"],
            "wrong_cycles_percent": ours.table["wrong_cycles_percent"],
        },
        index=ours.table.index,
    )
    yeast = {"actual": data["phase"]} | labelled(ours)
    return Reproduction(table, yeast, euglena_columns(task))


def on_the_yeast(
    data: xr.Dataset,
    methods: tuple[str, ...],
    variant: str,
    task: Task,
) -> Comparison:
    """Run methods on the yeast, those of PhaseTools in the given variant."""
    return compare(
        data["wrapped"],
        methods,
        data.attrs["boundary"],
        data["phase"],
        mask="auto",
        options={m: {"variant": variant} for m in methods if m in IN_PHASETOOLS},
        **task.calls,
    )


def euglena_columns(task: Task = UNWATCHED) -> Stacks:
    """Take the euglena's hologram video through the whole chain."""
    sample = euglena_sample()
    recipe = Recipe(
        angles_deg=sample.angles_deg, boundary=(sample.boundary,), methods=PAPER_METHODS
    )
    outcome = run(recipe, sample.recording, **task.calls)
    return labelled(outcome.comparison)


def labelled(comparison: Comparison) -> Stacks:
    """Return the results under the names that are seen on screen."""
    return {METHODS[method].label: stack for method, stack in comparison.results.items()}


def check_reproduction_folder(folder: str | Path) -> None:
    """Raise OSError where table or figures would be written over what was made by no run."""
    ResultFolder(local_path(folder), (TABLE, FIG_2, FIG_4)).check("")


def write_reproduction(
    found: Reproduction,
    folder: str | Path,
    *,
    movies: bool = True,
    task: Task = UNWATCHED,
) -> list[Path]:
    """Write the table, both figures, and the movies that stand for Visualizations 1 to 14.

    What no run has made in the folder, or was changed since, is never written over; what an
    earlier run made there, and this one did not, is removed. ``run.json`` notes the files.

    Raises
    ------
    OSError
        If a file can't be written, or was not made by a run; files of that name are then left as
        they were.
    Cancelled
        If ``cancelled()`` returned True; the files written by then are whole.
    """
    folder, chosen = local_path(folder), list(movies_of(found)) if movies else []
    names = [TABLE, FIG_2, FIG_4, *(f"{name}.gif" for name, *_ in chosen)]
    with guarded_folder(folder, names) as kept:
        written = written_into(folder, found, chosen, task)
        kept.settle(written, "", Fingerprint("reproduction"))
    return written


def written_into(
    folder: Path, found: Reproduction, movies: Sequence[Movie], task: Task
) -> list[Path]:
    """Write table, figures and movies into a folder that its caller guards."""
    figures = ((FIG_2, found.yeast, FIG_2_FRAMES), (FIG_4, found.euglena, FIG_4_FRAMES))
    watch = Watch(1 + len(figures) + len(movies), "writing", task)
    written = [write_table(folder / TABLE, found.table)]
    watch.step()
    for name, columns, frames in figures:
        written.append(write_figure(folder / name, comparison_figure(columns, frames)))
        watch.step()
    for name, title, stack, limits in movies:
        pictures = movie_frames(angles_of(stack), limits, title=title)
        written.append(write_movie(folder / f"{name}.gif", pictures, cancelled=task.cancelled))
        watch.step()
    return written


def movies_of(found: Reproduction) -> Iterator[Movie]:
    """Yield name, title, stack and colour scale of every movie, numbered as in the paper."""
    number = 1
    for columns in (found.yeast, found.euglena):
        limits = phase_limits([stack.values[::4] for stack in columns.values()])
        for title, stack in columns.items():
            plain = title.lower().replace("/", "").replace(" ", "_")
            yield f"visualization_{number:02d}_{plain}", title, stack, limits
            number += 1


def angles_of(stack: xr.DataArray) -> Stacks:
    """Return the views of a stack as columns of a movie, side by side as in the paper."""
    angles = stack["angle"].values
    return {f"{angle:g}°": stack.isel(angle=[i]) for i, angle in enumerate(angles)}
