"""What is chosen of a file that holds several things, and what is told of it."""

from __future__ import annotations

import logging
import subprocess
import sys
import time
from pathlib import Path

import h5py
import imageio.v3 as iio
import numpy as np
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from format_writers import film, gif, noise
from helpers import measured
from napari_phase4d.io import RawLayout, holds_phase, open_phase
from napari_phase4d.io.microscopes import chosen_place
from napari_phase4d.recording import READERS

FRAMES = noise(6, (24, 32), np.uint16)


def test_hdf5_dataset_is_guessed_and_told(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["large/background"] = np.zeros((9, 64, 64))
        file["small/holograms"] = FRAMES
        file["other"] = FRAMES + 1
        file["table"] = np.zeros((1000, 3))
        file["words"] = np.array([b"one"])
    rec = p4d.open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)
    assert any("'small/holograms' is read" in note and "other" in note for note in rec.notes)
    rec = p4d.open_recording(tmp_path / "a.h5", dataset="/other")
    np.testing.assert_array_equal(rec.holograms.values, FRAMES + 1)
    assert not any("is read" in note for note in rec.notes)
    with pytest.raises(ValueError, match=r"has no array 'x'; it has large/background, other"):
        p4d.open_recording(tmp_path / "a.h5", dataset="x")
    with pytest.raises(ValueError, match="'table' is|in 'table'|at least 8 x 8"):
        p4d.open_recording(tmp_path / "a.h5", dataset="table")


def test_hdf5_without_frames(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["table"] = np.zeros((1000, 3))
    with pytest.raises(ValueError, match="no array of numbers with two or three axes"):
        p4d.open_recording(tmp_path / "a.h5")


@pytest.mark.parametrize("rest", [0, 5])
def test_hdf5_of_an_unfinished_recording(tmp_path: Path, rest: int) -> None:
    """Frames that were planned but never written are not taken for black ones."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("frames", (6, 24, 32), "u2", chunks=(1, 24, 32))
        data[:rest] = FRAMES[:rest]
    if rest == 0:
        with pytest.raises(OSError, match="holds nothing of it"):
            p4d.open_recording(tmp_path / "a.h5")
        return
    rec = p4d.open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(rec.raw_frame(4), FRAMES[4])
    with pytest.raises(OSError, match=r"frame 5 of a\.h5 can't be read.*never written"):
        rec.raw_frame(5)


@pytest.mark.measured
@pytest.mark.parametrize(
    ("name", "shape", "pixel_um"),
    [
        ("multiplexed/qlsi_paa_bead.h5", (1, 720, 720), 0.06575),
        ("offaxis/01_holo_Vbp_130V_0V_bin2_crop.hdf5", (1, 512, 512), 0.919751644e-3),
    ],
)
def test_measured_hdf5(name: str, shape: tuple, pixel_um: float) -> None:
    path = measured(name)
    rec = p4d.open_recording(path)
    assert rec.holograms.shape == shape
    assert rec.optics.pixel_um == pytest.approx(pixel_um)
    with h5py.File(path) as file:
        name = "0" if "0" in file else "Experiments/Hologram of Fe needle/data"
        np.testing.assert_array_equal(rec.raw_frame(0), file[name][()])


def test_tiff_with_a_further_axis(tmp_path: Path) -> None:
    stack = np.arange(4 * 3 * 16 * 20, dtype=np.uint16).reshape(4, 3, 16, 20)
    for name, options in (("flat", {}), ("packed", {"compression": "zlib"})):
        path = tmp_path / f"{name}.tif"
        tifffile.imwrite(
            path, stack, metadata={"axes": "TZYX"}, photometric="minisblack", **options
        )
        with pytest.raises(ValueError, match=r'T=4, Z=3, Y=16, X=20.*dataset="Z=0"'):
            p4d.open_recording(path)
        for place in range(3):
            rec = p4d.open_recording(path, dataset=f"Z={place}")
            np.testing.assert_array_equal(rec.holograms.values, stack[:, place])
            np.testing.assert_array_equal(rec.raw_frame(3), stack[3, place])
        for wrong in ("Z=3", "C=0", "Y=0", "Z", "Z=x", ""):
            with pytest.raises(ValueError, match="is no place there"):
                p4d.open_recording(path, dataset=wrong)


@pytest.mark.measured
def test_measured_stack_with_three_steps() -> None:
    path = measured("multiplexed/profilometry_t00-29.tif")
    rec = p4d.open_recording(path, dataset="Z=1")
    np.testing.assert_array_equal(rec.holograms.values, tifffile.imread(path)[:, 1])


@pytest.mark.measured
def test_remarks_of_the_tiff_library_stay_out_of_sight(caplog: pytest.LogCaptureFixture) -> None:
    path = measured("offaxis/single_holo.tif")
    with caplog.at_level(logging.DEBUG):
        p4d.open_recording(path).raw_frame(0)
    assert caplog.records == []
    with caplog.at_level(logging.WARNING):
        tifffile.imread(path)  # the user's own use of it is not silenced
    assert caplog.records


def test_ome_times_that_are_not_even(tmp_path: Path) -> None:
    times = [0.0, 0.5, 1.25, 1.5, 3.0, 3.5]
    tifffile.imwrite(
        tmp_path / "a.ome.tif", FRAMES, ome=True, photometric="minisblack",
        metadata={"axes": "TYX", "Plane": {"DeltaT": [1000 * t + 70 for t in times],
                                           "DeltaTUnit": ["ms"] * 6}},
    )  # fmt: skip
    np.testing.assert_allclose(p4d.open_recording(tmp_path / "a.ome.tif").times_s, times)


def test_files_of_a_list_follow_one_another(tmp_path: Path) -> None:
    for i in range(3):
        np.save(tmp_path / f"{i}.npy", FRAMES[2 * i : 2 * i + 2])
    files = [str(tmp_path / f"{i}.npy") for i in (2, 0, 1)]
    rec = p4d.open_recording(files)
    np.testing.assert_array_equal(rec.holograms.values, FRAMES[[4, 5, 0, 1, 2, 3]])
    np.save(tmp_path / "3.npy", FRAMES[:, ::2])
    with pytest.raises(ValueError, match=r"3\.npy holds uint16 frames of \(12, 32\)"):
        p4d.open_recording([*files, tmp_path / "3.npy"])
    iio.imwrite(tmp_path / "4.png", FRAMES[0])
    with pytest.raises(ValueError, match=r"with \.npy, \.png can't be joined"):
        p4d.open_recording([*files, tmp_path / "4.png"])
    with pytest.raises(OSError, match="there is no file"):
        p4d.open_recording(tmp_path / "none*.tif")


def test_films_follow_one_another(tmp_path: Path) -> None:
    frames = noise(6, (24, 32), np.uint8)
    for i in range(2):
        film(".avi", "rawvideo", "gray")(tmp_path, frames[3 * i : 3 * i + 3])
        (tmp_path / "rec.avi").rename(tmp_path / f"part{i}.avi")
    rec = p4d.open_recording(tmp_path)
    np.testing.assert_array_equal(rec.holograms.values, frames)
    assert rec.kind == "2 uncompressed in AVI files"
    assert rec.frame_rate_hz == pytest.approx(8)


@pytest.mark.slow
def test_a_folder_of_many_files_opens_at_once(tmp_path: Path) -> None:
    frame = noise(1, (16, 16), np.uint8)[0]
    iio.imwrite(tmp_path / "frame0.png", frame)
    for i in range(1, 20_000):
        (tmp_path / f"frame{i}.png").symlink_to(tmp_path / "frame0.png")
    (tmp_path / "overview.bmp").write_bytes(b"")
    p4d.open_recording(frame)
    began = time.perf_counter()
    rec = p4d.open_recording(tmp_path)
    took = time.perf_counter() - began
    assert rec.n_frames == 20_000
    assert any(".bmp files, which are not read" in note for note in rec.notes)
    np.testing.assert_array_equal(rec.raw_frame(19_999), frame)
    assert took < 15  # 0.2 s on a usual machine, more beside other work; a header each: a minute


RAW_FAULTS = {
    "height": ({"height": 0}, "the height of raw frames must be 1 to 1048576, but is 0"),
    "dtype": ({"dtype": "object"}, "raw pixels must be one of uint8"),
    "order": ({"byte_order": "="}, 'must be "<" or ">"'),
    "gap": ({"gap_bytes": -1}, "gap_bytes of a raw file must be 0 or more"),
}


@pytest.mark.parametrize("case", RAW_FAULTS)
def test_raw_layout_is_checked(case: str) -> None:
    changed, sentence = RAW_FAULTS[case]
    with pytest.raises(ValueError, match=sentence):
        RawLayout(**{"height": 24, "width": 32, **changed})


def test_raw_file_without_layout_says_how_to_give_it(tmp_path: Path) -> None:
    path = tmp_path / "camera.dat"
    path.write_bytes(FRAMES.tobytes() + b"end")
    with pytest.raises(ValueError, match=r"camera\.dat is raw .*RawLayout\(height, width"):
        p4d.open_recording(path)
    rec = p4d.open_recording(path, raw=RawLayout(24, 32))
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)
    assert any("3 bytes are left over behind frame 5" in note for note in rec.notes)
    with pytest.raises(OSError, match="9219 bytes, but one frame of 2400 x 3200 uint16 needs"):
        p4d.open_recording(path, raw=RawLayout(2400, 3200))


def koala_phase(path: Path, values: np.ndarray, unit: int = 1) -> None:
    head = np.array(
        [(1, 0, 23, values.shape[1], values.shape[0], 2.5e-7, 1e-7, unit)],
        [("v", "u1"), ("e", "u1"), ("n", "<i4"), ("w", "<i4"), ("h", "<i4"), ("p", "<f4"),
         ("c", "<f4"), ("u", "u1")],
    )  # fmt: skip
    path.write_bytes(head.tobytes() + values.astype("<f4").tobytes())


def test_koala_phase(tmp_path: Path) -> None:
    phase = np.random.default_rng(0).uniform(-3, 3, (3, 12, 16)).astype(np.float32)
    folder = tmp_path / "run" / "Phase" / "Float" / "Bin"
    folder.mkdir(parents=True)
    for i, frame in enumerate(phase):
        koala_phase(folder / f"{i:05d}_phase.bin", frame)
    lines = [f"{i:05d} 12:00:00.0 2026.01.31 {t}" for i, t in enumerate((0, 400, 1000))]
    (tmp_path / "run" / "timestamps.txt").write_text("\n".join(lines))
    for path, n in ((folder / "00000_phase.bin", 1), (folder, 3), (tmp_path / "run", 3)):
        assert holds_phase(path)
        found = open_phase(path)
        assert found.dims == ("time", "angle", "y", "x")
        np.testing.assert_array_equal(found.values[:, 0], phase[:n])
        np.testing.assert_allclose(found["x"][1], 0.25, rtol=1e-6)
    np.testing.assert_allclose(found["time"], [0, 0.4, 1])
    koala_phase(tmp_path / "height.bin", phase[0] * 1e-7, unit=2)
    np.testing.assert_allclose(open_phase(tmp_path / "height.bin")[0, 0], phase[0], rtol=1e-5)
    assert isinstance(p4d.io.open_input(tmp_path / "run"), xr.DataArray)
    (folder / "00001_phase.bin").write_bytes((folder / "00001_phase.bin").read_bytes()[:-4])
    with pytest.raises(OSError, match=r"00001_phase\.bin is cut short"):
        open_phase(folder)


def test_koala_times_that_do_not_fit(tmp_path: Path) -> None:
    holograms = tmp_path / "Holograms"
    holograms.mkdir()
    for i in range(3):
        tifffile.imwrite(holograms / f"{i:05d}_holo.tif", FRAMES[i].astype(np.uint8))
    (tmp_path / "timestamps.txt").write_text("00000 12:00:00.0 2026.01.31 0\nrubbish\n")
    rec = p4d.open_recording(tmp_path)
    assert any("timestamps.txt has 1 times for 3 frames" in note for note in rec.notes)


MISSING = """
import sys
for name in {names!r}:
    sys.modules[name] = None
import napari_phase4d as p4d
try:
    p4d.open_recording({path!r})
except OSError as error:
    print(error)
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("ending", "names", "sentence"),
    [
        (".avi", ["av"], 'rec.avi is a film; to read it, pip install "napari-phase4d[video]"'),
        (".czi", ["bioio"], 'pip install "napari-phase4d[bio]"'),
        (".czi", [], "install the reader of bioio for it"),
    ],
)
def test_missing_packages_are_named(
    tmp_path: Path, ending: str, names: list, sentence: str
) -> None:
    path = tmp_path / f"rec{ending}"
    path.write_bytes(b"RIFF" + bytes(100))
    code = MISSING.format(names=names, path=str(path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert sentence in done.stdout
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize(
    ("dataset", "place"),
    [("C=1,Z=2", {"C": 1, "Z": 2}), ("z=0, c=1", {"C": 1, "Z": 0}), ("C=1", None), (None, None),
     ("Z=2", None), ("C=2,Z=0", None), ("T=0,C=0,Z=0", None), ("C", None), ("", None)],
)  # fmt: skip
def test_bioio_place(dataset: str | None, place: dict | None) -> None:
    sizes = {"T": 5, "C": 2, "Z": 3, "Y": 64, "X": 48, "S": 1}
    path = Path("cells.czi")
    if place is not None:
        assert chosen_place(path, sizes, dataset) == place
        return
    with pytest.raises(ValueError, match=r"cells\.czi has the axes T=5, C=2, Z=3, Y=64, X=48"):
        chosen_place(path, sizes, dataset)


def test_bioio_place_of_one_slice() -> None:
    sizes = {"T": 5, "C": 2, "Z": 1, "Y": 64, "X": 48, "S": 1}
    path = Path("cells.czi")
    assert chosen_place(path, sizes, "C=1") == {"C": 1, "Z": 0}
    with pytest.raises(ValueError, match='choose one place, as with dataset="C=0"$'):
        chosen_place(path, sizes, None)


@pytest.mark.slow
def test_bioio_colour(tmp_path: Path) -> None:
    frames = np.stack([noise(4, (32, 32), np.uint8) // part for part in (1, 2, 3)], -1)
    with pytest.raises(ValueError, match="is in colour"):
        p4d.open_recording(gif(tmp_path, frames))


def test_single_frames_do_not_go_through_dask(tmp_path: Path) -> None:
    """Nor do those of a recording that was calibrated; a cut one is read by dask, and right."""
    tifffile.imwrite(tmp_path / "a.tif", FRAMES, compression="zlib", photometric="minisblack")
    rec = p4d.open_recording(tmp_path / "a.tif").calibrated(frame_rate_hz=5)
    assert rec.holograms.data.name in READERS
    cut = p4d.open_recording(rec.holograms[2:, 4:, :-4])
    assert cut.holograms.data.name not in READERS
    np.testing.assert_array_equal(cut.raw_frame(1), FRAMES[3, 4:, :-4])
    np.testing.assert_array_equal(rec.raw_frame(-1), FRAMES[-1])


TWELVE = noise(12, (24, 32), np.uint16)
OTHERS = {
    "smaller": TWELVE[0][:20, :20],
    "of another kind": TWELVE[0].astype(np.uint8),
    "in colour": np.repeat(TWELVE[0][..., np.newaxis], 3, 2),
}


@pytest.mark.parametrize("metadata", [{}, None], ids=["described", "plain"])
@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("place", [0, 5, 11])
def test_tiff_with_a_page_that_is_no_frame(
    tmp_path: Path, other: str, place: int, metadata: dict | None
) -> None:
    """The frames keep their times: it is a lost one among them, or left out at an end."""
    path, expected = tmp_path / "video.tif", TWELVE.copy()
    with tifffile.TiffWriter(path) as tif:
        for number, frame in enumerate(TWELVE):
            page = OTHERS[other] if number == place else frame
            tif.write(page, contiguous=False, metadata=metadata)
    if place == 5:
        expected[place] = 0
    else:
        expected = np.delete(expected, place, 0)
    if metadata is None and place == 5 and other == "smaller":  # tifffile can't tell it apart
        with pytest.raises(OSError, match="has a page among its frames that is of another size"):
            p4d.open_recording(path)
        return
    rec = p4d.open_recording(path)
    np.testing.assert_array_equal(rec.holograms, expected)
    assert sum("other" in note for note in rec.notes) == 1


@pytest.mark.parametrize(
    ("stacks", "read", "said"),
    [
        ([(24, 32), (6, 24, 32)], (24, 32), "Of 7 pages 1 are read"),
        ([(10, 10), (3, 5, 24, 32)], (10, 10), "Of 16 pages 1 are read"),
        ([(10, 10), (6, 24, 32)], (6, 24, 32), "1 page before or behind the frames"),
    ],
    ids=str,
)
def test_tiff_with_series_of_which_nobody_knows_what_they_are(
    tmp_path: Path, stacks: list, read: tuple, said: str
) -> None:
    """A reference before a stack is no frame of it, and a further axis is no time."""
    path = tmp_path / "video.tif"
    for shape in stacks:
        tifffile.imwrite(path, noise(1, shape, np.uint16)[0], append=True)
    rec = p4d.open_recording(path)
    assert rec.holograms.shape[-len(read) :] == read
    assert len(rec.holograms) == (1 if len(read) == 2 else read[0])
    assert any(said in note for note in rec.notes)


def test_tiff_of_two_series_with_further_axes_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "video.tif"
    for _ in range(2):
        tifffile.imwrite(path, noise(1, (2, 5, 24, 32), np.uint16)[0], append=True)
    with pytest.raises(ValueError, match="dimensions"):
        p4d.open_recording(path)
