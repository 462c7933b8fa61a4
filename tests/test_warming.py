"""Compiling ahead of the first use."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import napari_phase4d
from napari_phase4d import compiling
from napari_phase4d.cli.running import ToldToEndError
from napari_phase4d.pipeline import ahead

SCRIPT = """
from napari_phase4d.compiling import is_on_disk
from napari_phase4d.unwrapping.directional.least_turns import sink_side
from napari_phase4d.unwrapping.growing.rows import integrated
from napari_phase4d.pipeline.ahead import warm_up_elsewhere

assert not is_on_disk(integrated)
process = warm_up_elsewhere()
assert process.wait(600) == 0
assert is_on_disk(integrated)
assert is_on_disk(sink_side)
assert warm_up_elsewhere() is process  # once is enough
warm_up_elsewhere.cache_clear()
assert warm_up_elsewhere() is None  # nothing is left to do
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_another_process_compiles_once_for_all(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", SCRIPT], check=True, env=environment, timeout=900)


#: Sums what a loop of a room makes of one that lies in the package's own folder.
CALLED = """
import numpy as np
from napari_phase4d.holography.emptyfield import write_levelled

out = np.empty((2, 3, 3), np.float32)
write_levelled(np.ones((3, 6), np.float32), *out, False)
print(round(float(out[0].sum()), 3))
"""


@pytest.mark.thorough
def test_a_loop_is_compiled_anew_where_one_that_it_calls_has_changed(tmp_path: Path) -> None:
    shutil.copytree(
        Path(napari_phase4d.__file__).parent,
        tmp_path / "napari_phase4d",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    called = tmp_path / "napari_phase4d" / "phasors.py"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)

    def summed() -> float:
        command = [sys.executable, "-c", CALLED]
        return float(subprocess.check_output(command, env=environment, timeout=300))

    assert summed() == pytest.approx(9 * 2**0.5, abs=1e-3)
    now = "amplitude[y, x] = np.sqrt"
    called.write_text(called.read_text().replace(now, "amplitude[y, x] = 2 * np.sqrt"))
    assert summed() == pytest.approx(18 * 2**0.5, abs=1e-3)


@pytest.mark.parametrize("executable", [None, "", "/nowhere/python"])
def test_a_program_without_an_interpreter_goes_on(
    executable: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead, "is_on_disk", lambda _: False)
    monkeypatch.setattr(sys, "executable", executable)
    # Past the cache, which may hold a process that a window has started.
    assert ahead.warm_up_elsewhere.__wrapped__() is None


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timers of this kind")
@pytest.mark.parametrize("error", [KeyboardInterrupt, ToldToEndError])
def test_what_a_signal_raises_is_no_fault_of_a_loop(
    error: type[KeyboardInterrupt], monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba hands over what a loop returns, and wraps what is raised meanwhile."""

    def stop(*_: object) -> None:
        raise error

    frame = np.zeros((600, 600), np.float32)
    loop = compiling.compiled(slow_loop)
    loop(frame, 1)
    before = signal.signal(signal.SIGALRM, stop)
    try:
        for _ in range(10):
            with pytest.raises(error):
                signal.setitimer(signal.ITIMER_REAL, 0.002)
                while True:
                    loop(frame, 20)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def slow_loop(frame: np.ndarray, times: int) -> tuple[np.ndarray, np.ndarray]:
    out = frame.copy()
    for k in range(times):
        for y in range(frame.shape[0]):
            for x in range(frame.shape[1]):
                out[y, x] += np.sqrt(out[y, x] + np.float32(k))
    return out, out[:3]
