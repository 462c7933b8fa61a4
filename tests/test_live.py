"""A recording that is worked on while it is written gives what the finished one gives."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr
from numpy.typing import NDArray

import napari_phase4d as p4d
from helpers import hear_signals
from napari_phase4d.io import read_results
from napari_phase4d.io.sequences import Numbering, pattern_of
from napari_phase4d.pipeline import LiveStatus, Outcome, watch
from napari_phase4d.pipeline.live import Fringes
from napari_phase4d.task import Cancelled

N = 14
FIRST = 5
METHODS = ("spatial-2d", "temporal", "temporal-angular", "directional-l1")
RECIPE = p4d.Recipe(n_views=2, methods=METHODS, first_frames=FIRST)
#: Seconds that tests wait for frames that do not come ...
SHORT = {"patience_s": 5.0, "frame_patience_s": 2.0}
#: ... and for those that do, on a machine that has much else to do.
LONG = {"patience_s": 40.0, "frame_patience_s": 30.0}

Video = NDArray[np.uint8]
Frames = dict[int, dict[str, NDArray[np.float32]]]


@pytest.fixture(scope="module")
def video() -> Video:
    """Camera frames; the camera lost one of them."""
    exact = p4d.simulation.swimming_euglena((64, 64), N, pixel_um=0.7, peak_rad=9)
    frames = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values.copy()
    frames[10] = 7
    return frames


@contextmanager
def written(work: Callable[[], None]) -> Iterator[threading.Thread]:
    """Write a recording in a thread, and see that it did."""
    faults: list[Exception] = []

    def write() -> None:
        try:
            work()
        except Exception as error:
            faults.append(error)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield thread
    finally:
        thread.join()
    assert not faults, faults


class Heard:
    """What a watch tells."""

    def __init__(self, pause: float = 0.0) -> None:
        self.lines: list[str] = []
        self.status: list[LiveStatus] = []
        self.frames: Frames = {}
        self.when: dict[int, float] = {}
        self.order: list[int] = []
        self._pause = pause

    def arrived(self, index: int, results: Any) -> None:
        self.order.append(index)
        self.when[index] = time.monotonic()
        self.frames[index] = {name: values.copy() for name, values in results.items()}
        time.sleep(self._pause)

    def calls(self) -> dict[str, Any]:
        return {
            "arrived": self.arrived,
            "told": self.lines.append,
            "status": self.status.append,
        }


def name(number: int) -> str:
    return f"run3_frame_{number}.tif"


def put(folder: Path, number: int, frame: Video) -> None:
    folder.mkdir(exist_ok=True)
    tifffile.imwrite(folder / name(number), frame)


def as_bytes(frame: Video) -> bytes:
    held = io.BytesIO()
    tifffile.imwrite(held, frame)
    return held.getvalue()


def same_as_a_run(out: Path, heard: Heard, recording: p4d.Recording | None = None) -> Outcome:
    """See that a run with the recipe that was written gives what was written and told."""
    recipe = p4d.Recipe.from_file(out / "recipe.json")
    again = p4d.run(recipe, recording)
    stacks: dict[str, xr.DataArray] = {
        "wrapped": again.reconstruction["phase"],
        "amplitude": again.reconstruction["amplitude"],
        **again.comparison.results,
    }
    for stack, expected in stacks.items():
        found = read_results(out / f"{stack}.ome.zarr")
        np.testing.assert_array_equal(found.values, expected.values)
        for axis in found.dims:
            np.testing.assert_array_equal(found[axis].values, expected[axis].values)
        for index, results in heard.frames.items():
            if stack in results:
                np.testing.assert_array_equal(results[stack], expected.values[index])
    assert heard.order == list(range(len(heard.frames)))
    assert set(heard.frames[0]) == {"wrapped", "amplitude", *METHODS[:-1]}
    return again


# ---- three ways to grow ----------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.slow
def test_a_folder_that_gets_files_in_bursts(video: Video, tmp_path: Path) -> None:
    folder, out, heard = tmp_path / "camera", tmp_path / "out", Heard()

    def write() -> None:
        time.sleep(0.2)
        for number, frame in enumerate(video, 1):
            put(folder, number, frame)
            time.sleep(0.4 if number % 4 == 0 else 0.0)

    with written(write):
        found = watch(folder, RECIPE, out, frames=N, **LONG, **heard.calls())
    again = same_as_a_run(out, heard)
    assert len(heard.frames) == N
    assert np.isnan(heard.frames[10]["temporal"]).all()
    assert found.recipe.boundary == again.recipe.boundary
    assert found.recipe.boundary[0][0] == 0
    assert len(found.recipe.lobes) == 2
    assert list(found.comparison.table.index) == list(METHODS)
    for method, result in found.comparison.results.items():
        other = again.comparison.results[method]
        assert {k: v for k, v in result.attrs.items() if k != "provenance"} == other.attrs
    noted = json.loads((out / "run.json").read_text())
    assert {f["name"] for f in noted["files"]} >= {"recipe.json", "table.csv", "wrapped.ome.zarr"}
    assert not list(out.glob(".*"))


@pytest.mark.slow
def test_a_tiff_whose_bytes_come_in_any_portion(video: Video, tmp_path: Path) -> None:
    whole, growing, heard = tmp_path / "whole.tif", tmp_path / "growing.tif", Heard()
    for number, frame in enumerate(video):
        tifffile.imwrite(whole, frame, append=number > 0, metadata=None)
    content = whole.read_bytes()
    portion = 3001

    def write() -> None:
        with growing.open("wb", buffering=0) as file:
            for start in range(0, len(content), portion):
                file.write(content[start : start + portion])
                time.sleep(0.03)

    with written(write):
        watch(growing, RECIPE, tmp_path / "out", frames=N, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert len(heard.frames) == N
    found, gone, back, end = heard.lines
    assert found.startswith("found on the first 5 frames: 2 views")
    assert gone == "frame 10: the fringes of all views are gone or weak"
    assert back == "frame 11: the fringes of all views are back"
    assert end == "all frames are there; unwrapping by WL1"


@pytest.mark.slow
def test_a_beam_that_is_blocked_is_said_at_once(tmp_path: Path) -> None:
    """While it can be mended; the others go on."""
    phase = p4d.simulation.swimming_euglena((64, 64), N, pixel_um=0.7, peak_rad=9)["phase"]
    frames = p4d.simulation.multiplexed_video(phase).holograms.values.copy()
    blocked = p4d.simulation.multiplexed_video(phase, beam_amplitudes=[1.0, 1e-6]).holograms
    frames[6:9] = blocked.values[6:9]
    folder, heard = tmp_path / "camera", Heard()
    for number, frame in enumerate(frames):
        put(folder, number, frame)
    outcome = watch(folder, RECIPE, tmp_path / "out", frames=N, **LONG, **heard.calls())
    assert "frame 6: the fringes of view 2 are gone or weak" in heard.lines
    assert "frame 9: the fringes of view 2 are back" in heard.lines
    assert sum("fringes of" in line for line in heard.lines) == 2
    lost = np.isnan(outcome.comparison.results["temporal-angular"]).all(["y", "x"]).values
    assert np.argwhere(lost).tolist() == [[6, 1], [7, 1], [8, 1]]
    with pytest.warns(UserWarning, match="3 frames of 14 left out in view 2"):
        same_as_a_run(tmp_path / "out", heard)


def test_what_flickers_is_not_said_for_ever() -> None:
    fringes, known = Fringes(2), np.zeros((2, 4, 4), np.float32)
    gone = known.copy()
    gone[1] = np.nan
    said = [fringes.changed(frame) for _ in range(50) for frame in (known, gone)]
    assert said[:3] == [
        "",
        "the fringes of view 2 are gone or weak",
        "the fringes of view 2 are back",
    ]
    assert sum(map(bool, said)) == 10
    assert said[10].endswith("are back, and so on: of view 2 no more is said")
    assert fringes.changed(gone[::-1]) == "the fringes of view 1 are gone or weak"
    assert Fringes(1).changed(gone[1:]) == "the fringes of the view are gone or weak"


@pytest.mark.slow
def test_a_tiff_to_which_pages_are_appended(video: Video, tmp_path: Path) -> None:
    growing, heard = tmp_path / "growing.tif", Heard()

    def write() -> None:
        for number, frame in enumerate(video):
            tifffile.imwrite(growing, frame, append=number > 0)
            time.sleep(0.1)

    with written(write):
        watch(growing, RECIPE, tmp_path / "out", frames=N, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert len(heard.frames) == N


@pytest.mark.thorough
@pytest.mark.parametrize("frames_a_piece", [1, 4])
def test_a_zarr_that_is_longer_before_its_frames_are_there(
    video: Video, tmp_path: Path, frames_a_piece: int
) -> None:
    store, heard = tmp_path / "growing.zarr", Heard()
    height, width = video.shape[1:]

    def write() -> None:
        chunks = (frames_a_piece, height // 2, width)
        array = zarr.create_array(
            store, shape=(0, height, width), chunks=chunks, dtype=video.dtype
        )
        for number, frame in enumerate(video):
            array.resize((number + 1, height, width))
            time.sleep(0.15 if number % 3 == 0 else 0)
            array[number, : height // 2] = frame[: height // 2]
            time.sleep(0.15 if number % 4 == 0 else 0)
            array[number, height // 2 :] = frame[height // 2 :]

    with written(write):
        watch(store, RECIPE, tmp_path / "out", frames=N, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert len(heard.frames) == N


# ---- what goes wrong on the way --------------------------------------------------------------


@pytest.mark.slow
def test_a_half_written_file_is_waited_for(video: Video, tmp_path: Path) -> None:
    folder, heard, whole_at = tmp_path / "camera", Heard(), []

    def write() -> None:
        for number, frame in enumerate(video[:8]):
            if number != 6:
                put(folder, number, frame)
                continue
            content = as_bytes(frame)
            with (folder / name(6)).open("wb", buffering=0) as file:
                for part in (content[:4], content[4:2000], content[2000:]):
                    time.sleep(0.35)  # more than what settles it, less than the patience
                    whole_at.append(time.monotonic())
                    file.write(part)

    with written(write):
        watch(folder, RECIPE, tmp_path / "out", frames=8, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert heard.when[6] >= whole_at[-1]
    assert len(heard.frames) == 8


@pytest.mark.thorough
@pytest.mark.parametrize("dark_ends", [False, True])
def test_a_file_that_is_as_long_before_its_pixels_are_there(
    video: Video, tmp_path: Path, *, dark_ends: bool
) -> None:
    folder, heard, whole_at = tmp_path / "camera", Heard(), []
    frames = video[:8].copy()
    if dark_ends:
        frames[:, -2:] = 0
    content = as_bytes(frames[6])
    picture = content.rindex(frames[6].tobytes())
    empty = content[:picture] + bytes(len(content) - picture)

    def write() -> None:
        for number in range(6):
            put(folder, number, frames[number])
        while len(heard.frames) < 6:
            time.sleep(0.02)
        put(folder, 7, frames[7])
        with (folder / name(6)).open("wb", buffering=0) as file:
            file.write(empty)
            time.sleep(0.3)  # more than what settles it
            file.seek(picture)
            whole_at.append(time.monotonic())
            file.write(content[picture:])

    with written(write):
        limits = SHORT if dark_ends else {"patience_s": 40.0, "frame_patience_s": 4.0}
        watch(folder, RECIPE, tmp_path / "out", frames=8, **limits, **heard.calls())
    assert len(heard.frames) == 8
    if not dark_ends:
        same_as_a_run(tmp_path / "out", heard)
        assert heard.when[6] >= whole_at[0]


@pytest.mark.thorough
def test_few_frames_with_a_gap_among_them(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in (0, 1, 2, 4, 5):
        put(folder, number, video[number])
    recipe = RECIPE.changed(first_frames=8)
    found = watch(folder, recipe, tmp_path / "out", **SHORT, **heard.calls())
    assert found.reconstruction.attrs["lost_times"] == [3]
    assert found.recipe.first_frames == len(heard.frames) == 6


@pytest.mark.slow
def test_files_that_come_in_any_order(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()

    def write() -> None:
        for number in (5, 0, 1, 4, 3, 6, 7):
            put(folder, number, video[number])
        time.sleep(0.4)
        for number in (2, 9, 8, 11, 10):
            put(folder, number, video[number])
            time.sleep(0.08)

    with written(write):
        found = watch(folder, RECIPE, tmp_path / "out", frames=12, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert len(heard.frames) == 12
    assert found.recipe.first_frames == FIRST


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*left out as lost")
def test_a_frame_that_never_comes_is_said_and_unknown(video: Video, tmp_path: Path) -> None:
    folder, out, heard = tmp_path / "camera", tmp_path / "out", Heard()
    for number in (1, 2, 3, 4, 5, 6, 8, 9):
        put(folder, number, video[number])
    (folder / name(9)).write_bytes(as_bytes(video[9])[:2000])
    found = watch(folder, RECIPE, out, **SHORT, **heard.calls())
    assert "frame 7 never came" in heard.lines
    assert any(line.startswith("frame 9 can't be read") for line in heard.lines)
    assert heard.status[-1].lost == 2
    assert found.reconstruction.attrs["lost_times"] == [6, 8]
    with_gap = video[1:10].copy()
    with_gap[[6, 8]] = 0
    same_as_a_run(out, heard, p4d.open_recording(with_gap, found.recipe.optics))
    for index, results in heard.frames.items():
        assert all(np.isnan(r).all() == (index in (6, 8)) for r in results.values())


@pytest.mark.thorough
def test_a_long_gap_costs_one_patience(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in (*range(6), 60):
        put(folder, number, video[number % N])
    began = time.monotonic()
    watch(folder, RECIPE.changed(methods=("spatial-2d",)), tmp_path / "out", **SHORT,
          **heard.calls())  # fmt: skip
    assert len(heard.frames) == 61
    assert time.monotonic() - began < 60  # 54 patiences are 108 s


@pytest.mark.thorough
def test_a_slow_program_loses_nothing(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard(pause=0.25)

    def write() -> None:
        for number, frame in enumerate(video):
            put(folder, number, frame)
            time.sleep(0.02)

    with written(write):
        watch(folder, RECIPE, tmp_path / "out", frames=N, **LONG, **heard.calls())
    same_as_a_run(tmp_path / "out", heard)
    assert len(heard.frames) == N
    assert max(status.behind for status in heard.status) > 3


@pytest.mark.slow
def test_what_is_no_frame_is_left_out_and_said(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in range(3, 9):
        put(folder, number, video[number])

    def write() -> None:
        while len(heard.frames) < 6:
            time.sleep(0.05)
        put(folder, 1, video[1])
        tifffile.imwrite(folder / "background.tif", video[0])
        put(folder, 9, video[9])

    with written(write):
        watch(folder, RECIPE, tmp_path / "out", frames=7, **LONG, **heard.calls())
    assert len(heard.frames) == 7
    assert f"{name(1)} came too late, and is left out" in heard.lines
    assert "background.tif has another name than the frames, and is left out" in heard.lines


@pytest.mark.slow
def test_decimal_times_in_names_are_no_late_frames(video: Video, tmp_path: Path) -> None:
    """By whole numbers, 1.5 is before 1.25."""
    folder, heard = tmp_path / "camera", Heard()
    folder.mkdir()
    names = [f"t_{0.25 * n}.tif" for n in range(9)]
    for n in range(6):
        tifffile.imwrite(folder / names[n], video[n])

    def write() -> None:
        for n in range(6, 9):
            while len(heard.frames) < n:
                time.sleep(0.05)
            tifffile.imwrite(folder / names[n], video[n])

    with written(write):
        watch(folder, RECIPE, tmp_path / "out", frames=9, **LONG, **heard.calls())
    assert len(heard.frames) == 9
    assert not [line for line in heard.lines if "too late" in line]


@pytest.mark.slow
def test_a_view_to_start_at_must_be_there(video: Video, tmp_path: Path) -> None:
    """It is refused on the first frames, not when all have been worked on."""
    folder, heard = tmp_path / "camera", Heard()
    for number in range(6):
        put(folder, number, video[number])
    with pytest.raises(ValueError, match=r"angle 5\) does not exist"):
        watch(folder, RECIPE.changed(boundary=((0, 5),)), tmp_path / "out", frames=6, **LONG,
              **heard.calls())  # fmt: skip
    assert not heard.frames
    watch(folder, RECIPE.changed(boundary=((0, -1),)), tmp_path / "last", frames=6, **LONG,
          **heard.calls())  # fmt: skip
    n_views = len(p4d.Recipe.from_file(tmp_path / "last" / "recipe.json").lobes)
    assert any(line.endswith(f"start at view {n_views}") for line in heard.lines)


@pytest.mark.slow
def test_an_acquisition_that_begins_anew_is_not_mixed_in(video: Video, tmp_path: Path) -> None:
    """The microscopist stops, and starts again into the same folder."""
    folder, heard = tmp_path / "camera", Heard()
    for number in range(9):
        put(folder, number, video[number])

    def write() -> None:
        while len(heard.frames) < 9:
            time.sleep(0.05)
        for number in range(9):
            (folder / name(number)).unlink()
        for number, frame in enumerate(video[::-1]):
            put(folder, number, frame)

    with written(write):
        found = watch(folder, RECIPE, tmp_path / "out", patience_s=60, **heard.calls())
    assert sum("begun anew in camera" in line for line in heard.lines) == 1
    assert any("9 frames of camera were removed or written over" in line for line in heard.lines)
    alone = p4d.run(found.recipe, p4d.open_recording(video[:9], found.recipe.optics))
    for method, result in found.comparison.results.items():
        np.testing.assert_array_equal(result.values, alone.comparison.results[method].values)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["input"] == {"name": "camera"}
    assert found.recording is not None
    assert not found.recording.holograms.values.any()
    assert [note.split(":")[0] for note in found.recording.notes[-2:]] == [
        "An acquisition has begun anew in camera",
        "9 frames of camera were removed or written over since they were read",
    ]


@pytest.mark.slow
def test_a_script_that_is_told_nothing_is_warned(video: Video, tmp_path: Path) -> None:
    """Of frames that are gone by the end, and of a phase that can't be right."""
    folder = tmp_path / "camera"
    for number in range(9):
        put(folder, number, np.full_like(video[number], 100) if number % 2 else video[number])

    def arrived(index: int, results: Any) -> None:
        if index == 8:
            (folder / name(0)).unlink()

    recipe = RECIPE.changed(methods=("spatial-2d",))
    with (
        pytest.warns(UserWarning, match="1 frame of camera was removed or written over"),
        pytest.warns(UserWarning, match="4 frames of 9 left out as lost"),
    ):
        watch(folder, recipe, tmp_path / "out", frames=9, arrived=arrived)


# ---- how it ends -----------------------------------------------------------------------------


@pytest.mark.slow
def test_it_ends_when_told_to_and_writes_what_came(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in range(7):
        put(folder, number, video[number])
    found = watch(folder, RECIPE, tmp_path / "out", patience_s=60,
                  stopped=lambda: len(heard.frames) >= 7, **heard.calls())  # fmt: skip
    assert found.comparison.results["directional-l1"].sizes["time"] == 7
    same_as_a_run(tmp_path / "out", heard)


@pytest.mark.slow
def test_it_ends_after_so_many_frames(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in range(N):
        put(folder, number, video[number])
    found = watch(folder, RECIPE, tmp_path / "out", frames=9, form="tiff", **heard.calls())
    assert len(heard.frames) == found.reconstruction.sizes["time"] == 9
    result = read_results(tmp_path / "out" / "directional-l1.ome.tif")
    same = p4d.run(found.recipe, p4d.open_recording(video[:9], found.recipe.optics))
    np.testing.assert_array_equal(result.values, same.comparison.results["directional-l1"].values)


@pytest.mark.slow
def test_what_is_cancelled_leaves_nothing(video: Video, tmp_path: Path) -> None:
    folder, heard = tmp_path / "camera", Heard()
    for number in range(N):
        put(folder, number, video[number])
    with pytest.raises(Cancelled):
        watch(folder, RECIPE, tmp_path / "out", cancelled=lambda: len(heard.frames) > 3,
              **heard.calls())  # fmt: skip
    assert not (tmp_path / "out").exists()


def test_nothing_that_comes_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="no frame came to .*nowhere"):
        watch(tmp_path / "nowhere", RECIPE, tmp_path / "out", patience_s=0.2)
    assert not (tmp_path / "out").exists()


def test_results_of_others_are_not_written_over(video: Video, tmp_path: Path) -> None:
    folder = tmp_path / "camera"
    put(folder, 0, video[0])
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "table.csv").write_text("mine")
    with pytest.raises(OSError, match="was not made by a run"):
        watch(folder, RECIPE, tmp_path / "out", **SHORT)
    assert (tmp_path / "out" / "table.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"boundary": ((3, 0),)}, "boundary at time 0"),
        ({"confidence": True}, "leave confidence out"),
        ({"reference": FIRST}, "not among the first"),
        ({"content": "phase"}, "give a recording of holograms"),
    ],
)
def test_settings_that_need_the_whole_recording(
    tmp_path: Path, settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        watch(tmp_path, RECIPE.changed(**settings), tmp_path / "out")


def test_results_do_not_go_among_the_frames(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is what is watched"):
        watch(tmp_path / "camera", RECIPE, tmp_path / "x" / ".." / "camera")
    assert not (tmp_path / "camera").exists()


def test_a_film_can_not_be_watched(tmp_path: Path) -> None:
    (tmp_path / "film.avi").write_bytes(b"RIFF")
    with pytest.raises(ValueError, match=r"film.avi can't be read while it is written"):
        watch(tmp_path / "film.avi", RECIPE, tmp_path / "out")


@pytest.mark.parametrize("limits", [{"frames": 0}, {"patience_s": 0}, {"frame_patience_s": -1}])
def test_limits_that_can_not_be(tmp_path: Path, limits: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(limits))):
        watch(tmp_path, RECIPE, tmp_path / "out", **limits)


# ---- what is settled on the first frames -----------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*median over time shows:UserWarning")
@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"reference": "median", "background": "polynomial"},
        {"reference": 2, "tilt_per_frame": True},
        {"refocus_um": "auto", "background": "curvature"},
    ],
)
def test_later_frames_do_not_change_earlier_ones(video: Video, settings: dict[str, Any]) -> None:
    one = p4d.open_recording(video)
    other = p4d.open_recording(np.concatenate([video[:8], video[-1:], video[:5] // 2]))
    lobes = p4d.find_lobes(one, 2)
    found = [
        p4d.reconstruct(rec, lobes, first_frames=FIRST, **settings)["phase"].values[:8]
        for rec in (one, other)
    ]
    np.testing.assert_array_equal(*found)
    usual = [p4d.reconstruct(rec, lobes, **settings)["phase"].values[:8] for rec in (one, other)]
    assert not np.array_equal(*usual)


@pytest.mark.parametrize(
    ("names", "counted"),
    [
        (["f_1.tif", "f_2.tif", "f_10.tif", "f_3.tif"], [0, 1, 9, 2]),
        (["run2_0007_t118.tif", "run2_0008_t161.tif", "run2_0009_t199.tif"], [0, 1, 2]),
        (["img_channel0_time04_z0.tif", "img_channel0_time05_z0.tif"], [0, 1]),
        (["10-31-12-118.png", "10-31-12-161.png", "10-31-12-199.png"], [None] * 3),
        (["shot3.tif"], [0]),
    ],
)
def test_what_counts_frames(names: list[str], counted: list[int | None]) -> None:
    assert len({pattern_of(name) for name in names}) == 1
    numbering = Numbering(names)
    assert [numbering.index(name) for name in names] == counted


# ---- the command -----------------------------------------------------------------------------


def started(*words: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "napari_phase4d", "watch", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
        preexec_fn=hear_signals,
    )


@pytest.mark.thorough
def test_the_command_on_a_folder_that_grows(video: Video, tmp_path: Path) -> None:
    folder, out = tmp_path / "camera", tmp_path / "out"
    recipe = RECIPE.to_file(tmp_path / "recipe.json")
    with started(folder, recipe, "--out", out, "--patience", "20", "--frames", "9") as program:
        for number in range(9):
            put(folder, number, video[number])
            time.sleep(0.3)
        said, _ = program.communicate(timeout=120)
    assert program.returncode == 0, said
    assert "9 frames seen, 9 done, 0 behind, 0 dropped, phase" in said
    assert "9 frames: results are in" in said
    again = p4d.run(p4d.Recipe.from_file(out / "recipe.json"))
    for method in METHODS:
        found = read_results(out / f"{method}.ome.zarr")
        np.testing.assert_array_equal(found.values, again.comparison.results[method].values)


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_command_that_is_ended_writes_what_came(
    video: Video, tmp_path: Path, number: signal.Signals
) -> None:
    folder, out = tmp_path / "camera", tmp_path / "out"
    for frame in range(6):
        put(folder, frame, video[frame])
    program = started(
        folder, "--views", "2", "--method", "T/A", "--out", out, "--first-frames", "4"
    )
    with program:
        assert program.stdout is not None
        lines = []
        for line in program.stdout:
            lines.append(line)
            if "6 done" in line:
                break
        program.send_signal(number)
        said = "".join(lines) + program.communicate(timeout=120)[0]
    assert program.returncode == 128 + number, said
    assert read_results(out / "temporal-angular.ome.zarr").sizes["time"] == 6


@pytest.mark.thorough
def test_one_that_is_killed_and_started_again_loses_nothing(video: Video, tmp_path: Path) -> None:
    """The camera goes on meanwhile; the second one finds all frames, and what is left is gone."""
    folder, out = tmp_path / "camera", tmp_path / "out"
    recipe = RECIPE.to_file(tmp_path / "recipe.json")
    words = (folder, recipe, "--out", out, "--frames", str(N), "--patience", "60")

    def camera() -> None:
        for number in range(7, N):
            put(folder, number, video[number])
            time.sleep(0.4)

    for number in range(7):
        put(folder, number, video[number])
    with started(*words) as first:
        assert first.stdout is not None
        next(line for line in first.stdout if " done" in line)
        with written(camera):
            first.kill()
            first.wait()
            assert not (out / "table.csv").exists()
            with started(*words) as second:
                said, _ = second.communicate(timeout=200)
    assert second.returncode == 0, said
    assert f"{N} frames: results are in" in said
    assert not [path for path in out.rglob(".*") if path.name != ".zattrs"]
    again = p4d.run(p4d.Recipe.from_file(out / "recipe.json"))
    for method in METHODS:
        found = read_results(out / f"{method}.ome.zarr")
        assert found.sizes["time"] == N
        np.testing.assert_array_equal(found.values, again.comparison.results[method].values)
