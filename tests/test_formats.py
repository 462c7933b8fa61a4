"""Every format: right frames, right metadata, lazy, and one sentence for a bad file."""

from __future__ import annotations

import pickle
import random
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import napari_phase4d as p4d
from format_cases import CASES, Case
from format_writers import INTERVAL_S, PIXEL_UM, noise, numbered, spelled
from napari_phase4d.recording import READERS, Recording

pytestmark = pytest.mark.slow

SHAPE = (96, 128)


def made(folder: Path, case: Case, n: int = 24, shape: tuple = SHAPE) -> tuple[Path, np.ndarray]:
    """Write a recording; return its path and frames."""
    folder.mkdir(exist_ok=True)
    frames = (noise if case.exact else numbered)(n, shape, case.dtype)
    path = case.write(folder, frames)
    return path, frames[:1] if case.single else frames


def opened(path: Path, case: Case) -> Recording:
    return p4d.open_recording(path, **case.options)


def assert_right(case: Case, frame: np.ndarray, frames: np.ndarray, index: int) -> None:
    if case.exact:
        np.testing.assert_array_equal(frame, frames[index])
    else:
        assert spelled(frame) == index
        assert abs(frame.astype(float) - frames[index]).mean() < 4


@pytest.mark.thorough
@pytest.mark.parametrize("name", CASES)
def test_frames_right(tmp_path: Path, name: str) -> None:
    """In any order, from several threads, through dask, and in another process."""
    case = CASES[name]
    path, frames = made(tmp_path / "some", case)
    rec = opened(path, case)
    assert rec.holograms.shape == frames.shape
    order = random.Random(0).choices(range(len(frames)), k=3 * len(frames))
    for index in (*range(len(frames)), *order):
        assert_right(case, rec.raw_frame(index), frames, index)
    with ThreadPoolExecutor(4) as threads:
        for index, frame in zip(order, threads.map(rec.raw_frame, order), strict=True):
            assert_right(case, frame, frames, index)
    last = len(frames) - 1
    assert_right(case, np.asarray(rec.holograms.data[last]), frames, last)
    part = np.asarray(rec.holograms.data[last, 3:, ::2])
    np.testing.assert_array_equal(part, rec.raw_frame(last)[3:, ::2])
    some = np.asarray(rec.holograms[-5:])
    for frame, index in zip(some, range(len(frames))[-5:], strict=True):
        assert_right(case, frame, frames, index)
    reader = READERS.get(getattr(rec.holograms.data, "name", ""))
    if reader is not None:  # what a process of a cluster gets
        for index in (0, len(frames) - 1):
            assert_right(case, pickle.loads(pickle.dumps(reader)).frame(index), frames, index)


@pytest.mark.parametrize("name", CASES)
def test_metadata_right(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    path, frames = made(tmp_path / "some", case)
    rec = opened(path, case)
    assert rec.kind.endswith(case.kind) or rec.kind.startswith(case.kind)
    assert rec.name == path.name
    assert rec.holograms.dtype.newbyteorder("=") == case.dtype
    unknown = any("frame rate is not in the data" in note for note in rec.notes)
    assert unknown == (case.times is None and not case.interval)
    if case.times is not None:
        np.testing.assert_allclose(rec.times_s[:4], case.times, atol=1e-12)
    elif case.interval:
        np.testing.assert_allclose(rec.times_s, np.arange(len(frames)) * INTERVAL_S, rtol=1e-9)
    assert any("microscope is not in the data" in note for note in rec.notes) == (not case.pixel)
    if case.pixel:
        assert rec.optics.pixel_um == pytest.approx(PIXEL_UM, rel=1e-6)
    assert any("with loss" in note for note in rec.notes) == (
        (not case.exact and not case.single) or "H.264" in name
    )


def rests(case: Case) -> bool:
    return not (case.whole or case.single)


@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if rests(case)])
def test_lazy(tmp_path: Path, name: str) -> None:
    """Opening and reading one frame of 32 takes the memory of 4 or, of small ones, a megabyte."""
    case = CASES[name]
    shape = SHAPE if case.options else (240, 320)
    path, _ = made(tmp_path / "many", case, n=32, shape=shape)
    opened(path, case).raw_frame(3)  # what is imported at first use stays
    tracemalloc.start()
    try:
        frame = opened(path, case).raw_frame(28)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < max(4 * frame.nbytes, 2**20)


@pytest.mark.parametrize("name", CASES)
def test_bad_file_gives_one_sentence(tmp_path: Path, name: str) -> None:
    """Cut short: an OSError at opening, or at a frame."""
    case = CASES[name]
    path, frames = made(tmp_path / "some", case)
    piece = case.piece(path)
    whole = piece.read_bytes()
    piece.write_bytes(whole[: int(0.6 * len(whole))])
    if name == "raw dump":  # which can't say how long it should be
        assert any("left over" in note for note in opened(path, case).notes)
        return
    with pytest.raises(OSError, match=r"cut short|damaged|missing|can't be read") as caught:
        rec = opened(path, case)
        for index in range(len(frames)):
            rec.raw_frame(index)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value) or piece.name in str(caught.value)


@pytest.mark.thorough
@pytest.mark.parametrize("name", CASES)
def test_noise_in_a_file_does_no_harm(tmp_path: Path, name: str) -> None:
    """Bytes changed at random: frames, or one sentence, and nothing else."""
    case = CASES[name]
    path, _ = made(tmp_path / "some", case, n=12)
    piece = case.piece(path)
    whole = piece.read_bytes()
    chance, said = random.Random(1), []
    for _ in range(8):
        bad = bytearray(whole)
        for _ in range(chance.choice((1, 8, 64))):
            place = chance.randrange(chance.choice((min(256, len(bad)), len(bad))))
            bad[place] = chance.randrange(256)
        piece.write_bytes(bad)
        try:
            rec = opened(path, case)
            for index in {0, rec.n_frames // 2, rec.n_frames - 1}:
                rec.raw_frame(index)
        except (OSError, ValueError, TypeError) as error:
            said.append(str(error))
    assert all("\n" not in sentence and len(sentence) < 600 for sentence in said)
