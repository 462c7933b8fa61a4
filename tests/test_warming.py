"""Compiling ahead of the first use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from napari_phase4d.pipeline import running

SCRIPT = """
from napari_phase4d.compiling import is_on_disk
from napari_phase4d.unwrapping.directional.least_turns import sink_side
from napari_phase4d.unwrapping.growing.rows import integrated
from napari_phase4d.pipeline.running import warm_up_elsewhere

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


@pytest.mark.parametrize("executable", [None, "", "/nowhere/python"])
def test_a_program_without_an_interpreter_goes_on(
    executable: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "is_on_disk", lambda _: False)
    monkeypatch.setattr(sys, "executable", executable)
    # Past the cache, which may hold a process that a window has started.
    assert running.warm_up_elsewhere.__wrapped__() is None
