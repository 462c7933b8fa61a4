"""What lies in a folder for results is safe from runs that did not make it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import tifffile
import xarray as xr
import zarr
from PIL import Image

import napari_phase4d as p4d
from helpers import hear_signals
from napari_phase4d.cli import main
from napari_phase4d.io.atomic import machine
from napari_phase4d.pipeline import read_outcome, run_batch, write_outcome
from napari_phase4d.pipeline.batch_folders import NOTE, began
from napari_phase4d.pipeline.guarding import result_folder

#: No process has this number.
NO_PROCESS = 2**22 + 1
RECIPE = p4d.Recipe(methods=("spatial-2d",), boundary=((0, 0),))


@pytest.fixture
def phase(tmp_path: Path) -> Path:
    """Wrapped phase in a file."""
    path = tmp_path / "cell.npy"
    np.save(path, p4d.simulation.swimming_euglena((24, 32), 2, peak_rad=9)["wrapped"].values)
    return path


def run(*arguments: object) -> int:
    """Run the command line as a shell does, and return its code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["napari-phase4d", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    return int(ended.value.code or 0)


def run_one(phase: Path, out: Path, *more: str, method: str = "spatial-2d") -> int:
    """Unwrap one file by one method."""
    return run("run", phase, "--out", out, "--method", method, "--boundary", "0,0", *more)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


MADE = {"wrapped.ome.tif", "spatial-2d.ome.tif", "table.csv", "recipe.json", NOTE}


@pytest.mark.parametrize("name", ["table.csv", "recipe.json", "wrapped.ome.tif", NOTE])
def test_what_no_run_has_made_is_not_written_over(
    phase: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text('{"mine": 1}')
    assert run_one(phase, out) == 1
    said = capsys.readouterr().err
    assert f"{name} is there already and was not made by a run; move it away" in said
    assert names(out) == {name}
    assert (out / name).read_text() == '{"mine": 1}'


def test_the_input_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = p4d.simulation.multiplexed_video(p4d.simulation.swimming_euglena(n_times=1)["phase"])
    path = tmp_path / "amplitude.ome.tif"
    tifffile.imwrite(path, np.asarray(frames.holograms))
    before = path.read_bytes()
    assert run_one(path, tmp_path) == 1
    assert "over the input" in capsys.readouterr().err
    assert path.read_bytes() == before
    assert names(tmp_path) == {path.name}


def test_results_of_an_earlier_run_go_and_all_else_stays(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    assert names(out) == MADE
    (out / "mine.txt").write_text("notes")
    other = tmp_path / "other.npy"
    np.save(other, np.load(phase)[:, ::-1])
    assert run_one(other, out, method="temporal") == 0
    assert names(out) == MADE - {"spatial-2d.ome.tif"} | {"temporal.ome.tif", "mine.txt"}
    assert json.loads((out / NOTE).read_text())["input"]["name"] == "other.npy"
    assert (out / "mine.txt").read_text() == "notes"


def test_wrapped_phase_may_lie_where_its_results_go(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    wrapped = out / "wrapped.ome.tif"
    before = wrapped.read_bytes()
    assert run_one(wrapped, out, method="temporal") == 0
    assert wrapped.read_bytes() == before
    assert names(out) == MADE - {"spatial-2d.ome.tif"} | {"temporal.ome.tif"}


def test_comparing_is_as_careful(
    phase: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "comparison.png").write_bytes(b"mine")
    assert run("compare", phase, "--out", out, "--method", "spatial-2d") == 1
    assert "comparison.png is there already" in capsys.readouterr().err
    assert (out / "comparison.png").read_bytes() == b"mine"


def test_a_damaged_note_of_a_run_is_replaced(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / NOTE).write_bytes(b"")
    assert run_one(phase, out) == 0
    assert json.loads((out / NOTE).read_text())["input"]["name"] == "cell.npy"


OURS = b'{"program": "napari-phase4d"'
#: What a crash may leave of a note.
DAMAGES = [b"", b'{"program": "napari-ph', b"\x00" * 300, b"null", OURS + b', "files": 3}']


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_results_whose_note_is_damaged_are_replaced(
    phase: Path, tmp_path: Path, damage: bytes
) -> None:
    """As are those of another recording and method, so that none is left beside."""
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    (out / NOTE).write_bytes(damage)
    assert run_one(phase, out, method="temporal") == 0
    assert names(out) == MADE - {"spatial-2d.ome.tif"} | {"temporal.ome.tif"}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_note_of_a_batch_counts_as_incomplete(
    phase: Path, tmp_path: Path, damage: bytes
) -> None:
    out = tmp_path / "out"
    run_batch(RECIPE, [phase], out)
    (out / "cell" / "mine.txt").write_text("notes")
    (out / "cell" / NOTE).write_bytes(damage)
    table = run_batch(RECIPE, [phase], out, resume=True)
    assert table["status"].tolist() == ["done"]
    assert (out / "cell-damaged" / "mine.txt").read_text() == "notes"
    table = run_batch(RECIPE, [phase], out, resume=True)
    assert table["status"].tolist() == ["complete already"]


def test_leftovers_of_runs_that_were_killed_go(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    dead = f".wrapped.ome-{machine()}-{NO_PROCESS}-abc_1"
    (out / f"{dead}.tif").write_bytes(b"half")
    (out / dead).mkdir()
    alive = f".wrapped.ome-{machine()}-{os.getpid()}-abc.tif"
    (out / alive).write_bytes(b"another one's")
    (out / ".mine-1-2-3").write_bytes(b"")
    assert run_one(phase, out) == 0
    assert names(out) == MADE | {alive, ".mine-1-2-3"}


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="not on this system")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_run_that_is_told_to_end_leaves_nothing_half_written(tmp_path: Path, name: str) -> None:
    path, out = tmp_path / "long.npy", tmp_path / "out"
    exact = p4d.simulation.swimming_euglena((96, 128), 240, peak_rad=9)
    np.save(path, exact["wrapped"].values)
    command = [sys.executable, "-m", "napari_phase4d", "run", path, "--out", out]
    process = subprocess.Popen(
        [*map(str, command), "--method", "directional-l1", "--boundary", "0,0"],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, preexec_fn=hear_signals,
    )  # fmt: skip
    until = time.monotonic() + 60
    while not (out / NOTE).exists() and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=120)  # by a busy machine
    assert process.returncode == 128 + getattr(signal, name), said
    assert f"Stopped by {name}" in said
    assert "Traceback" not in said
    assert not out.exists()


def test_a_lock_does_not_trust_the_clock(phase: Path, tmp_path: Path) -> None:
    """The time at which a process began, as wall clocks tell it, moves when they are put right."""
    parent = os.getppid()
    mark = {"pid": parent, "began": began(parent), "host": os.uname().nodename}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "batch.lock").write_text(json.dumps(mark))
    with pytest.raises(OSError, match="another batch"):
        run_batch(RECIPE, [phase], tmp_path / "out")
    clock = psutil.Process(parent).create_time()
    assert f"{clock:.0f}" not in began(parent)


@pytest.mark.skipif(sys.platform != "linux", reason="other disks refuse such names")
def test_names_of_files_write_no_lines_of_their_own(phase: Path, tmp_path: Path) -> None:
    path = phase.rename(tmp_path / "one\n[2 of 2] two.npy")
    told: list[str] = []
    run_batch(RECIPE, [path], tmp_path / "out", told=told.append)
    assert told[0].startswith("[1 of 1] one\\n[2 of 2] two.npy: ")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other disks refuse such names")
def test_names_of_files_never_stop_a_batch(phase: Path, tmp_path: Path) -> None:
    deep = tmp_path / ("d" * 100) / ("e" * 100)
    deep.mkdir(parents=True)
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd\xff\xfe.npy"))
    files = [odd, tmp_path / f"{'x' * 247}.npy", deep / "A.npy", deep / "a.npy", phase]
    for file in files[:-1]:
        file.write_bytes(phase.read_bytes())
    table = run_batch(RECIPE, files, tmp_path / "out")
    assert table["status"].tolist()[1:] == ["done"] * 4
    assert table["status"].tolist()[0] in ("done", "failed")
    assert table["error"].isna().tolist()[1:] == [True] * 4
    assert len(set(table["folder"].str.casefold())) == 5
    again = run_batch(RECIPE, list(reversed(files)), tmp_path / "out", resume=True)
    assert again["status"].tolist()[:4] == ["complete already"] * 4


def test_broken_links_of_the_user_stay(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_batch(RECIPE, [phase], out)
    (out / "cell" / "link").symlink_to(tmp_path / "gone")
    assert run_batch(RECIPE, [phase], out)["status"].tolist() == ["done"]
    assert (out / "cell" / "link").is_symlink()


@pytest.mark.parametrize("fails", [False, True])
def test_an_input_that_lies_among_the_results_stays_the_users(
    phase: Path, tmp_path: Path, *, fails: bool
) -> None:
    """Neither a run that uses it nor one that fails makes it one of its own."""
    out = tmp_path / "out"
    out.mkdir()
    given = out / "wrapped.ome.tif"
    p4d.write_phase(given, p4d.simulation.swimming_euglena((24, 32), 2)["wrapped"])
    before = given.read_bytes()
    more = ("--boundary", "9,9") if fails else ()
    assert run_one(given, out, *more) == int(fails)
    assert run_one(phase, out) == 1  # it would be written over
    assert given.read_bytes() == before


@pytest.mark.slow
def test_what_a_run_made_may_be_its_next_input_and_be_made_again(
    phase: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    assert run_one(out / "wrapped.ome.tif", out, "--form", "zarr") == 0
    assert run_one(phase, out) == 0
    assert names(out) == MADE


def test_results_without_a_note_are_known_by_themselves(phase: Path, tmp_path: Path) -> None:
    """Version 0.1.0 left none; a folder with anything else of these names is not taken for one."""
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    (out / NOTE).unlink()
    assert run_one(phase, out) == 0
    (out / NOTE).unlink()
    (out / "spatial-2d.ome.tif").write_bytes(b"mine")
    assert run_one(phase, out) == 1
    assert (out / "spatial-2d.ome.tif").read_bytes() == b"mine"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spatial-2d.ome.tif", "table.csv", "recipe.json"])
def test_what_was_changed_since_a_run_is_not_written_over(
    name: str, phase: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run_one(phase, out) == 0
    (out / name).write_text("my remarks")
    capsys.readouterr()
    assert run_one(phase, out) == 1
    assert "was changed since" in " ".join(capsys.readouterr().err.split())
    run_one(phase, out, method="angular")
    assert (out / name).read_text() == "my remarks"


def test_names_that_a_killed_run_has_only_announced_are_the_users(
    phase: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with result_folder(out, p4d.Recipe(recording=str(phase))):
        note = (out / NOTE).read_text()
    out.mkdir(exist_ok=True)
    (out / NOTE).write_text(note)  # as after a kill
    (out / "exact.ome.tif").write_text("mine")
    (out / "amplitude.ome.zarr").mkdir()
    (out / "amplitude.ome.zarr" / "notes.txt").write_text("mine")
    assert run_one(phase, out) == 1
    assert "is there already" in " ".join(capsys.readouterr().err.split())
    assert (out / "exact.ome.tif").read_text() == "mine"
    assert (out / "amplitude.ome.zarr" / "notes.txt").read_text() == "mine"


def test_tables_of_cells_are_guarded_too(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "cells.csv").write_text("my cells")
    assert run_one(phase, out, "--cells") == 1
    assert (out / "cells.csv").read_text() == "my cells"


@pytest.mark.slow
def test_links_that_go_round_stop_no_batch(phase: Path, tmp_path: Path) -> None:
    loop = tmp_path / "loop.npy"
    loop.symlink_to(loop)
    table = run_batch(p4d.Recipe(methods=("spatial-2d",)), [loop, phase], tmp_path / "out")
    assert table["status"].tolist() == ["failed", "done"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
@pytest.mark.parametrize("name", ["pipe.tif", "pipe.ome.tif", "pipe.npz", "pipe.zarr"])
def test_pipes_are_not_waited_for(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / name)
    for command in ("info", "run"):  # either would wait for ever
        assert run(command, tmp_path / name) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert "pipe or a device" in said or "there is no file" in said


def test_results_are_not_written_among_the_frames(tmp_path: Path, phase: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    hologram = (100 * np.random.default_rng(0).random((64, 64))).astype(np.uint8)
    for number in range(2):
        Image.fromarray(hologram).save(folder / f"{number}.png")
    before = names(folder)
    assert run_one(folder, folder) == 1
    assert names(folder) == before
    store = tmp_path / "holograms.zarr"
    zarr.save_array(str(store), np.stack([hologram, hologram]))
    before = names(store)
    assert run_one(store, store / "results") == 1
    assert names(store) == before


@pytest.mark.parametrize("name", ["table.csv", "wrapped.ome.tif", "spatial-2d.ome.tif", NOTE])
def test_a_script_writes_over_nothing_of_the_users(phase: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text('{"mine": 1}')
    outcome = p4d.run(RECIPE.changed(recording=str(phase)))
    with pytest.raises(OSError, match=f"{name} is there already and was not made by a run"):
        write_outcome(outcome, out)
    assert names(out) == {name}
    assert (out / name).read_text() == '{"mine": 1}'


def test_a_script_leaves_no_results_of_before(phase: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_outcome(p4d.run(RECIPE.changed(recording=str(phase))), out)
    assert names(out) == MADE
    other = p4d.run(RECIPE.changed(recording=str(phase), methods=("temporal",)))
    write_outcome(other, out)
    assert names(out) == MADE - {"spatial-2d.ome.tif"} | {"temporal.ome.tif"}
    (out / "table.csv").write_text("mine")
    with pytest.raises(OSError, match="was changed since"):
        write_outcome(other, out)


@pytest.mark.filterwarnings("ignore:wrapped.ome.tif")  # what is in doubt about its lobes
def test_a_script_does_not_write_over_a_recording_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "wrapped.ome.tif"
    exact = p4d.simulation.swimming_euglena((32, 40), n_times=2, peak_rad=6)
    frames = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values
    tifffile.imwrite(path, frames)
    before = path.read_bytes()
    outcome = p4d.run(RECIPE, p4d.open_recording(path))
    with pytest.raises(OSError, match="over the input"):
        write_outcome(outcome, tmp_path)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_stacks_of_a_run_stay_where_they_are_read(phase: Path, tmp_path: Path) -> None:
    """They lie on disk, and are what the outcome is made of, in whatever form they are written."""
    out = tmp_path / "out"
    recipe = RECIPE.changed(recording=str(phase), storage="disk")
    outcome = p4d.run(recipe, folder=out)
    before = outcome.comparison.results["spatial-2d"].values
    for form in ("zarr", "tiff", "zarr"):
        write_outcome(outcome, out, form=form)
        assert (outcome.comparison.results["spatial-2d"].values == before).all()
    # Whatever was written in between, what lies there is known as the run's.
    write_outcome(read_outcome(out), out, form="tiff")
    write_outcome(outcome, out)


def test_an_input_among_files_of_the_users_frees_none_of_them(tmp_path: Path) -> None:
    sample = p4d.simulation.swimming_euglena((24, 32), 2, peak_rad=9)["wrapped"]
    path = p4d.write_phase(tmp_path / "wrapped.ome.zarr", sample)
    theirs = p4d.write_phase(tmp_path / "spatial-2d.ome.zarr", sample * 0 + 3)
    outcome = p4d.run(RECIPE.changed(recording=str(path), content="phase"))
    with pytest.raises(OSError, match=r"spatial-2d.ome.zarr is there already and was not made"):
        write_outcome(outcome, tmp_path)
    assert (p4d.read_results(theirs) == 3).all()


def on_disk(path: Path, folder: Path, **settings: object) -> p4d.pipeline.Outcome:
    """Run a script's recipe on disk, which has no guarded folder."""
    recipe = RECIPE.changed(recording=str(path), content="phase", storage="disk", **settings)
    return p4d.run(recipe, folder=folder)


def test_a_script_on_disk_does_not_write_over_its_input(tmp_path: Path) -> None:
    phase = p4d.simulation.swimming_euglena((24, 32), 2, peak_rad=9)["wrapped"]
    path = p4d.write_phase(tmp_path / "spatial-2d.ome.zarr", phase)
    with pytest.raises(OSError, match="written over the input .*spatial-2d"):
        on_disk(path, tmp_path)
    xr.testing.assert_identical(p4d.read_results(path).compute(), phase)


def test_a_script_on_disk_does_not_replace_what_no_run_has_made(
    tmp_path: Path, phase: Path
) -> None:
    other = p4d.simulation.swimming_euglena((24, 32), 2, peak_rad=5)["wrapped"]
    path = p4d.write_phase(tmp_path / "out" / "spatial-2d.ome.zarr", other)
    with pytest.raises(OSError, match="is there already and was not made by a run"):
        on_disk(phase, tmp_path / "out")
    xr.testing.assert_identical(p4d.read_results(path).compute(), other)


@pytest.mark.slow
def test_results_that_another_run_has_replaced_are_not_read_as_those_of_before(
    tmp_path: Path, phase: Path
) -> None:
    """They lie on disk and are read when they are used."""
    other = tmp_path / "other.npy"
    np.save(other, -np.load(phase))
    first = on_disk(phase, tmp_path / "out").comparison
    second = on_disk(other, tmp_path / "out").comparison
    with pytest.raises(OSError, match="was replaced since it was opened"):
        first.results["spatial-2d"].compute()
    with pytest.raises(OSError, match="was replaced since it was opened"):
        first.confidence("spatial-2d")
    alone = p4d.unwrap(-np.load(phase), "spatial-2d", mask="auto").values
    np.testing.assert_array_equal(second.results["spatial-2d"].values, alone)
