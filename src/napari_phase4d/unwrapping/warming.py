"""Compiling ahead of the first use, so that nobody waits for it."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

import numpy as np

from napari_phase4d.unwrapping.compiling import is_on_disk
from napari_phase4d.unwrapping.directional.cut import sink_side
from napari_phase4d.unwrapping.growing.smooth import integrated
from napari_phase4d.unwrapping.registry import BUILT_IN
from napari_phase4d.unwrapping.running import unwrap

__all__ = ["warm_up", "warm_up_elsewhere"]

COMMAND = "from napari_phase4d.unwrapping.warming import warm_up; warm_up()"


def warm_up() -> None:
    """Run every method on a little phase, which compiles what it needs and keeps it on disk."""
    noise = np.random.default_rng(0).uniform(-3, 3, (3, 2, 24, 24)).astype(np.float32)
    for method in BUILT_IN:
        unwrap(noise, method)


@functools.cache
def warm_up_elsewhere() -> subprocess.Popen[bytes] | None:
    """Let another process compile, once, if it has not been done before; return that process.

    Compiling holds the interpreter's lock for ten seconds or so, in which a window of this
    process could not be used.
    """
    done = all(is_on_disk(kernel) for kernel in (integrated, sink_side))
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
