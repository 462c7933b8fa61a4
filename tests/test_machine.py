"""Memory and cores, of the machine and of the container that the program runs in."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from napari_phase4d.machine import cores, cores_of, free_memory

#: Where control groups of the first kind lie, if this machine has them and we may make one.
MEMORY = Path("/sys/fs/cgroup/memory")
LIMIT = 600_000_000
SCRIPT = """
import sys
from napari_phase4d.machine import free_memory
from napari_phase4d.io.video import memory_lacks
print(free_memory())
print(memory_lacks(2e9))
"""


@pytest.fixture
def group() -> Iterator[Path]:
    """A real control group with a limit, within which a process may be started."""
    folder = MEMORY / f"phase4d-{uuid.uuid4().hex[:8]}"
    try:
        folder.mkdir()
        (folder / "memory.limit_in_bytes").write_text(str(LIMIT))
    except OSError as error:
        pytest.skip(f"no control group can be made here: {error}")
    yield folder
    folder.rmdir()


def tree(root: Path, groups: str, files: dict[str, str]) -> Path:
    """The files of a system of other control groups than this machine's."""
    for name, text in {"proc/self/cgroup": groups, **files}.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


def test_without_limits_it_is_the_machine() -> None:
    assert 1 <= cores() <= (os.cpu_count() or 1)
    assert 0 < free_memory() <= psutil.virtual_memory().total


@pytest.mark.slow
def test_a_process_in_a_real_control_group_knows_its_limit(group: Path) -> None:
    enter = f"open({str(group / 'cgroup.procs')!r}, 'w').write('0')\n"
    found = subprocess.run(
        [sys.executable, "-c", enter + SCRIPT],
        check=True, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    free, lacks = found.stdout.splitlines()
    assert 0.5 * LIMIT < int(free) < LIMIT
    assert "of memory are free" in lacks


@pytest.mark.parametrize("seen_as", ["own path", "mounted at the top"])
def test_limits_of_the_second_kind(seen_as: str, tmp_path: Path) -> None:
    inner = "sys/fs/cgroup/pod/box" if seen_as == "own path" else "sys/fs/cgroup"
    root = tree(
        tmp_path,
        "0::/pod/box\n",
        {
            f"{inner}/memory.max": "1000000\n",
            f"{inner}/memory.current": "700000\n",
            f"{inner}/memory.stat": "anon 100\ninactive_file 50000\n",
            f"{inner}/cpu.max": "50000 100000\n",
        },
    )
    assert free_memory(root) == 350_000
    assert cores_of(root) == 1


def test_the_tightest_group_counts(tmp_path: Path) -> None:
    top = "sys/fs/cgroup"
    root = tree(
        tmp_path,
        "0::/pod/box\n",
        {
            f"{top}/pod/box/memory.max": "max\n",
            f"{top}/pod/box/memory.current": "10\n",
            f"{top}/pod/memory.max": "5000\n",
            f"{top}/pod/memory.current": "4000\n",
            f"{top}/pod/box/cpu.max": "max 100000\n",
        },
    )
    assert free_memory(root) == 1000
    assert cores_of(root) == cores()


def test_limits_of_the_first_kind(tmp_path: Path) -> None:
    root = tree(
        tmp_path,
        "4:memory:/docker/abc\n3:cpu,cpuacct:/docker/abc\n",
        {
            "sys/fs/cgroup/memory/memory.limit_in_bytes": "9000\n",
            "sys/fs/cgroup/memory/memory.usage_in_bytes": "9500\n",
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us": "100000\n",
            "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us": "100000\n",
        },
    )
    assert free_memory(root) == 0
    assert cores_of(root) == 1


def test_systems_without_control_groups(tmp_path: Path) -> None:
    assert free_memory(tmp_path) > 0
    assert cores_of(tmp_path) == cores()
