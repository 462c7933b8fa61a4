"""Batches in trouble: what fails, full disks, cancelling, and the command line."""

from __future__ import annotations

import contextlib
import errno
import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import napari_phase4d as p4d
from batches import RECIPE, batch, names, statuses, write_phases
from helpers import command, hear_signals
from napari_phase4d.io import read_results
from napari_phase4d.io.atomic import remove_folder
from napari_phase4d.pipeline import Outcome, run_batch, sentence_of
from napari_phase4d.pipeline import fingerprint as fingerprint_of
from small_disks import small_disk


@pytest.fixture(scope="module")
def phases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_phases(tmp_path_factory.mktemp("phases"))


def test_input_is_hashed_once_and_in_another_thread(
    phases: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashing = sys.modules["napari_phase4d.pipeline.provenance"]
    real, threads = hashing.hashed, []

    def counted(parts: Any, *arguments: Any, **options: Any) -> str:
        if [path for _, path, _, _ in parts] == [phases / "a.npy"]:
            threads.append(threading.current_thread())
        return real(parts, *arguments, **options)

    monkeypatch.setattr(hashing, "hashed", counted)
    batch(tmp_path, phases / "a.npy")
    assert len(threads) == 1
    assert threads[0] is not threading.main_thread()


@pytest.mark.slow
def test_reference_and_truth_are_hashed_once_a_batch(
    tmp_path: Path, small_video: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / f"{name}.npy" for name in ("reference", "a", "b")]
    for file in files:
        np.save(file, small_video.holograms.values)
    fingerprints = sys.modules["napari_phase4d.pipeline.provenance"]
    batches = sys.modules["napari_phase4d.pipeline.batch"]
    hashed, digest_of, seen = fingerprints.hashed, batches.digest_of, []

    def counted(parts: Any, *arguments: Any, **options: Any) -> str:
        seen.extend(name for name, *_ in parts if name == "reference.npy")
        return hashed(parts, *arguments, **options)

    def digested(truth: Any) -> str:
        seen.append("truth")
        return digest_of(truth)

    monkeypatch.setattr(fingerprints, "hashed", counted)
    monkeypatch.setattr(batches, "digest_of", digested)
    recipe = RECIPE.changed(reference=str(files[0]), methods=("spatial-2d",))
    exact = p4d.run(recipe.changed(recording=str(files[1]))).reconstruction["phase"]
    table = run_batch(recipe, files[1:], tmp_path / "out", truth=exact)
    assert list(table["status"]) == ["done", "done"]
    assert sorted(seen) == ["reference.npy", "truth"]
    note = json.loads((tmp_path / "out" / "b" / "run.json").read_text())
    expected = fingerprint_of(files[0]).as_dict()
    assert note["asked"]["recipe"]["reference"] == expected
    found = read_results(tmp_path / "out" / "b" / "wrapped.ome.tif")
    assert found.attrs["provenance"]["reference"] == expected
    # It is the content that counts, also of one that changes between two files.
    remembered = fingerprints.Remembered()
    before = remembered(str(files[0]))
    np.save(files[0], small_video.holograms.values[:1])
    assert remembered(str(files[0])) != before


@pytest.mark.slow
def test_input_that_changes_while_it_is_run_has_failed(phases: Path, tmp_path: Path) -> None:
    file = Path(shutil.copy(phases / "a.npy", tmp_path / "a.npy"))

    def append(outcome: Outcome, folder: Path) -> None:
        with file.open("ab") as stream:
            stream.write(b"one more frame")

    table, said = batch(tmp_path / "out", file, finished=append)
    assert list(table["status"]) == ["failed"]
    assert "failed: a.npy was changed while it was read" in said[0]
    assert names(tmp_path / "out") == {"batch.log", "summary.csv"}


def test_input_that_vanishes_half_way_does_not_stop_the_others(
    phases: Path, tmp_path: Path
) -> None:
    files = [Path(shutil.copy(phases / f"{n}.npy", tmp_path / f"{n}.npy")) for n in "ab"]
    gone = tmp_path / "gone.npy"
    shutil.copy(phases / "c.npy", gone)
    table, said = batch(
        tmp_path / "out", files[0], gone, files[1],
        finished=lambda outcome, folder: gone.unlink(missing_ok=True),
    )  # fmt: skip
    assert list(table["status"]) == ["done", "failed", "done"]
    assert "gone.npy: failed: there is no file or folder" in said[1]


@pytest.mark.slow
def test_what_no_reader_expects_is_one_line_and_a_traceback_in_the_log(
    phases: Path, tmp_path: Path
) -> None:
    def odd(outcome: Outcome, folder: Path) -> None:
        if folder.name == ".a-partial":
            message = "deep\ninside"
            raise KeyError(message)

    table, said = batch_with_traceback(tmp_path, phases, odd)
    assert list(table["status"]) == ["failed", "done"]
    assert "\n" not in said[0]
    assert said[0].endswith(
        "failed: an unexpected fault, KeyError: 'deep\\ninside'; batch.log has the details"
    )
    log = (tmp_path / "batch.log").read_text()
    assert "Traceback (most recent call last)" in log
    assert said[1] in log.splitlines()


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ValueError(""), "an unexpected fault, ValueError"),
        (KeyError("a"), "an unexpected fault, KeyError: 'a'"),
        (MemoryError(), "it needs more memory than there is"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (OSError("the disk is\nslow"), "the disk is slow"),
    ],
)
def test_an_error_is_one_sentence_that_names_no_log(error: Exception, sentence: str) -> None:
    assert sentence_of(error) == sentence


def batch_with_traceback(
    out: Path, phases: Path, finished: Callable[[Outcome, Path], None]
) -> tuple[pd.DataFrame, list[str]]:
    said: list[str] = []
    files = [phases / "a.npy", phases / "b.npy"]
    return run_batch(RECIPE, files, out, told=said.append, finished=finished), said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("storage", "sentence"),
    [
        ("memory", r"could not be written \(No space left on device\)"),
        ("disk", "No space left on device"),
    ],
)
def test_full_disk_ends_the_batch_with_one_sentence(
    phases: Path, tmp_path: Path, storage: str, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if storage == "disk":  # else it is refused before it begins
        monkeypatch.setattr("napari_phase4d.pipeline.places.Needs.check", lambda *_, **__: None)
    recipe = RECIPE.changed(storage=storage)
    data = p4d.simulation.budding_yeast((128, 128), n_times=4, angles_deg=(0.0, 5.0))
    np.save(tmp_path / "large.npy", data["wrapped"].values)
    files = [phases / "a.npy", tmp_path / "large.npy", phases / "b.npy"]
    said: list[str] = []
    with small_disk(tmp_path / "disk") as out:
        words = rf"{sentence}.*; make room in .* --resume"
        with pytest.raises(OSError, match=words) as caught:
            run_batch(recipe, files, out, told=said.append)
        assert "\n" not in str(caught.value)
        assert "failed: " in said[1]
        assert names(out) == {"a", "batch.log", "summary.csv"}
        assert list(pd.read_csv(out / "summary.csv")["status"]) == ["done", "failed", "waiting"]
        again = statuses(out, files[0], files[2], recipe=recipe)
        assert again == ["complete already", "done"]


def test_disk_that_can_not_be_written_is_one_sentence(phases: Path, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "size=1m,ro") as out:
        with pytest.raises(OSError, match="the folder .*disk can't be written") as caught:
            run_batch(RECIPE, [phases / "a.npy"], out)
        assert "\n" not in str(caught.value)
        with pytest.raises(OSError, match="the folder .*disk/new can't be made"):
            run_batch(RECIPE, [phases / "a.npy"], out / "new")


def test_folder_that_can_not_be_made_is_one_sentence(phases: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for out in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with pytest.raises(OSError, match="the folder .* can't be made") as caught:
            run_batch(RECIPE, [phases / "a.npy"], out)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="form must be tiff or zarr"):
        run_batch(RECIPE, [phases / "a.npy"], tmp_path / "out", form="png")


@pytest.mark.slow
def test_cancelled_batch_leaves_nothing_half_written(phases: Path, tmp_path: Path) -> None:
    files = [phases / "a.npy", phases / "b.npy"]
    messages: list[str] = []
    with pytest.raises(p4d.Cancelled):
        run_batch(
            RECIPE, files, tmp_path, progress=lambda d, t, message: messages.append(message),
            cancelled=lambda: any("[2 of 2] b.npy: " in m and "saving" in m for m in messages),
        )  # fmt: skip
    assert names(tmp_path) == {"a", "batch.log", "summary.csv"}
    last = (tmp_path / "batch.log").read_text().splitlines()[-1]
    assert last == "Stopped; 2 files: 1 done. Go on with --resume."
    assert statuses(tmp_path, *files) == ["complete already", "done"]


@pytest.mark.slow
def test_batch_can_be_cancelled_while_results_are_hashed(
    phases: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashing = sys.modules["napari_phase4d.pipeline.provenance"]
    real, results = hashing.hashed, []

    def slowly(parts: Any, *arguments: Any, **options: Any) -> str:
        if parts[0][0] == "wrapped.ome.tif":
            results.append(parts)
            time.sleep(0.5)  # as of a large one
        return real(parts, *arguments, **options)

    monkeypatch.setattr(hashing, "hashed", slowly)
    with pytest.raises(p4d.Cancelled):
        run_batch(RECIPE, [phases / "a.npy"], tmp_path, cancelled=lambda: bool(results))
    assert names(tmp_path) == {"batch.log", "summary.csv"}


# The command line


@pytest.mark.slow
def test_batch_on_the_command_line(phases: Path, tmp_path: Path) -> None:
    recipe = RECIPE.to_file(tmp_path / "recipe.json")
    files = [phases / "a.npy", phases / "bad.npy", phases / "b.npy"]
    line = ("run", recipe, *files, "--out", "out")
    first = command(*line, cwd=tmp_path)
    assert first.returncode == 1
    assert "[1 of 3] a.npy: 2 results in" in first.stdout
    assert "1 of 3 files failed: bad.npy" in first.stderr
    again = command(*line, "--resume", "--form", "zarr", cwd=tmp_path)
    assert again.returncode == 1
    assert (tmp_path / "out" / "a" / "wrapped.ome.zarr").is_dir()
    assert not (tmp_path / "out" / "a" / "wrapped.ome.tif").exists()


@pytest.mark.thorough
@pytest.mark.slow
def test_ctrl_c_is_one_sentence_and_nothing_half_written(phases: Path, tmp_path: Path) -> None:
    files = []
    for i in range(300):
        files.append(tmp_path / f"f{i:03}.npy")
        shutil.copy(phases / "a.npy", files[-1])
    recipe = RECIPE.to_file(tmp_path / "recipe.json")
    line = [sys.executable, "-m", "napari_phase4d", "run", recipe, *files, "--out", "out"]
    with subprocess.Popen(
        line,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_signals,
    ) as process:
        until = time.monotonic() + 60
        while not (tmp_path / "out" / "f002").exists() and time.monotonic() < until:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert told.strip().startswith("Stopped by Ctrl-C.")
    assert "\n" not in told.strip()
    folders = sorted(p for p in (tmp_path / "out").iterdir() if p.is_dir())
    assert 3 <= len(folders) < 300
    assert all((folder / "run.json").exists() for folder in folders)
    assert names(tmp_path / "out") == {f.name for f in folders} | {"batch.log", "summary.csv"}


def test_a_folder_goes_although_something_is_still_written_into_it(tmp_path: Path) -> None:
    """Zarr's chunks are written side by side: when one fails, others still come."""
    folder = tmp_path / ".large-partial"

    def late() -> None:
        for number in range(8):
            (folder / "c").mkdir(parents=True, exist_ok=True)
            (folder / "c" / str(number)).write_bytes(b"x")
            time.sleep(0.01)

    def patient() -> None:
        with contextlib.suppress(OSError):  # its folder is being removed under its hands
            late()

    writing = [threading.Thread(target=patient) for _ in range(2)]
    for thread in writing:
        thread.start()
    time.sleep(0.01)
    remove_folder(folder)
    for thread in writing:
        thread.join()
    assert not folder.exists()
