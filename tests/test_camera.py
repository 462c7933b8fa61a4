"""A camera through Micro-Manager, whose own simulated one stands for all: no frame is lost."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from napari_phase4d.io import FromCamera
from napari_phase4d.pipeline import watch

mm = pytest.importorskip("pymmcore_plus", exc_type=ImportError)
pytest.importorskip("mm_test_adapters", exc_type=ImportError)

SIDE, FRAMES = 256, 40
#: Its waves are fringes: one view, and the simulated camera shifts them from frame to frame.
RECIPE = p4d.Recipe(
    lobes=(p4d.Lobe((0.005, 0.047), 0.025),), methods=("temporal", "spatial-2d"),
    background="none", drift=False, mask=None,
)  # fmt: skip


@pytest.fixture
def core() -> Iterator[Any]:
    found = mm.CMMCorePlus()
    found.loadSystemConfiguration("MMConfig_demo.cfg")
    found.setProperty("Camera", "PixelType", "8bit")
    found.setProperty("Camera", "StripeWidth", 6)
    found.setROI(0, 0, SIDE, SIDE)
    found.setExposure(20)
    yield found
    if found.isSequenceRunning():
        found.stopSequenceAcquisition()
    found.reset()


def numbers(folder: Path) -> list[int]:
    return sorted(int(re.findall(r"\d+", path.name)[0]) for path in folder.glob("*.tif"))


@pytest.mark.slow
def test_every_frame_comes_and_gives_what_a_run_gives(core: Any, tmp_path: Path) -> None:
    camera = FromCamera(core, tmp_path / "cell", FRAMES)
    seen: list[int] = []
    told: list[str] = []
    outcome = watch(
        camera, RECIPE, tmp_path / "live",
        arrived=lambda index, _: seen.append(index), told=told.append,
    )  # fmt: skip
    assert (camera.written, camera.dropped, camera.ended) == (FRAMES, 0, True)
    assert seen == numbers(tmp_path / "cell") == list(range(FRAMES))
    assert not [line for line in told if "never came" in line or "no room" in line]
    again = p4d.run(p4d.Recipe.from_file(tmp_path / "live" / "recipe.json"))
    for method in RECIPE.methods:
        live = outcome.comparison.results[method].values
        np.testing.assert_array_equal(live, again.comparison.results[method].values)
        assert live.shape[0] == FRAMES
    assert np.ptp(live, axis=0).max() > 0.1  # something moves


@pytest.mark.slow
def test_frames_that_the_buffer_has_no_room_for_are_counted_and_said(
    core: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is slow for a moment, and a buffer of few frames."""
    monkeypatch.setattr("napari_phase4d.io.camera.BUFFER_MB", 1)
    core.setExposure(2)
    write = FromCamera._write

    def slowly(self: FromCamera, number: int, frame: Any) -> None:
        if self.written == 12:
            import time

            time.sleep(0.3)
        write(self, number, frame)

    monkeypatch.setattr(FromCamera, "_write", slowly)
    told: list[str] = []
    camera = FromCamera(core, tmp_path / "cell", 200)
    outcome = watch(camera, RECIPE, tmp_path / "live", told=told.append)
    kept = numbers(tmp_path / "cell")
    assert camera.dropped == 200 - len(kept) > 0
    assert camera.written == len(kept)
    (line,) = (line for line in told if "no room" in line)
    assert str(camera.dropped) in line
    known = np.isfinite(outcome.comparison.results["temporal"].values).all((1, 2, 3))
    assert np.flatnonzero(known).tolist() == kept


@pytest.mark.slow
def test_it_ends_when_told_to(core: Any, tmp_path: Path) -> None:
    seen: list[int] = []
    outcome = watch(
        FromCamera(core, tmp_path / "cell"), RECIPE, tmp_path / "live",
        arrived=lambda index, _: seen.append(index), stopped=lambda: len(seen) >= 20,
    )  # fmt: skip
    assert not core.isSequenceRunning()
    n_frames = len(numbers(tmp_path / "cell"))
    assert n_frames >= 20
    assert outcome.reconstruction.sizes["time"] == n_frames


def test_frames_that_are_there_are_not_mixed_with_new_ones(core: Any, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "frame_000000.tif", np.zeros((8, 8), "u1"))
    with pytest.raises(OSError, match="choose an empty folder for the frames"):
        watch(FromCamera(core, tmp_path, 5), RECIPE, tmp_path / "out")
    assert numbers(tmp_path) == [0]


@pytest.mark.slow
def test_a_camera_that_fails_says_so_in_one_sentence(core: Any, tmp_path: Path) -> None:
    core.setProperty("Camera", "PixelType", "32bitRGB")
    with (
        pytest.raises(OSError, match=r"the camera stopped after 0 frames \(.*colour"),
        FromCamera(core, tmp_path, 5) as camera,
    ):
        camera.finish()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda core: FromCamera("demo", "x"), "core must be a CMMCorePlus"),
        (lambda core: FromCamera(core, "x", 0), "frames must be a number of frames"),
        (lambda core: FromCamera(mm.CMMCorePlus(), "x"), "has no camera"),
    ],
)
def test_what_can_not_be_is_refused(core: Any, call: Any, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        call(core)


def test_a_configuration_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.cfg").write_text("Device,A,B\n")
    for name in ("missing.cfg", "broken.cfg"):
        with pytest.raises(OSError, match=f"{name} can't be loaded"):
            FromCamera.configured(tmp_path / name, tmp_path / "frames")
    assert FromCamera.configured("demo", tmp_path / "frames").frames is None


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    from test_guarding import run

    RECIPE.to_file(tmp_path / "recipe.json")
    code = run(
        "watch", tmp_path / "recipe.json", tmp_path / "cell", "--camera", "demo",
        "--frames", 20, "--out", tmp_path / "live",
    )  # fmt: skip
    assert code == 0
    assert numbers(tmp_path / "cell") == list(range(20))
    assert "files" in json.loads((tmp_path / "live" / "run.json").read_text())
