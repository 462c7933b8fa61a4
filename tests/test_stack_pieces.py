"""Stacks on disk: blocks, pieces and what is wrong with them, one file at a time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from pathlib import Path

import google_crc32c
import numcodecs
import numpy as np
import pytest
import zarr

from napari_phase4d.io.zarr_results import create_blocks
from napari_phase4d.pipeline.stored import Shelf, Stored
from napari_phase4d.stack import Block, block_at, block_frames, blocks_of, limits_of
from napari_phase4d.unwrapping import (
    working_frames,
)


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut frames, small as they are, into blocks of 8: a short stack is to have several."""
    monkeypatch.setattr("napari_phase4d.stack.SMALL_FRAMES", 8)


def test_blocks_cover_all_frames_once() -> None:
    shape = (19, 2, 30, 40)
    blocks = blocks_of(shape)
    assert [t for block in blocks for t in block.times] == list(range(19))
    assert all(t in block_at(shape, t).times for t in range(19))
    assert block_frames((1000, 2, 4096, 4096)) == 1
    assert block_frames((3, 2, 10, 10)) == 3


def test_threads_may_write_parts_of_the_same_piece(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path)
    stored = shelf.new("numbers", (64, 1, 32, 32))
    frames = np.random.default_rng(0).normal(size=stored.shape).astype(np.float32)

    def write(block: Block) -> None:
        stored.write(block, frames[block.start : block.stop])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, blocks_of(stored.shape, 3)))  # a piece holds 16
    np.testing.assert_array_equal(stored.read(Block(0, 64)), frames)


STACK = (11, 3, 6, 5)


@pytest.mark.parametrize(
    ("packed", "few", "separator"),
    [(False, None, "."), (False, 0, "."), (True, None, "."), (False, None, "/")],
)
def test_stacks_on_disk_are_zarr_whatever_reads_and_writes_them(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    packed: bool,
    few: int | None,
    separator: str,
) -> None:
    """Small frames of a file together, and large ones one by one; files in folders or not."""
    keys = {"name": "default", "separator": separator}
    monkeypatch.setattr("napari_phase4d.io.zarr_results.FLAT", keys)
    if few is not None:
        monkeypatch.setattr("napari_phase4d.io.frame_files.FEW_BYTES", few)
    numbers = np.random.default_rng(0).normal(size=STACK).astype(np.float32)
    path = create_blocks(tmp_path / "a.ome.zarr", STACK, 4, packed=packed)
    stored = Stored(path, STACK)
    for block in blocks_of(STACK, 4):
        stored.write(block, numbers[block.start : block.stop])
    zarr_array = zarr.open_array(path, mode="r+")
    assert np.array_equal(zarr_array[:], numbers)  # Zarr checks the sums
    numbers[3:9, 1] = zarr_array[3:9, 1] = 7
    stored.write(Block(4, 8), numbers[4:8, 2:] * 2, slice(2, 3))
    numbers[4:8, 2] *= 2
    for start, stop in combinations(range(len(numbers) + 1), 2):
        for angles in (slice(None), slice(1, 3), slice(0, 1)):
            found = stored.read(Block(start, stop), angles)
            assert found.flags.c_contiguous
            assert np.array_equal(found, numbers[start:stop, angles])
    assert np.array_equal(zarr_array[:], numbers)
    assert not [*path.rglob("*.partial")]


def test_limits_are_those_of_what_is_known() -> None:
    numbers = np.arange(-3, 9, dtype=np.float32).reshape(3, 4)
    assert limits_of(numbers) == (-3, 8)
    numbers[0, 0], numbers[2, 3] = np.nan, np.inf
    assert limits_of(numbers) == (-2, 7)
    numbers[:] = -np.inf
    assert limits_of(numbers) == limits_of(numbers[:0]) == (0, 0)


@pytest.mark.parametrize("packed", [False, True])
def test_numbers_in_any_order_and_of_any_type_are_written(tmp_path: Path, packed: bool) -> None:
    """A file of one frame each, as of large ones."""
    shape = (2, 1, 30, 20)
    numbers = np.random.default_rng(1).normal(size=(2, 1, 20, 30)).transpose(0, 1, 3, 2)
    stored = Stored(create_blocks(tmp_path / "a.ome.zarr", shape, 1, packed=packed), shape)
    stored.write(Block(0, 2), numbers)
    assert np.array_equal(stored.read(Block(0, 2)), numbers.astype(np.float32))


def flipped(file: Path) -> None:
    whole = bytearray(file.read_bytes())
    whole[20] ^= 1
    file.write_bytes(whole)


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-30])


def longer(file: Path) -> None:
    file.write_bytes(file.read_bytes() + b"more")


def emptied(file: Path) -> None:
    file.write_bytes(b"")


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("piece", [1, 2])
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (flipped, "checksum"),
        (cut, "is damaged"),
        (longer, "is damaged"),
        (emptied, "is damaged"),
        (Path.unlink, "is missing"),
    ],
)
def test_a_damaged_piece_of_a_stack_is_an_error(
    tmp_path: Path, damage: Callable[[Path], None], words: str, piece: int, packed: bool
) -> None:
    """The last piece has fewer frames than its file."""
    path = create_blocks(tmp_path / "a.ome.zarr", STACK, 4, packed=packed)
    stored = Stored(path, STACK)
    stored.write(Block(0, 11), np.ones(STACK, np.float32))
    damage(path / f"c.{piece}.2.0.0")
    assert (stored.read(Block(0, 4)) == 1).all()
    with pytest.raises(OSError, match=words):
        stored.read(Block(4 * piece, min(4 * piece + 4, 11)))


@pytest.mark.parametrize("frames", [0, 3, 5])
def test_a_packed_piece_of_another_size_is_an_error(tmp_path: Path, frames: int) -> None:
    """Its checksum is right: somebody else wrote it."""
    path = create_blocks(tmp_path / "a.ome.zarr", STACK, 4, packed=True)
    stored = Stored(path, STACK)
    stored.write(Block(0, 11), np.ones(STACK, np.float32))
    file = path / "c.0.1.0.0"
    packed = numcodecs.Blosc().encode(np.ones((frames, 6, 5), np.float32))
    file.write_bytes(packed + google_crc32c.value(packed).to_bytes(4, "little"))
    with pytest.raises(OSError, match="it holds more or less than its frames"):
        stored.read(Block(0, 4))
    packed = numcodecs.Blosc().encode(np.ones((4, 6, 5), np.float32))[:16].ljust(200, b"x")
    packed = packed[:12] + len(packed).to_bytes(4, "little") + packed[16:]
    file.write_bytes(packed + google_crc32c.value(packed).to_bytes(4, "little"))
    with pytest.raises(OSError, match="it can't be unpacked"):
        stored.read(Block(0, 4))


@pytest.mark.parametrize("packed", [False, True])
def test_frames_that_do_not_fit_are_not_written(tmp_path: Path, packed: bool) -> None:
    stored = Stored(create_blocks(tmp_path / "a.ome.zarr", STACK, 4, packed=packed), STACK)
    for shape in ((2, 3, 6, 5), (8, 3, 6, 5), (4, 3, 5, 6), (4, 1, 6, 5), (4, 5, 6, 5)):
        with pytest.raises(ValueError, match="can't be written"):
            stored.write(Block(0, 4), np.ones(shape, np.float32))
    stored.write(Block(0, 11), np.ones(STACK, np.float32))
    assert stored.read(Block(8, 12)).shape == (3, 3, 6, 5)


@pytest.mark.parametrize("pixels", [1000, 40_000, 80_000, 131_000, 300_000, 655_360, 10**7])
def test_what_is_worked_on_at_a_time_are_whole_pieces(pixels: int) -> None:
    shape = (1000, 1, pixels, 1)
    assert working_frames(shape) % block_frames(shape) == 0


def test_a_half_written_stack_has_no_name(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path)
    stored = shelf.new("wrapped", (19, 2, 30, 40))
    block = block_at(stored.shape, 0)
    stored.write(block, np.ones((len(block), 2, 30, 40), np.float32))
    assert not (tmp_path / "wrapped.ome.zarr").exists()
    shelf.clear()
    assert not list(tmp_path.iterdir())
