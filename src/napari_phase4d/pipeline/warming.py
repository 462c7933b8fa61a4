"""Compiling ahead of the first use, so that nobody waits for it."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

import numpy as np

from napari_phase4d.compiling import is_on_disk
from napari_phase4d.holography import Lobe, power_spectrum, reconstruct
from napari_phase4d.holography.emptyfield import count_near
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import BUILT_IN, unwrap
from napari_phase4d.unwrapping.directional.cut import sink_side
from napari_phase4d.unwrapping.growing.rows import integrated

__all__ = ["warm_up", "warm_up_elsewhere"]

COMMAND = "from napari_phase4d.pipeline.warming import warm_up; warm_up()"


def warm_up() -> None:
    """Run everything on a few pixels, which compiles what it needs and keeps it on disk."""
    y, x = np.mgrid[:64, :64]
    fringes = (100 + 50 * np.cos(2 * np.pi * (0.2 * y + 0.25 * x))).astype(np.uint8)
    rec = Recording.from_frames(fringes[None])
    power_spectrum(rec)
    reconstruct(rec, [Lobe((0.2, 0.25), 0.1)])
    noise = np.random.default_rng(0).uniform(-3, 3, (3, 2, 24, 24)).astype(np.float32)
    for method in BUILT_IN:
        unwrap(noise, method)


@functools.cache
def warm_up_elsewhere() -> subprocess.Popen[bytes] | None:
    """Let another process compile, once, if it has not been done before; return that process.

    Compiling holds the interpreter's lock for ten seconds or so, in which a window of this
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
