"""Disks that are full or locked, and the command line where something is at fault."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from damaging import npy_header
from faulty import FRAMES, public_folder
from napari_phase4d.io import read_results, write_phase, write_table

DIMS = ("time", "angle", "y", "x")


def stack_of(value: float, n_times: int = 2) -> xr.DataArray:
    """Return a stack of 64 kB a frame that does not pack well."""
    shape = (n_times, 1, 128, 128)
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32) + np.float32(value)
    coords = {d: np.arange(n) * 1.0 for d, n in zip(DIMS, shape, strict=True)}
    return xr.DataArray(values, dims=DIMS, coords=coords, name="phase")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of one megabyte."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None:
        pytest.skip("there is no mount program here")
    line = [mount, "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if subprocess.run(line, capture_output=True, check=False).returncode:
        pytest.skip("only root can mount a small disk")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def fill(disk: Path, left: int) -> None:
    """Leave so many bytes free."""
    free = shutil.disk_usage(disk).free
    (disk / "filling").write_bytes(bytes(max(free - left, 0)))


def names_in(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()} - {"filling"}


@pytest.mark.parametrize("left", [0, 4096, 20_000, 70_000])
@pytest.mark.parametrize("ending", ["ome.tif", "ome.zarr"])
def test_full_disk_leaves_the_older_result(small_disk: Path, ending: str, left: int) -> None:
    path = write_phase(small_disk / f"phase.{ending}", stack_of(0))
    fill(small_disk, left)
    with pytest.raises(OSError, match=rf"phase\.{ending} could not be written") as caught:
        write_phase(path, stack_of(1))
    assert "No space left on device" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert names_in(small_disk) == {path.name}
    np.testing.assert_array_equal(read_results(path).values, stack_of(0).values)
    (small_disk / "filling").unlink()
    write_phase(path, stack_of(1))
    np.testing.assert_array_equal(read_results(path).values, stack_of(1).values)


def test_full_disk_leaves_older_tables_and_recipes(small_disk: Path) -> None:
    table, recipe = small_disk / "table.csv", small_disk / "recipe.json"
    write_table(table, pd.DataFrame({"a": [1]}))
    p4d.Recipe(n_views=3).to_file(recipe)
    before = {p: p.read_bytes() for p in (table, recipe)}
    fill(small_disk, 0)
    with pytest.raises(OSError, match=r"table\.csv could not be written .*No space left"):
        write_table(table, pd.DataFrame({"a": range(10_000)}))
    with pytest.raises(OSError, match=r"recipe\.json could not be written .*No space left"):
        p4d.Recipe(boundary=((0, 0),) * 2000).to_file(recipe)
    assert {p: p.read_bytes() for p in before} == before
    assert names_in(small_disk) == {"table.csv", "recipe.json"}


@pytest.mark.slow
def test_disk_that_fills_up_in_a_run(small_disk: Path, small_video: p4d.Recording) -> None:
    """What was written by then is whole; the rest is not there."""
    from napari_phase4d.pipeline import write_outcome

    outcome = p4d.run(p4d.Recipe(methods=("spatial-2d", "temporal")), small_video)
    needed = outcome.reconstruction["phase"].nbytes
    fill(small_disk, 2 * needed + needed // 2)
    with pytest.raises(OSError, match="could not be written .*No space left on device"):
        write_outcome(outcome, small_disk / "out")
    written = [p for p in sorted((small_disk / "out").iterdir()) if p.name != "run.json"]
    assert len(written) in (1, 2)
    for path in written:
        assert np.isfinite(read_results(path)).all()


LOCKED = """
import os, sys
from pathlib import Path
import numpy as np, pandas as pd
import napari_phase4d as p4d
from napari_phase4d.io import write_phase, write_table
from test_faults_writing import stack_of
stack, folder = stack_of(0), Path(sys.argv[1])
for ending in ("ome.tif", "ome.zarr"):  # what is imported now need not be found later
    write_phase(folder.parent / f"warm.{ending}", stack)
write_table(folder.parent / "warm.csv", pd.DataFrame())
p4d.Recipe().to_file(folder.parent / "warm.json")
os.setuid(65534)
for work in (
    lambda: write_phase(folder / "phase.ome.tif", stack),
    lambda: write_phase(folder / "phase.ome.zarr", stack),
    lambda: write_phase(folder / "new" / "phase.ome.tif", stack),
    lambda: write_table(folder / "table.csv", pd.DataFrame()),
    lambda: p4d.Recipe().to_file(folder / "recipe.json"),
):
    try:
        work()
    except OSError as error:
        print(error)
"""


@pytest.mark.thorough
@pytest.mark.skipif(
    not hasattr(os, "setuid") or os.getuid() != 0, reason="only root can become another user"
)
def test_folder_that_may_not_be_written_to() -> None:
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with public_folder() as place:
        locked = place / "locked"
        locked.mkdir(mode=0o755)
        line = [sys.executable, "-c", LOCKED, str(locked)]
        done = subprocess.run(line, capture_output=True, text=True, check=False, env=env)
        assert done.returncode == 0, done.stderr[-2000:]
        said = done.stdout.splitlines()
        assert len(said) == 5, said
        assert all("could not be written (Permission denied)" in sentence for sentence in said)
        assert not list(locked.iterdir())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files at fault for the command line."""
    place = tmp_path_factory.mktemp("cli")
    tifffile.imwrite(place / "cut.tif", FRAMES, photometric="minisblack")
    os.truncate(place / "cut.tif", 5000)
    tifffile.imwrite(place / "good.tif", FRAMES, photometric="minisblack")
    np.save(place / "objects.npy", np.array([{"a": 1}]), allow_pickle=True)
    (place / "shape.npy").write_bytes(npy_header((10**6, 10**5, 10**5)) + bytes(100))
    np.save(place / "holes.npy", np.where(FRAMES > 200, np.nan, FRAMES))
    np.save(place / "dark.npy", np.zeros((3, 64, 64), np.uint8))
    np.save(place / "colour.npy", np.zeros((3, 64, 64, 3), np.uint8))
    (place / "deep.json").write_text("[" * 100_000)
    (place / "bad.json").write_text('{"n_views": "\\u001b[31mmany"}')
    (place / "escape.json").write_text('{"recording": "../../../../../etc/passwd"}')
    (place / "[red]odd name.tif").write_bytes(b"nothing")
    (place / "file in the way").write_text("x")
    return place


COMMANDS = {
    "info cut.tif": "cut.tif is cut short",
    "info objects.npy": "objects.npy holds Python objects",
    "info shape.npy": "shape.npy",
    "info holes.npy": "holes.npy holds",
    "info colour.npy": "colour.npy",
    "info .": "",
    "info [red]odd+name.tif": "[red]odd name.tif",
    "run good.tif --views 0": "n_views",
    "run good.tif --views 99": "n_views",
    "run cut.tif": "cut.tif is cut short",
    "run dark.npy": "dark.npy",
    "run deep.json": "deep.json is no recipe",
    "run bad.json": "bad.json is no valid recipe",
    "run escape.json": "passwd",
    "run good.tif --boundary 99,0 --method spatial-2d": "does not exist",
    "run good.tif --out file+in+the+way": "file in the way",
    "run good.tif --out /proc/nowhere": "can't be made",
    "compare objects.npy": "objects.npy holds Python objects",
    "compare holes.npy": "holes.npy",
}

#: Runs many commands in one process, each as the program itself would.
DRIVER = """
import io, sys, json
from contextlib import redirect_stderr, redirect_stdout
from napari_phase4d.cli import main
from napari_phase4d.cli import printing
answers = {}
for line in json.loads(sys.argv[1]):
    sys.argv = ["napari-phase4d", *(w.replace("+", " ") for w in line.split(" "))]
    out, err = io.StringIO(), io.StringIO()
    code = 0
    printing.console.file, printing.errors.file = out, err
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException as error:
            code = f"escaped: {error!r}"
    answers[line] = [code, err.getvalue()]
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers(folder: Path) -> dict[str, tuple[object, str]]:
    line = [sys.executable, "-c", DRIVER, json.dumps(list(COMMANDS))]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, tuple[object, str]] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("line", COMMANDS)
def test_commands_end_with_one_sentence(
    answers: dict[str, tuple[object, str]], folder: Path, line: str
) -> None:
    code, said = answers[line]
    assert code == 1, said
    assert "Traceback" not in said
    errors = [s for s in said.splitlines() if s.startswith("Error:")]
    assert len(errors) == 1, said
    assert COMMANDS[line] in errors[0]
    assert "root:" not in said
    assert "\x1b" not in said
    assert not (folder / "phase4d_output").exists()


@pytest.mark.thorough
def test_the_program_itself_ends_so(folder: Path) -> None:
    """Once in a process of its own, and with the whole of the output looked at."""
    line = [sys.executable, "-m", "napari_phase4d", "run", "cut.tif", "--out", "none"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: cut.tif is cut short")
    assert len(done.stderr.splitlines()) == 1
    assert not (folder / "none").exists()


@pytest.mark.slow
def test_output_that_nobody_reads(folder: Path) -> None:
    """A pipe that is closed, as by ``| head``, ends the program without a traceback."""
    line = [sys.executable, "-m", "napari_phase4d", "--help"]
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe:
        done = subprocess.run(line, stdout=pipe, stderr=subprocess.PIPE, text=True, check=False)
    assert "Traceback" not in done.stderr
