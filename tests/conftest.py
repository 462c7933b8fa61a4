"""Data that several tests share."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
import traceback
import tracemalloc
from collections.abc import Callable, Iterator

import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe
from napari_phase4d.recording import Recording
from napari_phase4d.sample import Sample, euglena_sample
from napari_phase4d.task import THREADS


def pytest_configure(config: pytest.Config) -> None:
    """Give each of several test processes its own screen: they would share a mouse."""
    if "PYTEST_XDIST_WORKER" not in os.environ or shutil.which("Xvfb") is None:
        return
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1600x1000x24"]
    server = subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as numbers:
        os.environ["DISPLAY"] = f":{numbers.readline().strip()}"

    def end() -> None:
        server.terminate()
        server.wait()

    config.add_cleanup(end)


def at_work() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith(THREADS)]


def join_threads() -> None:
    # Looked at rather than joined: one that is being started can't be joined yet.
    latest = time.monotonic() + 20
    while (threads := at_work()) and time.monotonic() < latest:
        time.sleep(0.005)
    for thread in threads:
        where = traceback.format_stack(sys._current_frames().get(thread.ident or 0))
        pytest.fail(f"{thread.name} goes on after it was cancelled:\n{''.join(where)}")


@pytest.fixture(autouse=True)
def threads_end() -> Iterator[Callable[[], None]]:
    """Let work that was cancelled come to its end, so that no other test pays for it."""
    yield join_threads
    join_threads()


@pytest.fixture
def traced_memory() -> Iterator[None]:
    """Let `measured` count memory to the byte; nothing else may run when this ends."""
    tracemalloc.start()
    yield
    join_threads()
    tracemalloc.stop()


@pytest.fixture(scope="session")
def sample() -> Sample:
    return euglena_sample()


@pytest.fixture(scope="session")
def lobes(sample: Sample) -> list[Lobe]:
    return p4d.find_lobes(sample.recording, 2, angles_deg=sample.angles_deg)


@pytest.fixture(scope="session")
def reconstruction(sample: Sample, lobes: list[Lobe]) -> xr.Dataset:
    return p4d.reconstruct(sample.recording, lobes)


@pytest.fixture(scope="session")
def truth(sample: Sample, reconstruction: xr.Dataset) -> xr.DataArray:
    return sample.truth(reconstruction["phase"])


@pytest.fixture(scope="session")
def small_video() -> Recording:
    """Six small frames with two views, quick to work on."""
    exact = p4d.simulation.swimming_euglena((128, 128), 6, pixel_um=5.2 / 60 * 4, peak_rad=6)
    return p4d.simulation.multiplexed_video(exact["phase"], name="small video")
