"""Recordings that are cut short, damaged, locked, or changed while they are read.

Every format takes part; `faulty.FORMATS` is the list.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from damaging import mutated
from faulty import (
    FILES,
    FOLDERS,
    FORMATS,
    FRAMES,
    judged,
    opened,
    outcome_of,
    public_folder,
    sound,
)

pytestmark = pytest.mark.slow

RIGHT = ("fine", "sentence")
PICTURES = ("PNG", "BMP", "JPEG")
LOSSY = ("JPEG", "AVI, Motion JPEG", "MP4, MPEG-4")
DAMAGED = 40


@pytest.fixture(autouse=True)
def murmurs() -> Iterator[None]:
    """Let libraries warn of damage as they like: what counts is the one sentence."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.parametrize("name", FORMATS)
def test_sound_files_are_read(tmp_path: Path, name: str) -> None:
    """So that what the other tests damage was right before."""
    recording = opened(sound(name, tmp_path))
    number = recording.n_frames
    expected = FRAMES[:number]
    assert number == (1 if name in PICTURES else len(FRAMES))
    found = np.stack([recording.frame(i) for i in range(number)])
    if name in LOSSY:
        assert np.abs(found - expected).mean() < 15
    else:
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", FILES)
def test_files_cut_short_anywhere(tmp_path: Path, name: str) -> None:
    """A part that was lost is said; frames that are given are all, and right."""
    path = sound(name, tmp_path)
    data = path.read_bytes()
    heads = [0, 1, 2, 3, 4, 7, 8, 16, 64, 128, 300]
    lengths = sorted({*heads, *np.linspace(0, len(data) - 1, 15).astype(int).tolist()})
    outcomes = {}
    for length in lengths:
        path.write_bytes(data[:length])
        outcomes[length] = outcome_of(path)
        if outcomes[length] == "fine" and name not in LOSSY and name != "raw":
            recording = opened(path)
            assert recording.n_frames == (1 if name in PICTURES else len(FRAMES)), length
            for number, expected in enumerate(FRAMES[: recording.n_frames]):
                np.testing.assert_array_equal(recording.frame(number), expected)
    assert set(outcomes.values()) <= set(RIGHT), outcomes
    assert outcomes[0] == outcomes[1] == outcomes[4] == "sentence"


def test_raw_files_cut_short_say_what_is_left(tmp_path: Path) -> None:
    """A raw file can't know how many frames it had."""
    path = sound("raw", tmp_path)
    path.write_bytes(path.read_bytes()[:-100])
    recording = opened(path)
    assert recording.n_frames == len(FRAMES) - 1
    assert any("left over behind frame 3" in note for note in recording.notes)


@pytest.mark.parametrize("name", FOLDERS)
def test_folders_with_a_file_missing_or_cut_short(tmp_path: Path, name: str) -> None:
    whole = sound(name, tmp_path)
    places = sorted(p.relative_to(whole) for p in whole.rglob("*") if p.is_file())
    for place in places:
        for keep in (None, 0, 0.5):
            path = tmp_path / f"broken{whole.suffix}"
            shutil.copytree(whole, path)
            data = (path / place).read_bytes()
            if keep is None:
                (path / place).unlink()
            else:
                (path / place).write_bytes(data[: int(keep * len(data))])
            outcome = outcome_of(path, (0, 0.25, 0.5, 0.75, 1))
            assert outcome in RIGHT, (place, keep, outcome)
            shutil.rmtree(path)


@pytest.mark.thorough
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_bytes(tmp_path: Path, name: str) -> None:
    """The same damage as in `benchmarks/fuzz.py`, which goes on for longer."""
    whole = sound(name, tmp_path)
    wrong = {}
    for seed in range(DAMAGED):
        rng = np.random.default_rng([seed, list(FORMATS).index(name)])
        path = tmp_path / f"broken{whole.suffix}" if whole.is_dir() else whole
        if whole.is_dir():
            shutil.copytree(whole, path)
        inside = sorted(p for p in path.rglob("*") if p.is_file())
        victim = path if path.is_file() else rng.choice(inside)
        data = victim.read_bytes()
        kind, broken = mutated(data, rng)
        victim.write_bytes(broken)
        outcome = outcome_of(path)
        if outcome not in RIGHT:
            wrong[seed, kind] = outcome
        if path.is_dir():
            shutil.rmtree(path)
        else:
            victim.write_bytes(data)
    assert not wrong


def change(path: Path, how: str) -> None:
    """Do to a file, or to all files of a folder, what other programs may do."""
    for victim in [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]:
        size = victim.stat().st_size
        if how == "removed":
            victim.unlink()
        elif how == "emptied":
            victim.write_bytes(b"")
        elif how == "halved":
            os.truncate(victim, size // 2)
        elif how == "overwritten":
            victim.write_bytes(np.random.default_rng(0).bytes(size))
        elif how == "replaced":
            other = victim.with_name("other")
            other.write_bytes(bytes(size))
            other.replace(victim)


CHANGES = ("removed", "emptied", "halved", "overwritten", "replaced")


def read_while_changed(folder: Path) -> dict[str, str]:
    """Change files after their first frame was read, then read all frames; say how that went."""
    outcomes = {}
    for name in FORMATS:
        for how in CHANGES:
            place = folder / f"{len(outcomes)}"
            place.mkdir()
            path = sound(name, place)
            recording = opened(path)
            before = [recording.frame(i).copy() for i in range(recording.n_frames)]
            recording = opened(path)
            recording.frame(0)
            change(path, how)
            outcome = "fine"
            for number, expected in enumerate(before):
                try:
                    if not np.array_equal(recording.frame(number), expected):
                        outcome = f"frame {number} is another one"
                except Exception as error:
                    said = judged(error, path)
                    outcome = said if said != "sentence" or outcome == "fine" else outcome
            outcomes[f"{name}, {how}"] = outcome
    return outcomes


@pytest.fixture(scope="module")
def outcomes_of_change(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Read in another process, which the system may end for touching what is gone."""
    folder = tmp_path_factory.mktemp("changed")
    line = [sys.executable, "-W", "ignore", __file__, str(folder)]
    search = os.pathsep.join(sys.path)
    done = subprocess.run(
        line, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": search}
    )
    assert done.returncode == 0, f"ended with {done.returncode}: {done.stderr[-2000:]}"
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="Windows holds files that are open")
@pytest.mark.parametrize("how", CHANGES)
@pytest.mark.parametrize("name", FORMATS)
def test_files_that_change_while_they_are_read(
    outcomes_of_change: dict[str, str], name: str, how: str
) -> None:
    """Frames come as they were, or with a sentence; never other ones."""
    assert outcomes_of_change[f"{name}, {how}"] in RIGHT


LOCKED = """
import os, sys, warnings
warnings.simplefilter("ignore")
from faulty import FORMATS, opened, outcome_of, sound
from pathlib import Path
folder = Path(sys.argv[1])
paths = []
for name in FORMATS:
    place = folder / str(len(paths))
    place.mkdir()
    paths.append(sound(name, place))
    outcome_of(paths[-1])  # what it imports can't be imported later
    for file in ([paths[-1]] if paths[-1].is_file() else paths[-1].rglob("*")):
        file.chmod(0o755 if file.is_dir() else 0)
os.setuid(65534)
for name, path in zip(FORMATS, paths):
    print(name, outcome_of(path), sep=": ")
"""


@pytest.mark.thorough
@pytest.mark.skipif(
    not hasattr(os, "setuid") or os.getuid() != 0, reason="only root can become another user"
)
def test_files_that_may_not_be_read() -> None:
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with public_folder() as folder:
        line = [sys.executable, "-c", LOCKED, str(folder)]
        done = subprocess.run(line, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.splitlines() == [f"{name}: sentence" for name in FORMATS]


if __name__ == "__main__":
    print(json.dumps(read_while_changed(Path(sys.argv[1]))))
