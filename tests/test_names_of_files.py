"""Which files of a folder are frames, and in which order, by their names; what is said of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from format_writers import noise
from test_format_mends import numbered

FRAMES = noise(6, (24, 32), np.uint16)


def images(folder: Path, *names: str) -> list[np.ndarray]:
    """Write an image of each name, all of them different."""
    frames = [FRAMES[0] + i for i in range(len(names))]
    for name, frame in zip(names, frames, strict=True):
        tifffile.imwrite(folder / name, frame)
    return frames


def test_an_image_with_another_name_is_no_frame(tmp_path: Path) -> None:
    frames = images(tmp_path, "background.tif", *(f"frame_{i:03d}.tif" for i in range(4)))
    rec = p4d.open_recording(tmp_path)
    np.testing.assert_array_equal(rec.holograms.values, frames[1:])
    told = "background.tif is named otherwise than the other files, and is left out"
    assert any(told in note for note in rec.notes)
    rec = p4d.open_recording(tmp_path / "*.tif")
    np.testing.assert_array_equal(rec.holograms.values, frames)
    told = "background.tif is named otherwise than the other files, but read with them."
    assert told in rec.notes


@pytest.mark.parametrize(
    ("beside", "n"), [(["background.tif"], 5), (["dark_001.tif"], 40), (["b1.tif", "b2.tif"], 40)]
)
def test_what_lies_beside_numbers_alone_is_no_frame(
    tmp_path: Path, beside: list[str], n: int
) -> None:
    images(tmp_path, *beside, *(f"{i:04d}.tif" for i in range(n)))
    rec = p4d.open_recording(tmp_path)
    assert rec.n_frames == n
    assert any(note.startswith(beside[0]) and "left out" in note for note in rec.notes)


@pytest.mark.parametrize(
    "names", [("holo.tif", "holo_1.tif", "holo_2.tif"), ("a.tif", "b.tif", "c.tif")]
)
def test_names_without_numbers_may_be_frames(tmp_path: Path, names: tuple[str, ...]) -> None:
    frames = images(tmp_path, *names)
    rec = p4d.open_recording(tmp_path)
    np.testing.assert_array_equal(rec.holograms.values, frames)
    assert not any("named otherwise" in note for note in rec.notes)


@pytest.mark.parametrize(
    "names",
    [
        [f"{colour}_{i:03d}.tif" for colour in ("green", "red") for i in range(6)],
        [f"im{i:03d}_{cell}.tif" for cell in ("cellA", "cellB") for i in range(6)],
    ],
)
def test_series_beside_each_other_are_said(tmp_path: Path, names: list[str]) -> None:
    """Their frames came in turn, without a word."""
    images(tmp_path, *names, "background.tif")
    rec = p4d.open_recording(tmp_path)
    assert rec.n_frames == 12
    assert any(note.startswith("background.tif is named otherwise") for note in rec.notes)
    assert any("if they are several series" in note for note in rec.notes)
    rec = p4d.open_recording(tmp_path / names[0].replace("000", "*"))
    assert not any("if they are several series" in note for note in rec.notes)


@pytest.mark.parametrize(
    "names",
    [
        [f"{day}_{i:02d}.tif" for day in ("31Jan", "01Feb") for i in range(3)][1:],
        ["IMG_001.tif", "IMG_002.tif", "IMG_003.tif", "img_004.tif"],
        ["A1.tif", "A2.tif", "A3.tif", "B4.tif"],
        [f"img{n}{part}.tif" for n in range(4) for part in "abcd"],
        [f"frame_{n:04x}.tif" for n in range(40)],
    ],
)
def test_letters_may_change_in_the_course_of_a_recording(tmp_path: Path, names: list[str]) -> None:
    images(tmp_path, *names)
    rec = p4d.open_recording(tmp_path)
    assert rec.n_frames == len(names)
    assert not any("several series" in note for note in rec.notes)


@pytest.mark.parametrize("way", ["folder", "pattern", "list"])
def test_numbers_that_are_missing_in_a_folder_are_said(tmp_path: Path, way: str) -> None:
    names = [f"frame_{i:06d}.tif" for i in (0, 1, 2, 6, 7, 8)]
    images(tmp_path, *names)
    given = {"pattern": tmp_path / "*.tif", "list": [tmp_path / name for name in names]}
    rec = p4d.open_recording(given.get(way, tmp_path))
    told = "3 numbers are missing in the names of the files, the first behind frame_000002.tif"
    assert sum(told in note for note in rec.notes) == 1


def test_several_numbers_that_vary_are_said(tmp_path: Path) -> None:
    names = [f"img_channel{c:03d}_time{t:09d}_z000.tif" for c in range(2) for t in range(3)]
    images(tmp_path, *names)
    notes = p4d.open_recording(tmp_path).notes
    assert any("2 numbers in the names of the files vary and none counts" in n for n in notes)


@pytest.mark.parametrize(
    "names",
    [
        ("f_0001_120000.tif", "f_0002_120003.tif", "f_0003_120003.tif"),
        ("f_0.9.tif", "f_1.0.tif", "f_1.1.tif", "f_1.2.tif"), ("f0.tif", "f10.tif", "f20.tif"),
    ],
)  # fmt: skip
def test_names_that_count_frames_are_not_doubted(tmp_path: Path, names: tuple[str, ...]) -> None:
    images(tmp_path, *names)
    assert not any("names" in note for note in p4d.open_recording(tmp_path).notes)


def test_numbers_that_are_missing_among_datasets_are_said(tmp_path: Path) -> None:
    with numbered(tmp_path / "a.h5", 6) as file:
        del file["video/2"], file["video/3"]
        file["video/6"], file["video/7"] = FRAMES[0], FRAMES[1]
    rec = p4d.open_recording(tmp_path / "a.h5")
    told = "2 numbers are missing in the names of the datasets, the first behind video/1"
    assert rec.n_frames == 6
    assert any(told in note for note in rec.notes)


@pytest.mark.parametrize(
    "names",
    [
        ("holo_0.1.tif", "holo_0.15.tif", "holo_0.2.tif", "holo_10.05.tif"),
        ("run1.8.tif", "run1.9.tif", "run1.10.tif", "run1.11.tif"),
        ("run1.7.tif", "run1.9.tif", "run1.11.tif", "run1.13.tif"),
        ("t1.05.tif", "t1.10.tif", "t1.20.tif", "t2.00.tif"), ("f.9.tif", "f.10.tif", "f.11.tif"),
        ("26.2.1.tif", "26.11.2.tif"),
    ],
)  # fmt: skip
def test_numbers_with_decimals_have_their_order(tmp_path: Path, names: tuple[str, ...]) -> None:
    frames = images(tmp_path, *names)
    for given in (tmp_path, tmp_path / "*.tif"):
        rec = p4d.open_recording(given)
        np.testing.assert_array_equal(rec.holograms.values, frames)
        told = any("taken for decimals" in note for note in rec.notes)
        assert told == ("holo_0.15.tif" in names)
