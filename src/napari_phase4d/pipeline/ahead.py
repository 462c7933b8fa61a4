"""What is done ahead of a run: how long it will take is tried out, and loops are compiled."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import time
from collections.abc import Sequence

import numpy as np

from napari_phase4d.compiling import is_on_disk
from napari_phase4d.holography import Lobe, power_spectrum, reconstruct
from napari_phase4d.holography.emptyfield import count_near
from napari_phase4d.later import xr
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import reconstruct_by, unwrap_by
from napari_phase4d.recording import Recording
from napari_phase4d.task import CancelledCall, Task
from napari_phase4d.unwrapping import (
    BUILT_IN,
    methods_for,
    object_in,
    scores_of_some,
    unwrap,
)
from napari_phase4d.unwrapping.directional.least_turns import sink_side
from napari_phase4d.unwrapping.growing.rows import integrated

__all__ = ["estimated_seconds", "load_object_finder", "warm_up", "warm_up_elsewhere"]

#: Frames of the trial.
TRIAL_FRAMES = 6


def estimated_seconds(
    recipe: Recipe,
    opened: Recording | xr.DataArray,
    lobes: Sequence[Lobe] = (),
    cancelled: CancelledCall | None = None,
) -> float:
    """Return about how many seconds a run will take.

    Some of the first frames, of phase from the first on that is known, are reconstructed and
    unwrapped twice; the second time counts, since compiled code is loaded the first time. Longer
    recordings take longer in proportion. Where the recipe leaves it to be found, the search for
    the safest frame counts too.

    Parameters
    ----------
    recipe : Recipe
        All settings.
    opened : Recording or DataArray
        The hologram video, or wrapped phase.
    lobes : sequence of Lobe, optional
        The views of a hologram video.
    cancelled : callable, optional
        ``cancelled()`` stops the trial.

    Returns
    -------
    float
        Seconds; maps of confidence, cells and the writing of results are not counted.

    Raises
    ------
    Cancelled
        If ``cancelled()`` returned True.
    """
    n_frames = opened.n_frames if isinstance(opened, Recording) else opened.sizes["time"]
    few = min(n_frames, TRIAL_FRAMES)
    finds_start = recipe.boundary == "auto"
    recipe = recipe.changed(boundary=((0, 0),), reference=None)
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        if isinstance(opened, Recording):
            data = reconstruct_by(recipe, opened.first(few), list(lobes), cancelled=cancelled)
            phase, amplitude = known_or_flat(data["phase"]), data["amplitude"]
        else:
            phase, amplitude = first_known(opened, few), None
        if finds_start:
            scores_of_some(phase, task=Task(None, cancelled))
        unwrap_by(recipe, phase, cancelled=cancelled, amplitude=amplitude)
        seconds = time.perf_counter() - began
        few = phase.sizes["time"]
    return seconds * n_frames / few


def first_known(phase: xr.DataArray, few: int) -> xr.DataArray:
    """Return so many frames of phase from the first on of which anything is known."""
    times = range(phase.sizes["time"])
    start = next((t for t in times if np.isfinite(phase[t].values).any()), 0)
    return phase[start : start + few].load()


def known_or_flat(phase: xr.DataArray) -> xr.DataArray:
    """Return phase, 0 if nothing of it is known: an estimate is no place to fail for that."""
    return phase if bool(np.isfinite(phase).any()) else phase.fillna(0)


COMMAND = "from napari_phase4d.pipeline.ahead import warm_up; warm_up()"


def warm_up() -> None:
    """Run everything on a few pixels, which compiles what it needs and keeps it on disk."""
    y, x = np.mgrid[:64, :64]
    fringes = (100 + 50 * np.cos(2 * np.pi * (0.2 * y + 0.25 * x))).astype(np.uint8)
    rec = Recording.from_frames(fringes[None])
    power_spectrum(rec)
    reconstruct(rec, [Lobe((0.2, 0.25), 0.1)])
    noise = np.random.default_rng(0).uniform(-3, 3, (3, 2, 24, 24)).astype(np.float32)
    # What needs several wavelengths has no loops of its own.
    for method in BUILT_IN.keys() & methods_for(None):
        unwrap(noise, method)


@functools.cache
def warm_up_elsewhere() -> subprocess.Popen[bytes] | None:
    """Let another process compile, once, if it has not been done before; return that process.

    Compiling holds the interpreter's lock for ten seconds and more, in which a window of this
    process could not be used.
    """
    done = all(is_on_disk(kernel) for kernel in (integrated, sink_side, count_near))
    if done or not sys.executable or getattr(sys, "frozen", False):
        return None
    try:
        return subprocess.Popen(
            [sys.executable, "-c", COMMAND],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONWARNINGS": "ignore"},
        )
    except OSError:
        return None  # then the first use compiles


def load_object_finder() -> None:
    """Load what finds the object in a frame, if it has been compiled before.

    The window shows the object of the first wrapped phase at once, and would wait for this.
    """
    if is_on_disk(integrated):
        object_in(np.zeros((24, 24), np.float32))
