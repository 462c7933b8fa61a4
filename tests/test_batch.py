"""Many files by one recipe: folders, log, summary, what fails, and going on later."""

from __future__ import annotations

import errno
import json
import os
import shutil
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest

import napari_phase4d as p4d
from batches import RECIPE, batch, contents, names, statuses, write_phases
from napari_phase4d.io import read_results
from napari_phase4d.pipeline import Outcome, run_batch
from napari_phase4d.pipeline import fingerprint as fingerprint_of
from napari_phase4d.pipeline.batch_folders import result_folders

#: More than any process is numbered on Linux.
NO_PROCESS = 2**22 + 1


@pytest.fixture(scope="module")
def phases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_phases(tmp_path_factory.mktemp("phases"))


@pytest.mark.slow
def test_every_file_gets_a_folder_a_line_and_a_row(phases: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    files = [phases / "a.npy", phases / "bad.npy", phases / "missing.npy", phases / "b.npy"]
    table, said = batch(out, *files)
    assert names(out) == {"a", "b", "batch.log", "summary.csv"}
    assert names(out / "a") == {
        "wrapped.ome.tif", "spatial-2d.ome.tif", "temporal-angular.ome.tif", "table.csv",
        "recipe.json", "run.json",
    }  # fmt: skip
    assert list(table["status"]) == ["done", "failed", "failed", "done"]
    assert list(table["folder"]) == ["a", "bad", "missing", "b"]
    assert list(table["file"]) == [str(file) for file in files]
    done = table[table["status"] == "done"]
    assert list(done["frames"]) == [3, 3]
    assert list(done["views"]) == [2, 2]
    assert list(done["results"]) == [2, 2]
    assert all(
        "counted in ones: pixel, frame rate, viewing angles" in note for note in done["notes"]
    )
    assert list(done["best_method"]) == ["temporal-angular"] * 2
    assert list(done["input_sha256"]) == [fingerprint_of(files[i]).sha256 for i in (0, 3)]
    assert list(done["input_bytes"]) == [file.stat().st_size for file in (files[0], files[3])]
    assert said[0].startswith("[1 of 4] a.npy: 2 results in ")
    assert said[0].endswith(f"s -> {out / 'a'}")
    assert said[1].startswith("[2 of 4] bad.npy: failed: bad.npy can't be read")
    assert said[2].startswith("[3 of 4] missing.npy: failed: there is no file or folder")
    assert said[4] == "4 files: 2 done, 2 failed."
    assert table["error"][2] == said[1].split("failed: ")[1]
    # The same numbers as a run of its own.
    phase = p4d.run(RECIPE.changed(recording=str(files[3])))
    found = read_results(out / "b" / "temporal-angular.ome.tif")
    expected = phase.comparison.results["temporal-angular"]
    np.testing.assert_array_equal(found.values, expected.values)


@pytest.mark.slow
def test_run_json_names_input_recipe_and_every_file(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy", form="zarr")
    note = json.loads((tmp_path / "a" / "run.json").read_text())
    assert note["input"] == fingerprint_of(phases / "a.npy").as_dict()
    assert note["asked"]["recipe"]["methods"] == list(RECIPE.methods)
    assert {file["name"] for file in note["files"]} == names(tmp_path / "a") - {"run.json"}
    for file in note["files"]:
        assert fingerprint_of(tmp_path / "a" / file["name"]).as_dict() == file


@pytest.mark.slow
def test_confidence_gives_the_doubtful_share(phases: Path, tmp_path: Path) -> None:
    table = run_batch(RECIPE.changed(confidence=True), [phases / "a.npy"], tmp_path)
    own = pd.read_csv(tmp_path / "a" / "table.csv", index_col="id")
    expected = own["doubtful_percent"]["temporal-angular"]
    assert table["doubtful_percent"][1] == pytest.approx(expected)
    assert 0 <= expected <= 100


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*little empty field is in view")
def test_what_is_to_be_looked_after_in_a_phase_is_noted_and_told(
    tmp_path: Path, small_video: Any
) -> None:
    """At night nobody sees a warning; the same recording alone is warned of."""
    np.save(tmp_path / "video.npy", small_video.holograms.values)
    lobe = p4d.Lobe((0.1, 0.1), 0.2)
    recipe = p4d.Recipe(lobes=(lobe,), methods=("spatial-2d",), background="none")
    said: list[str] = []
    table = run_batch(recipe, [tmp_path / "video.npy"], tmp_path / "out", told=said.append)
    sentence = "Lobe 1 reaches over the zero order; make its radius smaller."
    assert sentence in table["notes"][1]
    assert f"[1 of 1] video.npy: {sentence}" in said
    assert sentence in (tmp_path / "out" / "batch.log").read_text()
    with pytest.warns(UserWarning, match="lobe 1 reaches over the zero order"):
        p4d.run(recipe, small_video)


@pytest.mark.slow
def test_runs_larger_than_memory_are_batched_too(tmp_path: Path, small_video: Any) -> None:
    np.save(tmp_path / "video.npy", small_video.holograms.values)
    on_disk = RECIPE.changed(storage="disk")
    table = run_batch(on_disk, [tmp_path / "video.npy"], tmp_path / "disk")
    assert list(table["status"]) == ["done"]
    results = {"wrapped", "amplitude", *RECIPE.methods}
    assert names(tmp_path / "disk" / "video") == {
        *(f"{name}.ome.zarr" for name in results), "table.csv", "recipe.json", "run.json",
    }  # fmt: skip
    run_batch(RECIPE, [tmp_path / "video.npy"], tmp_path / "memory", form="zarr")
    for name in results:
        found, expected = (
            read_results(tmp_path / place / "video" / f"{name}.ome.zarr")
            for place in ("disk", "memory")
        )
        np.testing.assert_array_equal(found.values, expected.values)
        assert found.data.chunksize[0] > expected.data.chunksize[0] == 1  # left as it was written
        assert found.attrs["provenance"]["input"] == expected.attrs["provenance"]["input"]
        assert found.attrs["provenance"]["recipe"]["storage"] == "disk"
    again = run_batch(on_disk, [tmp_path / "video.npy"], tmp_path / "disk", resume=True)
    assert list(again["status"]) == ["complete already"]


# Going on


@pytest.mark.slow
def test_resume_leaves_what_is_complete(phases: Path, tmp_path: Path) -> None:
    files = [phases / f"{name}.npy" for name in "abc"]
    batch(tmp_path, *files[:2])
    before = {p: p.stat().st_mtime_ns for p in tmp_path.glob("*/*")}
    table, said = batch(tmp_path, *files, resume=True)
    assert list(table["status"]) == ["complete already", "complete already", "done"]
    assert said[0] == f"[1 of 3] a.npy: complete already in {tmp_path / 'a'}"
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert list(table["frames"]) == [3, 3, 3]  # also of what was run before
    assert statuses(tmp_path, *files) == ["complete already"] * 3


def flip(path: Path) -> None:
    """Change one bit, and neither size nor time."""
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[-7] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change", ["input", "recipe", "form", "version", "flipped result", "cut result", "lost result"]
)
def test_resume_does_again_what_has_changed(
    phases: Path, tmp_path: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = shutil.copy(phases / "a.npy", tmp_path / "a.npy")
    out = tmp_path / "out"
    batch(out, file)
    assert statuses(out, file) == ["complete already"]
    first = contents(out)
    recipe, options = RECIPE, {}
    result = out / "a" / "spatial-2d.ome.tif"
    if change == "input":  # of the same name, size and time
        flip(Path(file))
    elif change == "recipe":
        recipe = RECIPE.changed(boundary=((1, 0),))
    elif change == "form":
        options = {"form": "zarr"}
    elif change == "version":
        monkeypatch.setattr("napari_phase4d.pipeline.batch_folders.program_version", lambda: "9")
    elif change == "flipped result":
        flip(result)
    elif change == "cut result":
        os.truncate(result, 1000)
    else:
        result.unlink()
    assert statuses(out, file, recipe=recipe, **options) == ["done"]
    assert statuses(out, file, recipe=recipe, **options) == ["complete already"]
    same = change in ("version", "flipped result", "cut result", "lost result")
    assert (contents(out / "a") == contents_of(first, "a")) == same


def contents_of(found: dict[str, bytes], folder: str) -> dict[str, bytes]:
    start = f"{folder}{os.sep}"
    return {
        name.removeprefix(start): data for name, data in found.items() if name.startswith(start)
    }


@pytest.mark.slow
def test_damaged_frame_of_a_zarr_is_done_again(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy", form="zarr")
    chunk = tmp_path / "a" / "wrapped.ome.zarr" / "0" / "c.1.0.0.0"
    whole = chunk.read_bytes()
    flip(chunk)
    assert statuses(tmp_path, phases / "a.npy", form="zarr") == ["done"]
    assert chunk.read_bytes() == whole


@pytest.mark.slow
def test_without_resume_all_is_done_again(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy")
    first = contents(tmp_path / "a")
    table, _ = batch(tmp_path, phases / "a.npy")
    assert list(table["status"]) == ["done"]
    assert contents(tmp_path / "a") == first


@pytest.mark.slow
def test_what_fails_leaves_older_results(phases: Path, tmp_path: Path) -> None:
    file = shutil.copy(phases / "a.npy", tmp_path / "a.npy")
    out = tmp_path / "out"
    batch(out, file)
    before = contents(out / "a")
    Path(file).write_bytes(b"no numbers any more")
    table, _ = batch(out, file)
    assert list(table["status"]) == ["failed"]
    assert contents(out / "a") == before
    assert names(out) == {"a", "batch.log", "summary.csv"}


@pytest.mark.slow
def test_what_a_user_has_put_beside_results_is_kept(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy")
    (tmp_path / "a" / "notes.txt").write_text("cell 7 divides")
    (tmp_path / "a" / "figures").mkdir()
    (tmp_path / "a" / "figures" / "one.png").write_bytes(b"1")
    assert statuses(tmp_path, phases / "a.npy") == ["complete already"]
    batch(tmp_path, phases / "a.npy")
    assert (tmp_path / "a" / "notes.txt").read_text() == "cell 7 divides"
    assert (tmp_path / "a" / "figures" / "one.png").read_bytes() == b"1"


@pytest.mark.slow
def test_what_a_user_named_as_a_new_result_is_kept_too(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy")
    own = tmp_path / "a" / "comparison.png"
    own.write_bytes(b"mine")
    (tmp_path / "a" / "comparison-kept.png").write_bytes(b"mine, too")

    def draw(outcome: Outcome, folder: Path) -> None:
        (folder / "comparison.png").write_bytes(b"new")

    batch(tmp_path, phases / "a.npy", finished=draw)
    assert own.read_bytes() == b"new"
    assert own.with_name("comparison-kept.png").read_bytes() == b"mine, too"
    assert own.with_name("comparison-kept2.png").read_bytes() == b"mine"


def test_folders_that_no_batch_has_made_are_not_replaced(phases: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.txt").write_text("three years")
    table, said = batch(tmp_path, phases / "a.npy", phases / "b.npy")
    assert list(table["status"]) == ["failed", "done"]
    assert "a is there already and was not made by a batch" in said[0]
    assert names(tmp_path / "a") == {"thesis.txt"}


@pytest.mark.slow
def test_what_a_killed_batch_has_left_is_put_right(phases: Path, tmp_path: Path) -> None:
    batch(tmp_path, phases / "a.npy")
    before = contents(tmp_path / "a")
    # As if killed between the two names of a replaced folder, and while another one was filled.
    (tmp_path / "a").rename(tmp_path / ".a-old")
    (tmp_path / ".a-partial").mkdir()
    (tmp_path / ".a-partial" / "wrapped.ome.tif").write_bytes(b"half")
    (tmp_path / ".summary-half.csv").write_text("num")
    mark = {"pid": NO_PROCESS, "began": 1.0, "host": socket.gethostname()}
    (tmp_path / "batch.lock").write_text(json.dumps(mark))
    assert statuses(tmp_path, phases / "a.npy") == ["complete already"]
    assert contents(tmp_path / "a") == before
    assert names(tmp_path) == {"a", "batch.log", "summary.csv"}


# One at a time


@pytest.fixture(params=["links", "no links"])
def disk(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk with hard links, and one without, such as exFAT."""

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    if request.param == "no links":
        monkeypatch.setattr(os, "link", refuse)


@pytest.mark.slow
@pytest.mark.usefixtures("disk")
def test_two_batches_do_not_share_a_folder(phases: Path, tmp_path: Path) -> None:
    def begin_another(outcome: Outcome, folder: Path) -> None:
        assert not (tmp_path / "a").exists()
        assert folder.name == ".a-partial"
        mark = json.loads((tmp_path / "batch.lock").read_text())
        assert mark["pid"] == os.getpid()
        run_batch(RECIPE, [phases / "b.npy"], tmp_path)

    table, said = batch(tmp_path, phases / "a.npy", finished=begin_another)
    assert list(table["status"]) == ["failed"]
    assert f"another batch (process {os.getpid()} on " in said[0]
    assert names(tmp_path) == {"batch.log", "summary.csv"}


@pytest.mark.slow
@pytest.mark.usefixtures("disk")
@pytest.mark.parametrize("mark", ["ended", "another process by now", "half-written"])
def test_locks_of_batches_that_are_gone_do_not_count(
    phases: Path, tmp_path: Path, mark: str
) -> None:
    process = psutil.Process()
    host = socket.gethostname()
    marks = {
        "ended": {"pid": NO_PROCESS, "began": process.create_time(), "host": host},
        "another process by now": {"pid": os.getpid(), "began": 1e9, "host": host},
    }
    text = json.dumps(marks[mark]) if mark in marks else '{"pid": '
    (tmp_path / "batch.lock").write_text(text)
    table, _ = batch(tmp_path, phases / "a.npy")
    assert list(table["status"]) == ["done"]
    assert not (tmp_path / "batch.lock").exists()


# Names


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["a.tif", "b.ome.tif", "c.ome.zarr"], ["a", "b", "c"]),
        (["1/cell.tif", "2/cell.tif", "2/other.tif"], ["1_cell_tif", "2_cell_tif", "other"]),
        (["1/cell.tif", "1/cell.avi"], ["cell_tif", "cell_avi"]),
        (["1/x/c.tif", "2/x/c.tif", "2/x/c.avi"], ["1_x_c_tif", "2_x_c_tif", "2_x_c_avi"]),
        (["Cell.tif", "cell.npy"], ["Cell_tif", "cell_npy"]),
        (["sample:euglena"], ["sample_euglena"]),
        (["../x/.."], ["recording"]),
        ([".hidden.tif", "rec_*.tif"], ["hidden", "rec__"]),
        (
            ["batch.log.tif", "summary.csv.tif", "cells.csv.tif"],
            ["batch.log_2", "summary.csv_2", "cells.csv_2"],
        ),
    ],
)
def test_folders_have_stable_names_inside(
    tmp_path: Path, files: list[str], expected: list[str]
) -> None:
    out = tmp_path / "out"
    found = result_folders(files, out)
    assert [folder.relative_to(out).as_posix() for folder in found] == expected
    assert all(folder.parent == out for folder in found)
    if len({name.removesuffix("_2") for name in expected}) == len(expected):
        # Neither the order nor the others matter for what each is called.
        assert result_folders(files[::-1], out) == found[::-1]


def test_a_file_that_is_given_twice_is_run_once(phases: Path, tmp_path: Path) -> None:
    (tmp_path / "link.npy").symlink_to(phases / "a.npy")
    roundabout = phases / ".." / phases.name / "a.npy"
    table, _ = batch(tmp_path / "out", phases / "a.npy", roundabout, tmp_path / "link.npy")
    assert list(table["folder"]) == ["a"]


# Faults
