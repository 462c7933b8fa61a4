"""A batch that is killed at any point and then goes on: nothing is lost, nothing half there."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import napari_phase4d as p4d

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has neither fork nor SIGKILL"),
]

#: How often batches are killed whose stacks lie in memory, or on disk, which takes longer.
KILLS = {"memory": 20, "disk": 6}
FILES = 16
ENDINGS = {"memory": "tif", "disk": "zarr"}
OF_THE_BATCH = {"batch.log", "summary.csv", "batch.lock"}

#: Loads the program once, since that takes seconds, and then begins and kills batches.
BATCHES = """
import json, os, random, shutil, signal, sys, time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
import napari_phase4d as p4d
import napari_phase4d.io.tiff, pandas, skimage.restoration, tifffile
from napari_phase4d.pipeline import run_batch

work, storage, kills = Path(sys.argv[1]), sys.argv[5], int(sys.argv[2])
of_a_folder, of_the_batch = set(json.loads(sys.argv[3])), set(json.loads(sys.argv[4]))
recipe = p4d.Recipe.from_file(work / "recipe.json").changed(storage=storage)
files = sorted((work / "files").glob("*.npy"))
counts = {"killed": 0, "ended before": 0, "looks": 0, "folders seen": 0, "killed in a run anew": 0}


def begin(out, resume):
    child = os.fork()
    if child == 0:
        try:
            run_batch(recipe, files, out, resume=resume)
            os._exit(0)
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(1)
    return child


def looked_at(out):
    counts["looks"] += 1
    for path in out.iterdir() if out.exists() else ():
        if path.name.startswith("."):
            continue
        if path.name in of_the_batch:
            continue
        try:
            held = set(os.listdir(path))
        except FileNotFoundError:  # it is being replaced just now
            continue
        if held != of_a_folder and path.exists():
            held = set(os.listdir(path))  # listed while it was replaced by a new one
        assert held == of_a_folder, (path, held)
        counts["folders seen"] += 1


def until_end(child, out, seconds):
    '''Wait for a batch, or kill it after some seconds; look at its folder all the time.'''
    end = time.monotonic() + seconds
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() >= end:
            os.kill(child, signal.SIGKILL)
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        looked_at(out)
        time.sleep(0.002)


warm, reference, out = (work / storage / name for name in ("warm", "undisturbed", "out"))
assert until_end(begin(warm, False), warm, 100) == 0  # compiled code is loaded
began = time.monotonic()
assert until_end(begin(reference, False), reference, 100) == 0
length = time.monotonic() - began
rng = random.Random(7)
while counts["killed"] < kills:
    resume = rng.random() < 0.7  # else everything is run again, over what is there
    code = until_end(begin(out, resume), out, rng.uniform(0, length))
    looked_at(out)
    assert code in (0, -signal.SIGKILL), code
    counts["killed" if code else "ended before"] += 1
    counts["killed in a run anew"] += bool(code) and not resume and (out / "f00").exists()
    if not code and counts["killed"] < kills - 5:  # so that empty folders are filled, too
        shutil.rmtree(out)
assert until_end(begin(out, True), out, 100) == 0
print(json.dumps(counts | {"seconds of a batch": round(length, 2)}))
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with small files of wrapped phase, no two the same, and a recipe."""
    folder = tmp_path_factory.mktemp("kill")
    (folder / "files").mkdir()
    for i in range(FILES):
        data = p4d.simulation.budding_yeast((16, 16), n_times=3, angles_deg=(0.0, 3.0 + i))
        np.save(folder / "files" / f"f{i:02}.npy", data["wrapped"].values)
    recipe = p4d.Recipe(methods=("spatial-2d", "temporal-angular"), mask=None)
    recipe.to_file(folder / "recipe.json")
    return folder


def of_a_folder(storage: str) -> set[str]:
    """Return the names of all results of a file."""
    stacks = ("wrapped", "spatial-2d", "temporal-angular")
    named = {f"{name}.ome.{ENDINGS[storage]}" for name in stacks}
    return named | {"table.csv", "recipe.json", "run.json"}


def without_costs(folder: Path) -> dict[str, object]:
    """Return what is in a folder of results, without the seconds and the memory that they took."""
    found: dict[str, object] = {}
    for path in folder.iterdir():
        if path.name == "table.csv":
            found[path.name] = pd.read_csv(path).drop(columns=["seconds", "peak_mb"]).to_dict()
        elif path.name == "run.json":
            note = json.loads(path.read_text())
            note["facts"].pop("seconds")
            note["files"] = [file for file in note["files"] if file["name"] != "table.csv"]
            found[path.name] = note
        elif path.is_dir():
            parts = (part for part in path.rglob("*") if part.is_file())
            found[path.name] = {part.relative_to(path): part.read_bytes() for part in parts}
        else:
            found[path.name] = path.read_bytes()
    return found


def assert_equal(out: Path, undisturbed: Path, storage: str) -> None:
    """Hold a batch that was killed against one that was not."""
    folders = sorted(path.name for path in undisturbed.iterdir() if path.is_dir())
    assert len(folders) == FILES
    assert {path.name for path in out.iterdir()} == {*folders, "batch.log", "summary.csv"}
    for folder in folders:
        found, expected = without_costs(out / folder), without_costs(undisturbed / folder)
        assert set(found) == of_a_folder(storage)
        assert found == expected
    tables = [pd.read_csv(batch / "summary.csv") for batch in (out, undisturbed)]
    rest = [table.drop(columns=["seconds", "status"]) for table in tables]
    pd.testing.assert_frame_equal(*rest)
    assert set(tables[0]["status"]) <= {"done", "complete already"}


@pytest.mark.thorough
@pytest.mark.timeout(300)
@pytest.mark.parametrize("storage", ["memory", "disk"])
def test_killed_batches_go_on_to_the_same_results(work: Path, storage: str) -> None:
    (work / storage).mkdir()
    line = [
        sys.executable, "-c", BATCHES, str(work), str(KILLS[storage]),
        json.dumps(sorted(of_a_folder(storage))), json.dumps(sorted(OF_THE_BATCH)), storage,
    ]  # fmt: skip
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    print(counts)
    assert counts["killed"] == KILLS[storage]
    assert counts["folders seen"] > KILLS[storage]
    assert_equal(work / storage / "out", work / storage / "undisturbed", storage)


@pytest.mark.thorough
@pytest.mark.timeout(120)
def test_killed_command_goes_on(work: Path) -> None:
    files = sorted((work / "files").glob("*.npy"))
    out = work / "by command"
    line = [
        sys.executable, "-m", "napari_phase4d", "run", str(work / "recipe.json"),
        *map(str, files), "--out", str(out), "--resume",
    ]  # fmt: skip
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        until = time.monotonic() + 60
        while not (out / "f05").exists() and time.monotonic() < until:
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert not (out / f"f{FILES - 1:02}").exists()
    assert (out / "batch.lock").exists()  # which nobody holds any more
    again = subprocess.run(line, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert f"[1 of {FILES}] f00.npy: complete already in" in again.stdout
    assert {path.name for path in out.iterdir() if path.is_file()} == {"batch.log", "summary.csv"}
    assert len([path for path in out.iterdir() if path.is_dir()]) == FILES
