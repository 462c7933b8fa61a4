"""Faults of files that were once read wrongly, each by the smallest file that shows it."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from format_writers import noise
from napari_phase4d.io import RawLayout, needs_layout, open_phase
from napari_phase4d.io.films import plane

FRAMES = noise(6, (24, 32), np.uint16)


def numbered(path: Path, n: int = 4) -> h5py.File:
    """Return an open HDF5 file with a dataset a frame."""
    file = h5py.File(path, "w")
    for i in range(n):
        file[f"video/{i}"] = FRAMES[i]
    return file


def spoil(file: h5py.File, folder: Path, way: str) -> None:
    """Put a third frame among numbered ones that may not be read."""
    del file["video/2"]
    shape, dtype = FRAMES.shape[1:], FRAMES.dtype
    if way == "other file":
        (folder / "secret.bin").write_bytes(FRAMES[0].tobytes())
        where = [("secret.bin", 0, FRAMES[0].nbytes)]
        file.create_dataset("video/2", shape, dtype, external=where)
    elif way == "itself":
        layout = h5py.VirtualLayout(shape, dtype)
        layout[:] = h5py.VirtualSource(".", "video/2", shape)
        file.create_virtual_dataset("video/2", layout)
    elif way == "a link out":
        with h5py.File(folder / "else.h5", "w") as other:
            other["frame"] = FRAMES[0]
        file["door"] = h5py.ExternalLink("else.h5", "/")
        layout = h5py.VirtualLayout(shape, dtype)
        layout[:] = h5py.VirtualSource(".", "door/frame", shape)
        file.create_virtual_dataset("video/2", layout)
    else:
        file.create_dataset("video/2", shape, dtype, chunks=shape)


@pytest.mark.parametrize(
    ("way", "sentence"),
    [
        ("other file", r"a\.h5 keeps '/video/2' in other files"),
        ("itself", r"a\.h5 needs '/?video/2' of a\.h5, which has no numbers of its own"),
        ("a link out", r"a\.h5 needs 'door/frame' of a\.h5, which has no numbers of its own"),
        ("nothing", r"a\.h5 says that '/video/2' is .* but holds nothing of it"),
    ],
)
def test_each_of_the_hdf5_frames_is_looked_at(tmp_path: Path, way: str, sentence: str) -> None:
    with numbered(tmp_path / "a.h5") as file:
        spoil(file, tmp_path, way)
    rec = p4d.open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(rec.raw_frame(3), FRAMES[3])
    with pytest.raises(OSError, match=f"^{sentence}"):
        rec.raw_frame(2)


def test_hdf5_frame_of_which_a_part_is_missing(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("frames", (2, 24, 32), "u2", chunks=(1, 12, 16))
        data[0] = FRAMES[0]
        data[1, :12] = FRAMES[1, :12]
    rec = p4d.open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(rec.raw_frame(0), FRAMES[0])
    with pytest.raises(OSError, match="frame 1 of a.h5 .*never written"):
        rec.raw_frame(1)


def test_hdf5_with_a_dataset_that_numpy_has_no_kind_for(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"] = FRAMES
        space = h5py.h5s.create_simple((4,))
        h5py.h5d.create(file.id, b"a_time", h5py.h5t.UNIX_D32LE, space)
    np.testing.assert_array_equal(p4d.open_recording(tmp_path / "a.h5").raw_frame(1), FRAMES[1])


def test_npz_that_is_called_npy(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", frames=FRAMES)
    (tmp_path / "a.npz").rename(tmp_path / "a.npy")
    with pytest.raises(OSError, match=r"^a\.npy can't be read as a NumPy file"):
        p4d.open_recording(tmp_path / "a.npy")


def koala_raw(path: Path, cut: int = 0) -> None:
    frames = FRAMES.astype(np.uint8)
    head = np.array([32, 24, 8, len(frames)], "<i4").tobytes()
    data = head + frames.tobytes()
    path.write_bytes(data[: len(data) - cut])


def test_koala_raw_alone(tmp_path: Path) -> None:
    folder = tmp_path / "Holograms"
    folder.mkdir()
    koala_raw(folder / "holo.raw")
    lines = [f"{i:05d} 12:00:00.0 2026.01.31 {250 * i}" for i in range(6)]
    (tmp_path / "timestamps.txt").write_text("\n".join(lines))
    rec = p4d.open_recording(folder / "holo.raw")
    np.testing.assert_allclose(rec.holograms["time"], np.arange(6) / 4)
    koala_raw(folder / "holo.raw", cut=5)
    with pytest.raises(OSError, match=r"holo\.raw is cut short"):
        p4d.open_recording(folder / "holo.raw")


def test_which_files_need_a_layout(tmp_path: Path) -> None:
    (tmp_path / "camera.raw").write_bytes(FRAMES.tobytes())
    koala_raw(tmp_path / "koala.raw")
    np.save(tmp_path / "a.npy", FRAMES)
    (tmp_path / "empty.raw").touch()
    needing = [p.name for p in sorted(tmp_path.iterdir()) if needs_layout(p)]
    assert needing == ["camera.raw"]
    assert not needs_layout(tmp_path / "missing.raw")


@pytest.mark.slow
def test_dataset_is_chosen_in_every_file_of_a_folder_and_list(tmp_path: Path) -> None:
    files = [tmp_path / f"part{i}.h5" for i in range(2)]
    for i, path in enumerate(files):
        with h5py.File(path, "w") as file:
            file["frames"] = FRAMES[:3] * 0
            file["second"] = FRAMES[3 * i : 3 * i + 3]
    for given in (tmp_path, files, tmp_path / "part*.h5"):
        rec = p4d.open_recording(given, dataset="second")
        np.testing.assert_array_equal(rec.holograms.values, FRAMES)
    lazy = pickle.loads(pickle.dumps(rec.holograms.data))
    np.testing.assert_array_equal(lazy[4].compute(), FRAMES[4])


def test_dataset_is_chosen_in_every_tiff(tmp_path: Path) -> None:
    for i in range(3):
        tifffile.imwrite(
            tmp_path / f"b{i}.ome.tif",
            np.stack([FRAMES[i : i + 2], FRAMES[i + 2 : i + 4]]),
            metadata={"axes": "TZYX"},
        )
    rec = p4d.open_recording(tmp_path / "b*.tif", dataset="Z=1")
    assert len(rec.holograms) == 6
    np.testing.assert_array_equal(rec.raw_frame(3), FRAMES[4])


def test_raw_layout_serves_every_file(tmp_path: Path) -> None:
    files = [tmp_path / f"part{i}.raw" for i in range(2)]
    for i, path in enumerate(files):
        path.write_bytes(FRAMES[3 * i : 3 * i + 3].tobytes())
    for given in (tmp_path, files, tmp_path / "*.raw"):
        rec = p4d.open_recording(given, raw=RawLayout(24, 32))
        np.testing.assert_array_equal(rec.holograms.values, FRAMES)


@pytest.mark.parametrize("name", ["a.npy", "a.png", "a.raw", "folder"])
def test_dataset_where_there_is_nothing_to_choose(tmp_path: Path, name: str) -> None:
    import imageio.v3 as iio

    raw = None
    if name == "a.npy":
        np.save(tmp_path / name, FRAMES)
    elif name == "a.raw":
        raw = RawLayout(24, 32)
        (tmp_path / name).write_bytes(FRAMES.tobytes())
    elif name == "a.png":
        iio.imwrite(tmp_path / name, FRAMES[0])
    else:
        (tmp_path / name).mkdir()
        iio.imwrite(tmp_path / name / "0.png", FRAMES[0])
        iio.imwrite(tmp_path / name / "1.png", FRAMES[1])
    with pytest.raises(ValueError, match=f"{name} has one array only; leave dataset out"):
        p4d.open_recording(tmp_path / name, dataset="Z=0", raw=raw)


def test_pixels_that_run_backwards_or_are_one(tmp_path: Path) -> None:
    def array(n: int, step: float) -> xr.DataArray:
        x = ("x", step * np.arange(n), {"units": "um"})
        return xr.DataArray(FRAMES[:, :, :n], dims=("time", "y", "x"), coords={"x": x})

    assert p4d.open_recording(array(32, -0.25)).optics.pixel_um == pytest.approx(0.25)
    with pytest.raises(ValueError, match="the array"):  # a strip is no frame, and says so
        p4d.open_recording(array(1, 0.25))


@pytest.mark.parametrize("way", ["in place", "another file"])
@pytest.mark.parametrize("kind", ["npy", "raw", "h5"])
def test_file_that_is_written_anew_and_larger(tmp_path: Path, kind: str, way: str) -> None:
    path = tmp_path / f"a.{kind}"
    others = np.concatenate([FRAMES[::-1], FRAMES])

    def write(to: Path, frames: np.ndarray) -> None:
        if kind == "npy":
            np.save(to, frames)
        elif kind == "raw":
            to.write_bytes(frames.tobytes())
        else:
            with h5py.File(to, "w") as file:
                file["frames"] = frames

    write(path, FRAMES)
    rec = p4d.open_recording(path, raw=RawLayout(24, 32) if kind == "raw" else None)
    if way == "in place" and kind == "h5":
        pytest.skip("HDF5 locks a file that it reads")
    if way == "in place":
        write(path, others)
    else:
        write(tmp_path / f"new.{kind}", others)
        (tmp_path / f"new.{kind}").replace(path)
    with pytest.raises(OSError, match="frame 2 of .* was written anew since it was opened"):
        rec.raw_frame(2)


def test_npy_that_grows_is_read_as_it_was(tmp_path: Path) -> None:
    """Its header changes, its frames don't."""
    path = tmp_path / "a.npy"
    np.save(path, FRAMES[:4])
    rec = p4d.open_recording(path)
    with path.open("r+b") as file:
        np.save(file, FRAMES)
    np.testing.assert_array_equal(rec.raw_frame(2), FRAMES[2])


def ome_zarr(path: Path, values: np.ndarray, axes: str) -> None:
    import zarr

    kinds = {"t": "time", "c": "channel"}
    told = [{"name": a, "type": kinds.get(a, "space")} for a in axes]
    told[axes.index("t")]["unit"] = "second"
    scale = [0.5 if a == "t" else 1.0 for a in axes]
    steps = [{"type": "scale", "scale": scale}]
    image = {"axes": told, "datasets": [{"path": "0", "coordinateTransformations": steps}]}
    root = zarr.open_group(str(path), mode="w")
    root.create_array("0", data=values, chunks=(*[1] * (values.ndim - 2), 24, 32))
    root.attrs["ome"] = {"version": "0.5", "multiscales": [image]}


def test_ome_zarr_with_channels(tmp_path: Path) -> None:
    values = np.stack([FRAMES, FRAMES[::-1] + 1], axis=1)  # t, c, y, x
    ome_zarr(tmp_path / "a.zarr", values, "tcyx")
    with pytest.raises(ValueError, match='choose one place, as with dataset="C=0"'):
        p4d.open_recording(tmp_path / "a.zarr")
    rec = p4d.open_recording(tmp_path / "a.zarr", dataset="C=1")
    np.testing.assert_array_equal(rec.holograms.values, values[:, 1])
    np.testing.assert_allclose(np.diff(rec.holograms["time"]), 0.5)
    unpickled = pickle.loads(pickle.dumps(rec.holograms.data))
    np.testing.assert_array_equal(unpickled[2].compute(), values[2, 1])
    with pytest.raises(ValueError, match="'C=2' is no place there"):
        p4d.open_recording(tmp_path / "a.zarr", dataset="C=2")


def test_depth_of_ome_zarr_has_no_interval(tmp_path: Path) -> None:
    ome_zarr(tmp_path / "a.zarr", FRAMES[None], "tzyx")
    rec = p4d.open_recording(tmp_path / "a.zarr")
    np.testing.assert_array_equal(rec.raw_frame(3), FRAMES[3])
    np.testing.assert_allclose(np.diff(rec.holograms["time"]), 1)
    assert any("axis Z is taken for time" in note for note in rec.notes)


def test_a_black_frame_that_zarr_left_out_is_black(tmp_path: Path) -> None:
    import zarr

    frames = np.random.default_rng(0).integers(1, 200, (6, 16, 20)).astype(np.uint8)
    frames[2] = 0
    array = zarr.create_array(
        tmp_path / "v.zarr", shape=frames.shape, chunks=(1, 16, 20), dtype="u1"
    )
    array[:] = frames
    rec = p4d.open_recording(tmp_path / "v.zarr")
    np.testing.assert_array_equal(rec.raw_frame(2), frames[2])
    (tmp_path / "v.zarr" / "c" / "5" / "0" / "0").unlink()
    with pytest.raises(OSError, match=r"frame 5 of v\.zarr"):
        rec.raw_frame(5)


@pytest.mark.parametrize("shape", [(5, 1, 32, 32), (1, 5, 32, 32), (5, 1, 1, 32, 32)])
def test_frames_of_axes_without_names_are_all_there(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    """Of a NumPy array that tifffile wrote, all axes but the last two have the same name."""
    stack = np.random.default_rng(4).integers(0, 200, shape).astype(np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    rec = p4d.open_recording(tmp_path / "a.tif")
    assert (rec.holograms.values == stack.reshape(5, 32, 32)).all()


def test_places_on_axes_of_one_name_are_taken_in_their_order(tmp_path: Path) -> None:
    stack = np.random.default_rng(4).integers(0, 200, (5, 2, 32, 32)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    rec = p4d.open_recording(tmp_path / "a.tif", dataset="Q=4,Q=1")
    assert (rec.holograms.values == stack[4, 1]).all()
    rec = p4d.open_recording(tmp_path / "a.tif", dataset="Q=3")
    assert (rec.holograms.values == stack[3]).all()


def imagej_file(folder: Path, **metadata: object) -> Path:
    tifffile.imwrite(
        folder / "a.tif", FRAMES, imagej=True, metadata={"axes": "TYX", **metadata}
    )  # fmt: skip
    return folder / "a.tif"


@pytest.mark.parametrize(
    ("unit", "step"), [("ms", 0.02), ("sec", 20), ("min", 1200), ("Sec", 20), ("", 20)]
)
def test_the_interval_of_imagej_has_a_unit(tmp_path: Path, unit: str, step: float) -> None:
    rec = p4d.open_recording(
        imagej_file(tmp_path, finterval=20, **({"tunit": unit} if unit else {}))
    )
    np.testing.assert_allclose(np.diff(rec.times_s), step)


@pytest.mark.parametrize(("unit", "step"), [("msec", 0.02), ("hr", 72000), (r"\u00B5s", 2e-5)])
def test_units_as_users_of_imagej_write_them(tmp_path: Path, unit: str, step: float) -> None:
    rec = p4d.open_recording(imagej_file(tmp_path, finterval=20, tunit=unit))
    np.testing.assert_allclose(np.diff(rec.times_s), step)


def test_an_interval_in_an_unknown_unit_is_not_used(tmp_path: Path) -> None:
    rec = p4d.open_recording(imagej_file(tmp_path, finterval=20, tunit="pixel"))
    np.testing.assert_allclose(np.diff(rec.times_s), 1)
    assert "The frame interval of 20 pixel is in no unit of time, and is not used." in rec.notes
    assert any("1 frame a second is assumed" in note for note in rec.notes)


def test_the_speed_at_which_imagej_plays_is_noted(tmp_path: Path) -> None:
    rec = p4d.open_recording(imagej_file(tmp_path, fps=7))
    np.testing.assert_allclose(np.diff(rec.times_s), 1 / 7)
    assert any("7 frames a second are those at which ImageJ plays" in n for n in rec.notes)


def ome_with_times(folder: Path, times: list[float], axes: str, **facts: object) -> Path:
    """Write an OME-TIFF whose planes note their times; 'TCYX' has two channels."""
    n_channels = axes.count("C") + 1
    frames = np.stack([FRAMES + c for c in range(n_channels)], axis=1)
    tifffile.imwrite(
        folder / "a.ome.tif", frames[:, 0] if n_channels == 1 else frames, ome=True,
        photometric="minisblack", metadata={"axes": axes, "Plane": {"DeltaT": times}, **facts},
    )  # fmt: skip
    return folder / "a.ome.tif"


def test_measured_times_beat_a_nominal_interval(tmp_path: Path) -> None:
    times = [0.0, 0.5, 1.0, 1.6, 2.1, 2.6]
    path = ome_with_times(tmp_path, times, "TYX", TimeIncrement=0.5)
    rec = p4d.open_recording(path)
    np.testing.assert_allclose(rec.times_s, times)
    assert any("up to 0.1 s off the file's frame interval of 0.5 s" in n for n in rec.notes)


def test_times_that_jitter_a_little_are_even(tmp_path: Path) -> None:
    times = [0.0, 0.51, 1.0, 1.49, 2.01, 2.5]
    rec = p4d.open_recording(ome_with_times(tmp_path, times, "TYX", TimeIncrement=0.5))
    np.testing.assert_allclose(rec.times_s, 0.5 * np.arange(6))
    assert not any("frame interval" in note for note in rec.notes)


def test_times_are_those_of_the_chosen_channel(tmp_path: Path) -> None:
    """A channel in turn with another one begins later, and its pauses are its own."""
    own = np.array([0.2, 0.7, 1.2, 1.9, 2.2, 2.7])
    times = np.stack([0.5 * np.arange(6), own], axis=1).ravel().tolist()
    path = ome_with_times(tmp_path, times, "TCYX")
    rec = p4d.open_recording(path, dataset="C=1")
    np.testing.assert_allclose(rec.times_s, own - own[0])
    np.testing.assert_allclose(p4d.open_recording(path, dataset="C=0").times_s, 0.5 * np.arange(6))


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("axis", ["C", "Z"])
def test_an_axis_that_is_not_time_is_said_to_be_taken_for_it(
    tmp_path: Path, axis: str, many: bool
) -> None:
    for name in ("a", "b")[: 1 + many]:
        tifffile.imwrite(
            tmp_path / f"{name}.ome.tif", FRAMES, ome=True, photometric="minisblack",
            metadata={"axes": f"{axis}YX", "TimeIncrement": 0.5},
        )  # fmt: skip
    rec = p4d.open_recording(tmp_path if many else tmp_path / "a.ome.tif")
    assert rec.n_frames == len(FRAMES) * (1 + many)
    assert f"The axis {axis} is taken for time." in rec.notes
    np.testing.assert_allclose(np.diff(rec.times_s), 1)
    # Who gives a rate has said that it is time.
    rec = p4d.open_recording(tmp_path / "a.ome.tif", frame_rate_hz=2)
    assert not any("taken for time" in note for note in rec.notes)


@pytest.mark.parametrize("axis", ["Z", "C"])
def test_slices_and_channels_of_imagej_keep_their_interval(tmp_path: Path, axis: str) -> None:
    rec = p4d.open_recording(imagej_file(tmp_path, axes=f"{axis}YX", finterval=0.5))
    assert f"The axis {axis} is taken for time." in rec.notes
    np.testing.assert_allclose(np.diff(rec.times_s), 0.5)


def test_axes_without_a_name_are_time(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", FRAMES, photometric="minisblack")
    assert not any("taken for" in n for n in p4d.open_recording(tmp_path / "a.tif").notes)


PHASE = np.random.default_rng(5).uniform(-3, 3, (5, 2, 24, 32)).astype(np.float32)


def phase_file(path: Path, values: np.ndarray, axes: str) -> Path:
    tifffile.imwrite(path, values, ome=True, photometric="minisblack", metadata={"axes": axes})
    return path


@pytest.mark.parametrize(("axes", "order"), [("TCYX", (0, 1)), ("CTYX", (1, 0)), ("ZTYX", (1, 0))])
def test_axes_of_phase_are_taken_by_their_names(
    tmp_path: Path, axes: str, order: tuple[int, int]
) -> None:
    values = PHASE.transpose(*order, 2, 3)
    found = open_phase(phase_file(tmp_path / "a.ome.tif", values, axes))
    np.testing.assert_array_equal(found.values, PHASE)
    taken = [n for n in found.attrs["notes"] if "taken for" in n]
    assert taken == (["The axis Z is taken for views."] if "Z" in axes else [])


def test_phase_on_a_single_further_axis(tmp_path: Path) -> None:
    found = open_phase(phase_file(tmp_path / "c.ome.tif", PHASE[0], "CYX"))
    np.testing.assert_array_equal(found.values, PHASE[:1])
    assert "The axis C is taken for views." in found.attrs["notes"]
    found = open_phase(phase_file(tmp_path / "z.ome.tif", PHASE[:, 0], "ZYX"))
    np.testing.assert_array_equal(found.values, PHASE[:, :1])
    assert "The axis Z is taken for time." in found.attrs["notes"]


def test_phase_that_a_script_writes_for_imagej_goes_by_the_place_of_its_axes(
    tmp_path: Path,
) -> None:
    """Where no axes are given, tifffile calls them channels, or slices and channels."""
    for name, values, note in (
        ("a.tif", PHASE[:, 0], "The axis C is taken for time."),
        ("b.tif", PHASE, "The axes Z and C are taken for time and views."),
    ):
        tifffile.imwrite(tmp_path / name, values, imagej=True)
        found = open_phase(tmp_path / name)
        np.testing.assert_array_equal(found.values.reshape(values.shape), values)
        assert found.sizes["time"] == len(PHASE)
        assert note in found.attrs["notes"]


def test_phase_of_which_no_axis_is_time_is_asked_about(tmp_path: Path) -> None:
    path = phase_file(tmp_path / "a.ome.tif", PHASE, "ZCYX")
    with pytest.raises(ValueError, match='Z=5, C=2.* none of which is time.*dataset="Z=0"'):
        open_phase(path)
    np.testing.assert_array_equal(open_phase(path, "Z=1").values, PHASE[1:2])


def test_phase_keeps_what_the_reader_found(tmp_path: Path) -> None:
    tifffile.imwrite(
        tmp_path / "a.tif", PHASE[:, 0], imagej=True,
        metadata={"axes": "TYX", "finterval": 0.5},
    )  # fmt: skip
    found = open_phase(tmp_path / "a.tif")
    np.testing.assert_allclose(found["time"], 0.5 * np.arange(5))
    assert found.attrs["notes"] == ["Not in the file, so counted in ones: pixel, viewing angles."]
    assert open_phase(tmp_path / "a.tif", frame_rate_hz=4)["time"][1] == 0.25
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["phase"], file["other"] = PHASE[:, 0], PHASE[:, 1]
    notes = open_phase(tmp_path / "a.h5").attrs["notes"]
    assert any("Of several arrays" in note for note in notes)


def test_a_lost_page_of_phase_is_unknown(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for i in range(12):
            frame = np.zeros((8, 8), np.uint8) if i == 4 else PHASE[i % 5, i % 2]
            file.write(frame, contiguous=False, photometric="minisblack")
    found = open_phase(tmp_path / "a.tif")
    unknown = np.isnan(found.values).all(axis=(1, 2, 3))
    assert np.flatnonzero(unknown).tolist() == [4]
    np.testing.assert_array_equal(found.values[5, 0], PHASE[0, 1])
    assert any("taken for a frame that is lost" in note for note in found.attrs["notes"])


def imagej_pixel(path: Path) -> None:
    tifffile.imwrite(
        path, FRAMES, imagej=True, resolution=(10, 5), metadata={"axes": "TYX", "unit": "um"}
    )  # fmt: skip


def ome_pixel(path: Path) -> None:
    facts = {"PhysicalSizeX": 100.0, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": 0.2}
    tifffile.imwrite(path, FRAMES, ome=True, metadata={"axes": "TYX", **facts})


def fiji_pixel(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["frames"] = FRAMES
        file["frames"].attrs["element_size_um"] = [1.0, 0.2, 0.1]


def hyperspy_pixel(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["a/data"] = FRAMES
        for i, scale in enumerate((1.0, 0.2, 0.1)):
            file.create_group(f"a/axis-{i}").attrs.update(scale=scale, units="um")


def zarr_pixel(path: Path) -> None:
    import zarr

    axes = [{"name": a, "type": "space", "unit": "micrometer"} for a in "yx"]
    told = [{"name": "t", "type": "time"}, *axes]
    steps = [{"type": "scale", "scale": [1.0, 0.2, 0.1]}]
    image = {"axes": told, "datasets": [{"path": "0", "coordinateTransformations": steps}]}
    root = zarr.open_group(str(path), mode="w")
    root.create_array("0", data=FRAMES, chunks=(1, 24, 32))
    root.attrs["ome"] = {"version": "0.5", "multiscales": [image]}


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.tif", imagej_pixel), ("a.ome.tif", ome_pixel), ("a.h5", fiji_pixel),
        ("b.h5", hyperspy_pixel), ("a.zarr", zarr_pixel),
    ],
)  # fmt: skip
def test_pixels_of_a_file_that_are_not_square_are_noted(
    tmp_path: Path, name: str, write: Callable
) -> None:
    write(tmp_path / name)
    sentence = "Pixels are 0.2 um high and 0.1 um wide according to the file"
    rec = p4d.open_recording(tmp_path / name)
    assert any(sentence in note for note in rec.notes)
    assert rec.optics.pixel_um == pytest.approx(0.1)
    optics = p4d.Optics(magnification=20)
    rec = p4d.open_recording(tmp_path / name, optics)
    assert rec.optics == optics
    assert not any(sentence in note for note in rec.notes)


def test_the_height_of_other_pixels_does_not_count(tmp_path: Path) -> None:
    fiji_pixel(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["element_size_um"] = [1.0, 0.2, 0.1]
        del file["frames"].attrs["element_size_um"]
        file["frames"].attrs["pixel_um"] = 0.3
    assert p4d.open_recording(tmp_path / "a.h5").optics.pixel_um == pytest.approx(0.3)


def test_phase_may_have_pixels_that_are_not_square(tmp_path: Path) -> None:
    tifffile.imwrite(
        tmp_path / "a.tif", PHASE[:, 0], imagej=True, resolution=(10, 5),
        metadata={"axes": "TYX", "unit": "um"},
    )  # fmt: skip
    found = open_phase(tmp_path / "a.tif")
    assert [float(found[a][1]) for a in "yx"] == pytest.approx([0.2, 0.1])
    assert [float(open_phase(tmp_path / "a.tif", pixel_um=0.5)[a][1]) for a in "yx"] == [0.5, 0.5]


@pytest.mark.parametrize("begins_with_the_last_line", [False, True])
def test_lines_from_the_bottom_up_are_turned_or_refused(begins_with_the_last_line: bool) -> None:
    """Older PyAV gives what lies behind the upper line, which is the last one in memory."""

    class Plane(bytearray):
        line_size, height, buffer_ptr = -32, 24, 0

    part = Plane(FRAMES[0, ::-1].astype(np.uint8).tobytes())
    start = np.frombuffer(part, np.uint8).ctypes.data
    part.buffer_ptr = start if begins_with_the_last_line else start + 23 * 32
    picture = SimpleNamespace(planes=[part])
    if begins_with_the_last_line:
        with pytest.raises(ValueError, match="stored from the bottom up; .* --upgrade"):
            plane(picture, 0, 30)
    else:
        np.testing.assert_array_equal(plane(picture, 0, 30), FRAMES[0, :, :30].astype(np.uint8))
