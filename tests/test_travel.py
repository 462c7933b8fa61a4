"""Results that travel: OME-TIFF and OME-Zarr, as this and other programs read them."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.io import read_results, results, write_phase
from napari_phase4d.io.describing import SLAB_BYTES, slabs
from napari_phase4d.io.results import is_result, result_attrs
from napari_phase4d.machine import measured as measured_cost
from small_disks import small_disk
from stacks import assert_equal, contents

ENDINGS = [".ome.tif", ".ome.zarr"]
DIMS = ("time", "angle", "y", "x")
each_ending = pytest.mark.parametrize("ending", ENDINGS)


def stack(times: tuple[float, ...] = (0.0, 0.5, 1.5)) -> xr.DataArray:
    """Return a small stack with uneven times, places that begin elsewhere, and odd attributes."""
    values = np.random.default_rng(1).normal(size=(len(times), 2, 8, 10)).astype(np.float32)
    values[0, 1, 2, 3] = np.nan
    values[1, 1] = 0  # a frame of nothing but zeros, which Zarr would leave out
    coords = {
        "time": ("time", list(times), {"units": "s"}),
        "angle": ("angle", [-7.0, 21.25], {"units": "deg"}),
        "y": ("y", 1 + np.arange(8) * 0.3, {"units": "um"}),
        "x": ("x", np.arange(10) * 0.1 / 3, {"units": "um"}),
    }
    attrs = {
        "units": "rad", "method": "temporal-angular", "boundary": [[0, 0]], "share": float("nan"),
        "wide": [float("inf"), -float("inf")], "words": "5 µm, <b> & 'c'", "is": True,
        "no": None,
        "deep": {"options": {"registration": False, "size": 3}},
    }  # fmt: skip
    return xr.DataArray(values, dims=DIMS, name="temporal-angular", coords=coords, attrs=attrs)


@each_ending
@pytest.mark.parametrize("lazy", [False, True], ids=["numpy", "dask"])
def test_stacks_come_back_equal(tmp_path: Path, ending: str, lazy: bool) -> None:
    original = stack().chunk(time=2, y=3) if lazy else stack()
    path = write_phase(tmp_path / f"deep/phase{ending}", original.transpose("y", "x", ...))
    found = read_results(path)
    assert_equal(found, stack())
    assert is_result(path)
    assert json.dumps(result_attrs(path)) == json.dumps(stack().attrs)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@each_ending
def test_the_same_stack_gives_the_same_bytes(tmp_path: Path, ending: str) -> None:
    large = xr.DataArray(
        np.random.default_rng(0).normal(size=(6, 2, 300, 300)).astype(np.float32), dims=DIMS
    )
    first = contents(write_phase(tmp_path / f"one{ending}", large))
    assert contents(write_phase(tmp_path / f"two{ending}", large)) == first
    assert contents(write_phase(tmp_path / f"three{ending}", large.chunk(time=1))) == first
    other = contents(write_phase(tmp_path / f"four{ending}", large.assign_attrs(units="rad")))
    assert other.keys() == first.keys()
    assert other != first


@each_ending
def test_views_without_angles_are_numbered_as_on_screen(tmp_path: Path, ending: str) -> None:
    path = write_phase(tmp_path / f"phase{ending}", stack().assign_coords(angle=[0.0, 1.0]))
    written = b"".join(p.read_bytes() for p in [path, *path.rglob("*.json")] if p.is_file())
    assert b'"view 1"' in written
    assert b'"view 2"' in written
    assert b"view 0 deg" not in written
    assert read_results(path)["angle"].values.tolist() == [0, 1]


@pytest.mark.slow
def test_opened_by_tifffile_and_by_the_ome_model(tmp_path: Path) -> None:
    ome_types = pytest.importorskip("ome_types")
    path = write_phase(tmp_path / "phase.ome.tif", stack())
    with tifffile.TiffFile(path) as tif:
        assert tif.series[0].axes == "TCYX"
        assert not tif.is_bigtiff
        np.testing.assert_array_equal(tif.asarray(), stack().values)
        pixels = ome_types.from_xml(tif.ome_metadata).images[0].pixels
    assert (pixels.size_t, pixels.size_c, pixels.size_y, pixels.size_x) == (3, 2, 8, 10)
    assert pixels.physical_size_x == pytest.approx(0.1 / 3)
    assert pixels.physical_size_y == pytest.approx(0.3)
    assert pixels.physical_size_x_unit.value == "µm"
    assert (pixels.time_increment, pixels.time_increment_unit.value) == (0.75, "s")
    assert [c.name for c in pixels.channels] == ["view -7 deg", "view 21.25 deg"]
    # Uneven times stand at every plane.
    expected = {(t, c): time for t, time in enumerate((0.0, 0.5, 1.5)) for c in range(2)}
    assert {(p.the_t, p.the_c): p.delta_t for p in pixels.planes} == expected


def test_even_times_need_no_word_at_every_plane(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "phase.ome.tif", stack((0.0, 0.1, 0.2, 0.1 * 3)))
    with tifffile.TiffFile(path) as tif:
        assert 'TimeIncrement="0.1"' in tif.ome_metadata
        assert "DeltaT" not in tif.ome_metadata


def test_what_is_too_large_for_a_tiff_is_written_as_bigtiff(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert results.CLASSIC_BYTES < 2**32
    monkeypatch.setattr(results, "CLASSIC_BYTES", stack().nbytes - 1)
    path = write_phase(tmp_path / "phase.ome.tif", stack())
    with tifffile.TiffFile(path) as tif:
        assert tif.is_bigtiff
    assert_equal(read_results(path), stack())


@pytest.mark.slow
def test_opened_by_ome_zarr(tmp_path: Path) -> None:
    from ome_zarr.io import parse_url
    from ome_zarr.reader import Reader

    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    (node,) = Reader(parse_url(path))()
    np.testing.assert_array_equal(node.data[0].compute(), stack().values)
    assert node.data[0].chunksize == (1, 1, 8, 10)  # a slider reads what it shows
    scale, translation = node.metadata["coordinateTransformations"][0]
    np.testing.assert_allclose(scale["scale"], [0.75, 1, 0.3, 0.1 / 3])
    np.testing.assert_allclose(translation["translation"], [0, 0, 1, 0])
    assert node.metadata["channel_names"] == ["view -7 deg", "view 21.25 deg"]
    axes = [(a["name"], a["type"], a.get("unit")) for a in node.metadata["axes"]]
    assert axes == [
        ("t", "time", "second"), ("c", "channel", None),
        ("y", "space", "micrometer"), ("x", "space", "micrometer"),
    ]  # fmt: skip
    views = [stack().values[:, i] for i in range(2)]
    limits = [[np.nanmin(v), np.nanmax(v)] for v in views]
    np.testing.assert_allclose(node.metadata["contrast_limits"], limits)


def test_valid_by_the_models_of_ome_zarr(tmp_path: Path) -> None:
    import zarr

    models = pytest.importorskip("ome_zarr_models.v05")
    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    image = models.Image.from_zarr(zarr.open_group(path, mode="r"))
    assert image.attributes.ome.version == "0.5"
    assert len(image.attributes.ome.multiscales[0].datasets) == 1
    # What other programs read is JSON without NaN, whatever the attributes hold.
    json.loads((path / "zarr.json").read_text(), parse_constant=pytest.fail)


def random_frames(shape: tuple[int, ...]) -> xr.DataArray:
    """Return a lazy stack of noise, one time a chunk."""

    def frame(block_info: Any = None) -> np.ndarray:
        at = block_info[None]
        seed = at["chunk-location"][0]
        rng = np.random.default_rng(seed)
        return rng.random(at["chunk-shape"], dtype=np.float32)

    chunks = ((1,) * shape[0], *((n,) for n in shape[1:]))
    lazy = da.map_blocks(frame, chunks=chunks, dtype=np.float32, meta=np.empty((0,) * 4, "f4"))
    return xr.DataArray(lazy, dims=DIMS)


@pytest.mark.thorough
@each_ending
def test_lazy_stacks_are_written_in_bounded_memory(
    tmp_path: Path, ending: str, traced_memory: None
) -> None:
    lazy = random_frames((56, 1, 1024, 1024))
    assert lazy.nbytes == 14 * SLAB_BYTES
    cost = measured_cost(lambda: write_phase(tmp_path / f"large{ending}", lazy))
    # One part is written, and compressed, while the next one is computed and put together.
    assert cost.peak_mb * 2**20 < 6 * SLAB_BYTES
    found = read_results(cost.result)
    for time in (0, 31, 55):
        assert (found[time].values == lazy[time].values).all()


@pytest.mark.slow
def test_parts_follow_the_chunks_of_a_lazy_stack() -> None:
    frame = xr.DataArray(da.zeros((1, 1, 1024, 1024), dtype=np.float32), dims=DIMS)
    lengths = (3, 3, 3, 20, 1, 1)
    lazy = xr.concat([frame] * sum(lengths), "time").chunk(time=lengths)
    parts = [(part.start, part.stop) for part, _ in slabs(lazy)]
    assert parts == [(0, 3), (3, 6), (6, 9), (9, 29), (29, 31)]
    plain = [(part.start, part.stop) for part, _ in slabs(lazy.compute())]
    assert plain == [(start, min(start + 4, 31)) for start in range(0, 31, 4)]


def test_frames_of_a_zarr_stay_on_disk_until_they_are_used(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    found = read_results(path)
    assert isinstance(found.data, da.Array)
    assert found.data.chunksize == (1, 1, 8, 10)
    chunk = path / "0" / "c.2.1.0.0"
    whole = chunk.read_bytes()
    flipped = bytes([*whole[:99], whole[99] ^ 1, *whole[100:]])
    for damaged in (whole[:20], whole[: len(whole) // 2], whole[:-1], b"", flipped):
        chunk.write_bytes(damaged)
        again = read_results(path)
        np.testing.assert_array_equal(again[0].values, stack()[0].values)
        with pytest.raises(OSError, match=r"frames of phase\.ome\.zarr can't be read") as caught:
            again.load()
        assert "\n" not in str(caught.value)


def described_as(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change what an OME-Zarr notes of itself."""
    note = json.loads((path / "zarr.json").read_text())
    change(note["attributes"]["napari-phase4d"])
    (path / "zarr.json").write_text(json.dumps(note))


def absurd_shape(path: Path) -> None:
    array = path / "0" / "zarr.json"
    fields = json.loads(array.read_text())
    fields["shape"][0] = 10**15
    array.write_text(json.dumps(fields))


DAMAGES = {
    "a frame is missing": (
        lambda path: (path / "0" / "c.1.0.0.0").unlink(),
        "is not complete: it has 5 of 6",
    ),
    "no array": (lambda path: (path / "0" / "zarr.json").unlink(), "can't be read"),
    "cut array": (lambda path: (path / "0" / "zarr.json").write_text('{"zarr_'), "can't be read"),
    "cut note": (lambda path: (path / "zarr.json").write_text('{"attr'), "holds no phase"),
    "absurd shape": (absurd_shape, "is damaged: it has"),
    "fewer times": (
        lambda path: described_as(path, lambda note: note["coords"]["time"].pop()),
        "is damaged: it has",
    ),
    "no coordinates": (
        lambda path: described_as(path, lambda note: note.pop("coords")), "holds no phase",
    ),
    "words for numbers": (
        lambda path: described_as(path, lambda note: note["coords"].update(x=["one"] * 10)),
        "holds no phase",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGES)
def test_damaged_zarr_gives_one_sentence(tmp_path: Path, case: str) -> None:
    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    damage, sentence = DAMAGES[case]
    damage(path)
    with pytest.raises(OSError, match=sentence) as caught:
        read_results(path)
    assert "\n" not in str(caught.value)
    assert "phase.ome.zarr" in str(caught.value)


def test_a_result_that_was_replaced_has_other_keys(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "phase.ome.zarr", stack())
    before = read_results(path)
    write_phase(path, stack() + 1)
    after = read_results(path)
    # By keys, caches and clusters know what they have computed already.
    assert before.data.name != after.data.name
    np.testing.assert_array_equal(after.values, (stack() + 1).values)


@pytest.mark.parametrize("left", [0, 7, 100, -4000, -100])
def test_cut_tiff_gives_one_sentence(tmp_path: Path, left: int) -> None:
    path = write_phase(tmp_path / "phase.ome.tif", stack())
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(
        OSError, match=r"phase\.ome\.tif (is cut|can't be read|holds no)"
    ) as caught:
        read_results(path)
    assert "\n" not in str(caught.value)


def unreadable(values: np.ndarray, block_info: Any = None) -> np.ndarray:
    """Return a chunk of a lazy stack; the third time can't be read."""
    if block_info[None]["chunk-location"][0] == 2:
        msg = "frame 2 of video.tif can't be read"
        raise OSError(msg)
    return values


@each_ending
@pytest.mark.parametrize("fault", ["unreadable", "cancelled"])
def test_what_ends_half_way_leaves_the_old_result(
    tmp_path: Path, ending: str, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.io.describing.SLAB_BYTES", 1)  # one time after the other
    path = write_phase(tmp_path / f"phase{ending}", stack())
    before = contents(path)
    if fault == "unreadable":
        lazy = stack().chunk(time=1)
        broken = lazy.copy(
            data=da.map_blocks(unreadable, lazy.data, dtype="f4", meta=lazy.data._meta)
        )
        with pytest.raises(OSError, match="^frame 2 of video.tif can't be read$"):
            write_phase(path, broken)
    else:
        steps: list[int] = []
        with pytest.raises(p4d.Cancelled):
            write_phase(
                path, stack() + 1, lambda done, *_: steps.append(done), lambda: len(steps) == 2
            )
        assert steps == [1, 2]
    assert contents(path) == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@each_ending
def test_full_disk_leaves_the_old_result(tmp_path: Path, ending: str) -> None:
    large = xr.DataArray(np.random.default_rng(0).random((8, 2, 200, 200), "f4"), dims=DIMS)
    with small_disk(tmp_path / "disk") as disk:
        path = write_phase(disk / f"phase{ending}", stack())
        before = contents(path)
        with pytest.raises(OSError, match=r"could not be written \(No space left") as caught:
            write_phase(path, large)
        assert "\n" not in str(caught.value)
        assert caught.value.errno == errno.ENOSPC
        assert contents(path) == before
        assert [p.name for p in disk.iterdir()] == [path.name]


def test_other_folders_and_empty_stacks_are_no_results(tmp_path: Path) -> None:
    import zarr

    zarr.save_array(tmp_path / "other.zarr", np.zeros((2, 3)))
    for path in (tmp_path, tmp_path / "other.zarr", tmp_path / "missing.ome.zarr"):
        assert not is_result(path)
        with pytest.raises(
            OSError, match="holds no phase|can't be read|there is no file or folder"
        ):
            read_results(path)
    with pytest.raises(ValueError, match=r"the stack for none\.ome\.zarr is empty"):
        write_phase(tmp_path / "none.ome.zarr", stack()[:0])


# Where a result comes from
