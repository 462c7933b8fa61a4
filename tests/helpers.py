"""What tests need besides fixtures."""

from __future__ import annotations

import os
import runpy
import signal
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from scipy.stats import rankdata

from napari_phase4d.cli import main

ROOT = Path(__file__).resolve().parents[1]
#: Where measured files are that the repository does not hold.
MEASURED = Path(os.environ.get("PHASE4D_MEASURED", ROOT.parent / "shared" / "data"))


def measured(name: str) -> Path:
    """Return a measured file, or skip the test."""
    path = MEASURED / name
    if not path.exists():
        pytest.skip(f"measured data {name} is not part of the repository and not on this machine")
    return path


def hear_signals() -> None:
    """Let a program that is started be ended: for ``preexec_fn``.

    What a shell starts in the background, or under nohup, ignores some signals, and what that
    starts inherits it.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def wrap(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(phase)))


def area_under_curve(score: np.ndarray, wrong: np.ndarray) -> float:
    """Return how often what is wrong scores higher than what is right."""
    n = wrong.sum()
    return float((rankdata(score)[wrong].sum() - n * (n + 1) / 2) / (n * (~wrong).sum()))


@dataclass(frozen=True)
class Ended:
    """What a shell gets of a command."""

    returncode: int
    stdout: str
    stderr: str


def command(*arguments: object, cwd: Path) -> Ended:
    """Give a command in a folder, in this process: starting Python takes seconds each time."""
    out, err, code = StringIO(), StringIO(), 0
    line = ["napari-phase4d", *map(str, arguments)]
    with chdir(cwd), redirect_stdout(out), redirect_stderr(err), patch.object(sys, "argv", line):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
            if isinstance(end.code, str):  # as Python does
                err.write(f"{end.code}\n")
    return Ended(code, out.getvalue(), err.getvalue())


def run_script(script: Path) -> None:
    """Run a script in its own folder, in this process; it has nothing to complain of."""
    err = StringIO()
    with chdir(script.parent), redirect_stderr(err):
        runpy.run_path(script.name, run_name="__main__")
    assert not err.getvalue()
