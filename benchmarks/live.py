"""A recording that is worked on while it is written: with how many frames a second it keeps up.

First all files are there already, which tells how many a second can be done. Then another process
writes them at a rate below that, as a camera does: what counts is that no frame is dropped, and
how long after its file each phase is there.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tifffile

import napari_phase4d as p4d
from napari_phase4d.io import FromCamera
from napari_phase4d.pipeline import watch

FRAME = (512, 640)
SHORT, FRAMES = 24, 240
#: At what a camera is asked for, and for how many frames.
CAMERA_FRAME, CAMERA_RATE, CAMERA_FRAMES = (512, 512), 30.0, 1000
#: Share of what can be done a second at which frames are written then.
OF_THE_RATE = 0.8
RECIPE = p4d.Recipe(n_views=2)
#: The waves of Micro-Manager's simulated camera as fringes: one view.
WAVES = p4d.Recipe(
    lobes=(p4d.Lobe((0.005, 0.047), 0.025),), background="none", drift=False, mask=None,
)  # fmt: skip
METHODS = {
    "T/A": ("temporal-angular",),
    "all that need the past only": (
        "spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal",
    ),
}  # fmt: skip


def save_short(path: Path, shape: tuple[int, int]) -> None:
    """Simulate a short video."""
    exact = p4d.simulation.swimming_euglena(shape, SHORT, pixel_um=5.2 / 60, peak_rad=8)
    np.save(path, p4d.simulation.multiplexed_video(exact["phase"]).holograms.values)


def write(short: Path, folder: Path, rate: float, n_frames: int = FRAMES) -> None:
    """Write frames at a rate, each as a file; to and fro, as long as is asked for."""
    frames = np.load(short)
    folder.mkdir()
    began = time.monotonic()
    for number in range(n_frames):
        place = number % (2 * SHORT - 2)
        frame = frames[min(place, 2 * SHORT - 2 - place)]
        if rate:
            time.sleep(max(0.0, began + number / rate - time.monotonic()))
        tifffile.imwrite(folder / f"frame_{number:06}.tif", frame)


def watched(
    folder: Path,
    out: Path,
    methods: tuple[str, ...],
    n_frames: int = FRAMES,
    source: FromCamera | None = None,
    recipe: p4d.Recipe | None = None,
) -> tuple[float, list[float], int]:
    """Return frames a second behind the first ones, how late each frame was, and those lost."""
    late: list[float] = []
    when: list[float] = []

    def arrived(index: int, _: object) -> None:
        when.append(time.time())
        late.append(when[-1] - (folder / f"frame_{index:06}.tif").stat().st_mtime)

    found = watch(source or folder, recipe or RECIPE.changed(methods=methods), out,
                  frames=n_frames, arrived=arrived)  # fmt: skip
    lost = len(found.reconstruction.attrs["lost_times"])
    first = n_frames // 8
    return (n_frames - first) / (when[-1] - when[first - 1]), late[first:], lost


def written_meanwhile(
    short: Path, camera: Path, rate: float, n_frames: int, methods: tuple[str, ...]
) -> tuple[list[float], int]:
    """Return how late each frame was that another process wrote, and how many were lost."""
    words = [sys.executable, __file__, short, camera, str(rate), str(n_frames)]
    writer = subprocess.Popen(words)
    _, late, lost = watched(camera, camera.with_name(f"{camera.name}_out"), methods, n_frames)
    writer.wait()
    return late, lost


def camera_lines(place: Path) -> Iterator[str]:
    """Rows of Micro-Manager's simulated camera, if it is installed."""
    try:
        from pymmcore_plus import CMMCorePlus
    except ImportError:
        yield "pymmcore-plus is not installed: no camera was tried."
        return
    yield (
        f"Micro-Manager's simulated camera, {CAMERA_FRAMES} frames of 512 x 512, one view, 2-D; "
        f"lateness from the {CAMERA_FRAMES // 8}th on"
    )
    yield ""
    yield "| frames/s | written | dropped | late, median | late, 95 of 100 | late, at most |"
    yield "|---|---|---|---|---|---|"
    core = CMMCorePlus()
    core.loadSystemConfiguration("MMConfig_demo.cfg")
    core.setProperty("Camera", "PixelType", "8bit")
    core.setProperty("Camera", "StripeWidth", 3)
    recipe = WAVES.changed(methods=("spatial-2d",))
    for rate in (CAMERA_RATE, 2 * CAMERA_RATE):
        core.setExposure(1000 / rate)
        folder = place / f"camera_{rate:g}"
        camera = FromCamera(core, folder, CAMERA_FRAMES)
        _, late, _ = watched(
            folder, place / f"{folder.name}_out", (), CAMERA_FRAMES, camera, recipe
        )
        yield (
            f"| {rate:g} | {camera.written} | {camera.dropped} | {np.median(late):.2f} s "
            f"| {np.quantile(late, 0.95):.2f} s | {max(late):.2f} s |"
        )


def lines() -> Iterator[str]:
    """Rows: how fast, at which rate it was tried, and how late frames were then."""
    yield (
        f"{FRAMES} TIFF files of {FRAME[0]} x {FRAME[1]}, two views, one run; results on disk, "
        "not counting what is done at the end"
    )
    yield ""
    yield "| methods | frames/s it can do | written at | dropped | late, median | late, at most |"
    yield "|---|---|---|---|---|---|"
    place = Path(tempfile.mkdtemp(prefix="phase4d-bench-"))
    try:
        short = place / "short.npy"
        save_short(short, FRAME)
        write(short, place / "all", 0)
        for number, (name, methods) in enumerate(METHODS.items()):
            watched(place / "all", place / f"first{number}", methods)  # loads and compiles
            rate, _, _ = watched(place / "all", place / f"rate{number}", methods)
            camera = place / f"camera{number}"
            tried = OF_THE_RATE * rate
            late, lost = written_meanwhile(short, camera, tried, FRAMES, methods)
            yield (
                f"| {name} | {rate:.0f} | {tried:.0f} frames/s | {lost} "
                f"| {np.median(late):.2f} s | {max(late):.2f} s |"
            )
        yield ""
        yield (
            f"{CAMERA_FRAMES} TIFF files of {CAMERA_FRAME[0]} x {CAMERA_FRAME[1]}, two views, "
            f"written at {CAMERA_RATE:g} frames/s; lateness from the {CAMERA_FRAMES // 8}th on"
        )
        yield ""
        yield "| methods | dropped | late, median | late, 95 of 100 | late, at most |"
        yield "|---|---|---|---|---|"
        save_short(short, CAMERA_FRAME)
        for number, (name, methods) in enumerate(METHODS.items()):
            camera = place / f"steady{number}"
            late, lost = written_meanwhile(short, camera, CAMERA_RATE, CAMERA_FRAMES, methods)
            yield (
                f"| {name} | {lost} | {np.median(late):.2f} s | {np.quantile(late, 0.95):.2f} s "
                f"| {max(late):.2f} s |"
            )
        yield ""
        yield from camera_lines(place)
    finally:
        shutil.rmtree(place, ignore_errors=True)


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))
