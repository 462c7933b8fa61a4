"""Readers and writers: right frames, right facts, one clear sentence for bad input."""

from __future__ import annotations

import errno
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import dask.array as da
import h5py
import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from helpers import measured
from napari_phase4d.io import read_results, step_of, write_phase, write_table
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.pipeline.starting import FrameSource
from napari_phase4d.recording import Recording

FRAMES = np.random.default_rng(0).integers(0, 4096, (5, 24, 32)).astype(np.uint16)


@pytest.mark.parametrize(
    "options", [{}, {"compression": "zlib"}, {"bigtiff": True}, {"byteorder": ">"}]
)
def test_plain_tiff(tmp_path: Path, options: dict) -> None:
    tifffile.imwrite(tmp_path / "video.tif", FRAMES, photometric="minisblack", **options)
    rec = p4d.open_recording(tmp_path / "video.tif")
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)
    assert rec.name == "video.tif"
    assert any("frame rate" in note for note in rec.notes)


def test_compressed_tiff_is_read_one_frame_at_a_time(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "video.tif", FRAMES, compression="zlib", photometric="minisblack")
    rec = p4d.open_recording(tmp_path / "video.tif")
    assert isinstance(rec.holograms.data, da.Array)
    assert rec.holograms.data.chunksize == (1, 24, 32)
    np.testing.assert_array_equal(rec.frame(3), FRAMES[3].astype(np.float32))


def test_frames_written_one_by_one_are_all_there(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 4000, (5, 20, 24)).astype(np.uint16)
    path = tmp_path / "single.tif"
    with tifffile.TiffWriter(path) as file:
        for frame in frames:
            file.write(frame, contiguous=False)
    found = p4d.open_recording(path)
    np.testing.assert_array_equal(found.holograms.values, frames)
    np.testing.assert_array_equal(found.raw_frame(3), frames[3])


def test_imagej_tiff_tells_pixel_and_frame_rate(tmp_path: Path) -> None:
    tifffile.imwrite(
        tmp_path / "ij.tif", FRAMES, imagej=True, resolution=(4, 4),
        metadata={"axes": "TYX", "unit": "um", "finterval": 0.125},
    )  # fmt: skip
    rec = p4d.open_recording(tmp_path / "ij.tif")
    assert rec.optics.pixel_um == pytest.approx(0.25)
    np.testing.assert_allclose(rec.times_s, np.arange(5) * 0.125)
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)


def test_ome_tiff_tells_pixel_and_frame_rate(tmp_path: Path) -> None:
    tifffile.imwrite(
        tmp_path / "a.ome.tif", FRAMES, ome=True, photometric="minisblack",
        metadata={
            "axes": "TYX", "PhysicalSizeX": 250.0, "PhysicalSizeXUnit": "nm",
            "TimeIncrement": 40.0, "TimeIncrementUnit": "ms",
        },
    )  # fmt: skip
    rec = p4d.open_recording(tmp_path / "a.ome.tif")
    assert rec.optics.pixel_um == pytest.approx(0.25)
    np.testing.assert_allclose(np.diff(rec.times_s), 0.04)
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)


def test_what_the_user_says_beats_the_file(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "ij.tif", FRAMES, imagej=True, metadata={"finterval": 0.125})
    optics = p4d.Optics(magnification=20)
    rec = p4d.open_recording(tmp_path / "ij.tif", optics, frame_rate_hz=10)
    assert rec.optics == optics
    assert rec.times_s[1] == pytest.approx(0.1)
    assert rec.notes == ()


def test_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    for i, n in enumerate((1, 2, 10, 11, 100)):
        iio.imwrite(tmp_path / f"frame{n}.png", FRAMES[i])
    (tmp_path / "notes.txt").write_text("not an image")
    rec = p4d.open_recording(tmp_path)
    np.testing.assert_array_equal(rec.holograms.values, FRAMES)


def test_folder_with_images_of_two_sizes(tmp_path: Path) -> None:
    iio.imwrite(tmp_path / "a1.png", FRAMES[0])
    iio.imwrite(tmp_path / "a2.png", FRAMES[1][:-2])
    rec = p4d.open_recording(tmp_path)
    with pytest.raises(ValueError, match=r"a2\.png is .* all images of a folder must be"):
        rec.frame(1)


@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_numpy_files(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"video.{kind}"
    if kind == "npy":
        np.save(path, FRAMES)
    else:
        np.savez(path, times=np.arange(5), mux=FRAMES)
    np.testing.assert_array_equal(p4d.open_recording(path).holograms.values, FRAMES)


def test_npz_dataset_is_chosen_by_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "two.npz", a=FRAMES, b=FRAMES + 1)
    rec = p4d.open_recording(tmp_path / "two.npz", dataset="b")
    np.testing.assert_array_equal(rec.holograms.values, FRAMES + 1)
    with pytest.raises(ValueError, match="no array 'c'; it has a, b"):
        p4d.open_recording(tmp_path / "two.npz", dataset="c")


@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_pickles_are_never_loaded(tmp_path: Path, kind: str) -> None:
    class Bomb:
        def __reduce__(self) -> tuple:
            return (os.mkdir, (str(tmp_path / "exploded"),))

    path = tmp_path / f"bomb.{kind}"
    hostile = np.array([Bomb()], dtype=object)
    if kind == "npy":
        np.save(path, hostile, allow_pickle=True)
    else:
        np.savez(path, data=hostile)
    with pytest.raises((OSError, ValueError), match="never loaded|no array"):
        p4d.open_recording(path)
    assert not (tmp_path / "exploded").exists()


def test_arrays_of_all_kinds() -> None:
    named = xr.DataArray(
        FRAMES.transpose(1, 2, 0), dims=("y", "x", "time"), coords={"time": np.arange(5) * 0.5}
    )
    for source in (FRAMES, da.from_array(FRAMES), named):
        np.testing.assert_array_equal(p4d.open_recording(source).holograms.values, FRAMES)
    assert p4d.open_recording(named).times_s[1] == 0.5
    assert p4d.open_recording(FRAMES[0]).n_frames == 1
    assert p4d.open_recording(FRAMES.tolist()).frame_shape == (24, 32)


@pytest.mark.slow
def test_napari_layer_gives_its_scale() -> None:
    layer = SimpleNamespace(
        data=FRAMES, name="film", axis_labels=("time", "y", "x"), rgb=False,
        scale=(0.25, 0.1, 0.1), units=("second", "micrometer", "micrometer"),
    )  # fmt: skip
    rec = p4d.open_recording(layer)
    assert rec.times_s[1] == 0.25
    assert rec.optics.pixel_um == pytest.approx(0.1)


@pytest.mark.slow
def test_dask_recording_is_not_computed_on_opening() -> None:
    def explode(block: np.ndarray) -> np.ndarray:
        raise AssertionError(block.shape)

    lazy = da.zeros((10**6, 1024, 1024), chunks=(1, 1024, 1024)).map_blocks(explode, dtype=float)
    rec = p4d.open_recording(lazy)
    assert rec.nbytes > 8e12
    assert rec.n_frames == 10**6


BAD_ARRAYS = {
    "colour": (np.zeros((4, 16, 16, 3)), "it looks like a colour image"),
    "four dimensions": (np.zeros((2, 2, 16, 16)), "a hologram video has three: time, y, x"),
    "one dimension": (np.zeros(16), "has 1 dimensions"),
    "empty": (np.zeros((0, 16, 16)), "is empty"),
    "complex": (np.zeros((2, 16, 16), complex), "needs real numbers"),
    "text": (np.full((2, 16, 16), "a"), "needs real numbers"),
    "tiny": (np.zeros((2, 4, 4)), "at least 8 x 8"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_bad_arrays_give_one_sentence(case: str) -> None:
    array, sentence = BAD_ARRAYS[case]
    with pytest.raises((TypeError, ValueError), match=sentence) as caught:
        p4d.open_recording(array)
    assert "\n" not in str(caught.value)


def test_nan_frame_is_named() -> None:
    frames = np.ones((3, 16, 16))
    frames[2, 0, 0] = np.nan
    with pytest.raises(ValueError, match="frame 2 of the array holds 1 NaN or infinite pixels"):
        p4d.open_recording(frames).frame(2)


def test_bad_frame_rate() -> None:
    with pytest.raises(ValueError, match="frame_rate_hz must be a number above 0"):
        p4d.open_recording(FRAMES, frame_rate_hz=0)


def damaged(tmp_path: Path, case: str) -> tuple[Path, str]:
    """Make a damaged file and return it with the sentence that it should give."""
    tif, npy, npz, png = (tmp_path / f"bad.{kind}" for kind in ("tif", "npy", "npz", "png"))
    if case == "truncated tiff":
        tifffile.imwrite(tif, FRAMES, photometric="minisblack")
        tif.write_bytes(tif.read_bytes()[:-1000])
        return tif, "bad.tif is cut short"
    if case == "no tiff":
        tif.write_bytes(b"hello world, this is no TIFF file")
        return tif, "can't be read as a TIFF"
    if case == "colour tiff":
        tifffile.imwrite(
            tif,
            (np.arange(2304) % 251).astype(np.uint8).reshape(3, 16, 16, 3),
            photometric="rgb",
        )
        return tif, "is in colour"
    if case == "truncated npy":
        np.save(npy, FRAMES)
        npy.write_bytes(npy.read_bytes()[:-1000])
        return npy, "can't be read as a NumPy file"
    if case == "truncated npz":
        np.savez(npz, FRAMES)
        npz.write_bytes(npz.read_bytes()[:500])
        return npz, "can't be read as a NumPy file"
    if case == "truncated png":
        iio.imwrite(png, FRAMES[0])
        png.write_bytes(png.read_bytes()[:100])
        return png, "can't be read as an image"
    if case == "colour png":
        iio.imwrite(png, np.random.default_rng(0).integers(0, 255, (16, 16, 3)).astype(np.uint8))
        return png, "is in colour"
    if case == "empty file":
        tif.write_bytes(b"")
        return tif, "is empty"
    if case == "unknown kind":
        (tmp_path / "bad.xyz").write_bytes(b"1234")
        return tmp_path / "bad.xyz", "of a kind that can't be read"
    if case == "empty folder":
        (tmp_path / "nothing").mkdir()
        return tmp_path / "nothing", "holds no images"
    return tmp_path / "missing.tif", "there is no file or folder"


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        "truncated tiff", "no tiff", "colour tiff", "truncated npy", "truncated npz",
        "truncated png", "colour png", "empty file", "unknown kind", "empty folder", "missing",
    ],
)  # fmt: skip
def test_bad_files_give_one_sentence(tmp_path: Path, case: str) -> None:
    path, sentence = damaged(tmp_path, case)
    with pytest.raises((OSError, ValueError), match=sentence) as caught:
        p4d.open_recording(path)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)


def stack() -> xr.DataArray:
    values = np.random.default_rng(1).normal(size=(3, 2, 8, 10)).astype(np.float32)
    return xr.DataArray(
        values, dims=("time", "angle", "y", "x"), name="temporal-angular",
        coords={"time": [0.0, 0.5, 1.5], "angle": [-7.0, 21.0], "y": np.arange(8) * 0.3,
                "x": np.arange(10) * 0.4},
        attrs={"units": "rad", "method": "temporal-angular", "boundary": [[0, 0]]},
    )  # fmt: skip


def test_results_come_back_equal(tmp_path: Path) -> None:
    original = stack()
    again = read_results(write_phase(tmp_path / "deep" / "phase.ome.tif", original))
    xr.testing.assert_identical(original, again)


def test_other_programs_find_pixel_size_and_axes(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "phase.ome.tif", stack())
    with tifffile.TiffFile(path) as tif:
        assert tif.series[0].axes == "TCYX"
        assert 'PhysicalSizeX="0.4"' in tif.ome_metadata
        assert 'PhysicalSizeY="0.3"' in tif.ome_metadata
        np.testing.assert_array_equal(tif.asarray(), stack().values)


def test_other_programs_find_positive_pixels_where_places_go_down(tmp_path: Path) -> None:
    """OME knows no other; the places themselves come back as they were."""
    down = stack().assign_coords(y=9 - np.arange(8) * 0.25, x=np.array([*range(9), 18]) * -0.25)
    path = write_phase(tmp_path / "phase.ome.tif", down)
    with tifffile.TiffFile(path) as tif:
        assert 'PhysicalSizeX="0.5"' in tif.ome_metadata
        assert 'PhysicalSizeY="0.25"' in tif.ome_metadata
    folder = write_phase(tmp_path / "phase.ome.zarr", down)
    note = json.loads((folder / "zarr.json").read_text())["attributes"]["ome"]
    scale, translation = note["multiscales"][0]["datasets"][0]["coordinateTransformations"]
    np.testing.assert_allclose(scale["scale"], [0.75, 1, 0.25, 0.5])
    np.testing.assert_allclose(translation["translation"], [0, 0, 7.25, -4.5])
    for written in (path, folder):
        xr.testing.assert_identical(read_results(written).compute(), down)


@pytest.mark.parametrize(
    ("places", "step"),
    [([9, 8.5, 8], 0.5), ([0, 1, 3], 1.5), ([4], 1.0), ([2, 2, 2], 1.0), ([-7, 21], 28.0)],
)
def test_step_of_places(places: list[float], step: float) -> None:
    assert step_of(np.array(places, dtype=np.float64)) == step


def test_other_tiffs_are_no_results(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "video.tif", FRAMES, photometric="minisblack")
    with pytest.raises(OSError, match="holds no phase written by napari-phase4d"):
        read_results(tmp_path / "video.tif")


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")
    with (
        pytest.raises(OSError, match=r"table\.csv could not be written"),
        written_whole(path) as temporary,
    ):
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


FULL_DISK = """
import resource, sys
import numpy as np, xarray as xr
from napari_phase4d.io import write_phase
stack = xr.DataArray(
    np.ones((2, 2, 64, 64), np.float32), dims=("time", "angle", "y", "x"),
    coords={d: np.arange(n) * 1.0 for d, n in zip(("time", "angle", "y", "x"), (2, 2, 64, 64))},
)
write_phase(sys.argv[1], stack * 2)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # no room for the 65 kB of pixels
try:
    write_phase(sys.argv[1], stack)
except OSError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows can't limit the size of files")
def test_result_that_does_not_fit_on_the_disk_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "phase.ome.tif"
    line = [sys.executable, "-c", FULL_DISK, str(path)]
    found = subprocess.run(line, capture_output=True, text=True, check=True)
    assert "phase.ome.tif could not be written" in found.stdout
    assert (read_results(path).values == 2).all()
    assert [p.name for p in tmp_path.iterdir()] == ["phase.ome.tif"]


def test_table_has_its_columns(tmp_path: Path) -> None:
    table = pd.DataFrame({"method": ["T/A"], "seconds": [1.5]}, index=["temporal-angular"])
    again = pd.read_csv(write_table(tmp_path / "t.csv", table), index_col=0)
    assert again.loc["temporal-angular", "seconds"] == 1.5


@pytest.mark.measured
def test_measured_files_open() -> None:
    rec = p4d.open_recording(measured("multiplexed/mux2_timelapse_t00-29.npz"))
    assert rec.holograms.shape == (30, 66, 66)
    red_cells = p4d.open_recording(measured("offaxis/pydhm_RBC.jpg"))
    assert red_cells.frame_shape == (1023, 1023)  # three equal channels are grey
    assert isinstance(red_cells, Recording)
    with pytest.raises(ValueError, match="has 4 dimensions"):
        p4d.open_recording(measured("multiplexed/profilometry_t00-29.tif"))


@pytest.mark.parametrize("separator", [".", "/"])
def test_what_a_killed_worker_left_does_not_count_as_a_frame(
    tmp_path: Path, separator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each file lay in a folder of its own in version 0.1.0."""
    keys = {"name": "default", "separator": separator}
    monkeypatch.setattr("napari_phase4d.io.zarr_results.FLAT", keys)
    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    chunk = path / "0" / separator.join("c1100")
    chunk.with_suffix(".0123456789abcdef.partial").write_bytes(b"half of it")
    chunk.with_name(f"._{chunk.name}").write_bytes(b"a note of a Mac on a network drive")
    assert read_results(path).equals(stack())
    chunk.unlink()
    with pytest.raises(OSError, match="is not complete"):
        read_results(path)


DATES = np.datetime64("2020-01-01", "s") + np.arange(3) * np.timedelta64(2, "s")


@pytest.mark.parametrize("name", ["phase.ome.tif", "phase.ome.zarr"])
@pytest.mark.parametrize(
    "times", [DATES, DATES.astype("datetime64[ns]"), (DATES - DATES[0]).astype("m8[ms]")]
)
def test_dates_and_durations_are_written_in_seconds(
    tmp_path: Path, name: str, times: np.ndarray
) -> None:
    dated = stack().isel(time=slice(3)).assign_coords(time=times)
    found = read_results(write_phase(tmp_path / name, dated))
    np.testing.assert_array_equal(found["time"].values, [0, 2, 4])
    assert found["time"].attrs["units"] == "s"


@pytest.mark.parametrize("name", ["phase.ome.tif", "phase.ome.zarr"])
def test_places_that_are_no_numbers_are_refused(tmp_path: Path, name: str) -> None:
    named = stack().isel(angle=[0]).assign_coords(angle=["left"])
    with pytest.raises(TypeError, match="the angle coordinates .* no numbers; give them in deg"):
        write_phase(tmp_path / name, named)


@pytest.mark.parametrize("kind", ["float16", "int64", "uint64"])
def test_numbers_that_a_tiff_has_no_name_for_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "phase.ome.tif"
    with pytest.raises(TypeError, match=f"can't hold numbers of {kind}; give them as float32"):
        write_phase(path, stack().astype(kind))
    assert not path.exists()
    assert (
        read_results(write_phase(tmp_path / "phase.ome.zarr", stack().astype(kind))).dtype == kind
    )
    assert read_results(write_phase(path, stack().astype(">f4"))).dtype == np.float32


def test_a_folder_that_holds_anything_else_is_not_replaced(tmp_path: Path) -> None:
    import zarr

    folder = tmp_path / "mine.zarr"
    folder.mkdir()
    write_phase(folder, stack())  # an empty one may be
    (folder / ".DS_Store").write_bytes(b"")
    write_phase(folder, stack())
    labels = zarr.open_group(folder, mode="a").create_array("labels/cells", shape=(3,), dtype="i4")
    labels[:] = 7
    other = tmp_path / "other.zarr"
    other.mkdir()
    (other / "notes.txt").write_text("mine", encoding="utf-8")
    theirs = tmp_path / "theirs.zarr"
    zarr.open_group(theirs, mode="w").create_array("0", shape=(2, 2), dtype="u1")[:] = 7
    for path, what in ((folder, "labels"), (other, "notes.txt"), (theirs, "0, zarr.json")):
        inside = sorted(p.relative_to(path) for p in path.rglob("*"))
        with pytest.raises(FileExistsError, match=f"holds {what}, which this program has not"):
            write_phase(path, stack())
        assert sorted(p.relative_to(path) for p in path.rglob("*")) == inside


@pytest.mark.parametrize("name", ["q.npy", "q.h5", "q.zarr.zip", "q", "q.nii.gz"])
def test_a_stack_is_not_written_under_the_ending_of_another_format(
    tmp_path: Path, name: str
) -> None:
    with pytest.raises(ValueError, match=r"must end with .ome.tif or .ome.zarr"):
        write_phase(tmp_path / name, stack())
    assert not list(tmp_path.iterdir())


# ---- opened anew --------------------------------------------------------------------------------


def test_workers_open_the_array_that_was_chosen(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["run1"], file["run2"] = (np.full((2, 16, 16), n, np.uint8) for n in (1, 2))
    np.full((2, 16, 16), 3, np.uint8).tofile(tmp_path / "a.raw")
    chosen = p4d.open_recording(tmp_path / "m.h5", dataset="run2").calibrated(frame_rate_hz=2)
    raw = p4d.open_recording(tmp_path / "a.raw", raw=p4d.RawLayout(16, 16, "uint8"))
    for recording in (chosen, raw):
        source = pickle.loads(pickle.dumps(FrameSource(p4d.Recipe(), recording)))
        assert (source.raw_frame(1) == recording.frame(1)).all()


def test_a_list_of_files_is_named_by_its_folder_only_if_that_opens_so(tmp_path: Path) -> None:
    files = [tmp_path / f"{number}.npy" for number in range(3)]
    for number, file in enumerate(files):
        np.save(file, np.full((2, 16, 16), number, np.uint8))
    assert p4d.open_recording(files).source == str(tmp_path)
    note = "A recipe can't name these files, as their folder holds others, or in another order."
    for some in (files[:2], files[::-1], [files[0], files[0], files[1]]):
        found = p4d.open_recording(some)
        assert found.source == ""
        assert note in found.notes
        source = pickle.loads(pickle.dumps(FrameSource(p4d.Recipe(), found)))
        assert (source.raw_frame(2) == found.frame(2)).all()
