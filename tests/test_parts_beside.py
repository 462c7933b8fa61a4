"""Recordings in several files: all of them count for what was read, none lies elsewhere."""

from __future__ import annotations

import gzip
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
import zarr
from zarr.codecs import Crc32cCodec, GzipCodec, ZstdCodec

import napari_phase4d as p4d
from batches import RECIPE, statuses, write_phases
from napari_phase4d.pipeline import fingerprint
from napari_phase4d.task import Cluster

FRAMES = np.random.default_rng(2).integers(1, 200, (4, 32, 32)).astype(np.uint8)
OME = (
    '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
    'UUID="urn:uuid:{own}"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYCZT" '
    'Type="uint8" SizeX="32" SizeY="32" SizeC="1" SizeZ="1" SizeT="4">'
    '<Channel ID="Channel:0:0" SamplesPerPixel="1"/>{parts}</Pixels></Image></OME>'
)
PART = (
    '<TiffData IFD="0" FirstT="{first}" PlaneCount="2">'
    '<UUID FileName="{name}">urn:uuid:{number}</UUID></TiffData>'
)
ONE, TWO = "00000000-0000-0000-0000-000000000001", "00000000-0000-0000-0000-000000000002"


def ome_series(folder: Path, second: str = "two.ome.tif") -> Path:
    """Write a recording of two OME-TIFF files; the second one under some name."""
    parts = PART.format(first=0, name="one.ome.tif", number=ONE)
    parts += PART.format(first=2, name=second, number=TWO)
    for name, own, frames in (("one.ome.tif", ONE, FRAMES[:2]), (second, TWO, FRAMES[2:])):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = OME.format(own=own, parts=parts)
        tifffile.imwrite(path, frames, description=text, metadata=None, ome=False)
    return folder / "one.ome.tif"


def virtual(folder: Path) -> Path:
    """Write an HDF5 file that shows frames of another one."""
    with h5py.File(folder / "source.h5", "w") as file:
        file["frames"] = FRAMES
    layout = h5py.VirtualLayout(FRAMES.shape, "u1")
    layout[:] = h5py.VirtualSource("source.h5", "frames", FRAMES.shape)
    with h5py.File(folder / "shown.h5", "w") as file:
        file.create_virtual_dataset("holograms", layout)
    return folder / "shown.h5"


def koala(folder: Path) -> Path:
    """Write a raw file of Koala with its times."""
    head = np.array([32, 32, 8, len(FRAMES)], "<i4").tobytes()
    (folder / "holo.raw").write_bytes(head + FRAMES.tobytes())
    lines = [f"{i} 10:00:00 2026-01-01 {100 * i}" for i in range(len(FRAMES))]
    (folder / "timestamps.txt").write_text("\n".join(lines))
    return folder / "holo.raw"


def linked(folder: Path) -> Path:
    """Write a file that is a link to another one."""
    np.save(folder / "real.npy", FRAMES)
    (folder / "link.npy").symlink_to("real.npy")
    return folder / "link.npy"


def folder_of_links(folder: Path) -> Path:
    """Write a folder whose pictures lie behind a link."""
    (folder / "pictures").mkdir()
    for i, frame in enumerate(FRAMES):
        tifffile.imwrite(folder / "pictures" / f"{i}_holo.tif", frame)
    (folder / "recording").mkdir()
    (folder / "recording" / "Holograms").symlink_to(folder / "pictures")
    return folder / "recording"


def change_frames(path: Path) -> None:
    """Change the last byte of a file."""
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def change_h5(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["frames"][3, 5, 5] += 1


#: How it is written, the file that is read beside, and what changes that.
SIDE_FILES: dict[str, tuple[Callable[[Path], Path], str, Callable[[Path], None]]] = {
    "OME-TIFF in two files": (ome_series, "two.ome.tif", change_frames),
    "virtual HDF5 dataset": (virtual, "source.h5", change_h5),
    "times of Koala": (koala, "timestamps.txt", change_frames),
    "a link": (linked, "real.npy", change_frames),
    "a folder behind a link": (folder_of_links, "pictures/3_holo.tif", change_frames),
}


@pytest.mark.parametrize("kind", SIDE_FILES)
def test_all_that_is_read_counts(kind: str, tmp_path: Path) -> None:
    write, beside, change = SIDE_FILES[kind]
    path = write(tmp_path)
    assert p4d.open_recording(path).n_frames == len(FRAMES)
    before = fingerprint(path)
    assert fingerprint(path) == before
    change(tmp_path / beside)
    after = fingerprint(path)
    assert after.sha256 != before.sha256
    assert after.bytes == before.bytes


@pytest.mark.slow
def test_a_batch_runs_again_what_has_changed_beside(tmp_path: Path) -> None:
    """Wrapped phase whose numbers lie in another file, which a virtual dataset shows."""
    phase = np.load(write_phases(tmp_path) / "a.npy")[:, 0]
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file["frames"] = phase
    layout = h5py.VirtualLayout(phase.shape, phase.dtype)
    layout[:] = h5py.VirtualSource("source.h5", "frames", phase.shape)
    with h5py.File(tmp_path / "shown.h5", "w") as file:
        file.create_virtual_dataset("phase", layout)

    recipe = RECIPE.changed(content="phase")

    def run() -> list[str]:
        return statuses(tmp_path / "out", tmp_path / "shown.h5", recipe=recipe)

    assert run() == ["done"]
    assert run() == ["complete already"]
    with h5py.File(tmp_path / "source.h5", "r+") as file:
        place = (0,) * phase.ndim
        file["frames"][place] = phase[place] + np.float32(0.01)
    assert run() == ["done"]


@pytest.mark.parametrize("way", ["folder", "pattern", "list", "beside others", "master last"])
def test_the_frames_of_an_ome_series_are_read_once(way: str, tmp_path: Path) -> None:
    ome_series(tmp_path)
    expected, given = FRAMES, {"pattern": tmp_path / "*.tif"}.get(way, tmp_path)
    if way == "list":
        given = [tmp_path / "one.ome.tif", tmp_path / "two.ome.tif"]
    elif way == "beside others":
        tifffile.imwrite(tmp_path / "three.tif", FRAMES[::-1], photometric="minisblack")
        given = [tmp_path / f"{name}.tif" for name in ("one.ome", "two.ome", "three")]
        expected = np.concatenate([FRAMES, FRAMES[::-1]])
    elif way == "master last":
        pointer = f'<BinaryOnly MetadataFile="two.ome.tif" UUID="urn:uuid:{TWO}"/></OME>'
        text = OME.format(own=ONE, parts="").split("<Image")[0] + pointer
        name = tmp_path / "one.ome.tif"
        tifffile.imwrite(name, FRAMES[:2], description=text, metadata=None, ome=False)
    rec = p4d.open_recording(given)
    np.testing.assert_array_equal(rec.holograms.values, expected)


def test_a_renamed_file_needs_no_other(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "before.ome.tif", FRAMES, metadata={"axes": "TYX"}, ome=True)
    before = fingerprint(tmp_path / "before.ome.tif")
    path = (tmp_path / "before.ome.tif").rename(tmp_path / "after.ome.tif")
    np.testing.assert_array_equal(p4d.open_recording(path).frame(3), FRAMES[3])
    assert fingerprint(path).sha256 == before.sha256


@pytest.mark.parametrize("way", ["above", "absolute", "link"])
def test_an_ome_series_stays_in_its_folder(way: str, tmp_path: Path) -> None:
    own = tmp_path / "own"
    if way == "link":
        path = ome_series(own)
        (own / "two.ome.tif").rename(tmp_path / "two.ome.tif")
        (own / "two.ome.tif").symlink_to(tmp_path / "two.ome.tif")
    else:
        path = ome_series(own, "../two.ome.tif" if way == "above" else str(tmp_path / "2.tif"))
    with pytest.raises(OSError, match="is in another folder and not followed; copy it"):
        p4d.open_recording(path)


@pytest.mark.parametrize("what", ["c/1/0/0", "zarr.json"])
def test_a_zarr_store_stays_in_its_folder(what: str, tmp_path: Path) -> None:
    store = tmp_path / "own.zarr"
    zarr.create_array(str(store), data=FRAMES, chunks=(1, 32, 32))
    (store / what).rename(tmp_path / "secret")
    (store / what).symlink_to(tmp_path / "secret")
    with pytest.raises(OSError, match="as a link to elsewhere; copy the file there"):
        p4d.open_recording(store).raw_frame(1)


@pytest.mark.parametrize("listing", ["concat", "hls"])
def test_a_list_of_films_is_none(listing: str, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "secret.avi"), "w") as container:
        stream = container.add_stream("rawvideo", rate=5, width=32, height=32, pix_fmt="gray")
        for frame in FRAMES:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="gray")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    assert p4d.open_recording(tmp_path / "secret.avi").n_frames == len(FRAMES)
    text = "ffconcat version 1.0\nfile secret.avi\n"
    if listing == "hls":
        text = "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nsecret.avi\n#EXT-X-ENDLIST\n"
    (tmp_path / "list.mp4").write_text(text)
    with pytest.raises(OSError, match=r"list\.mp4 can't be read as a film"):
        p4d.open_recording(tmp_path / "list.mp4")


CODECS = {
    "zstd": {"id": "zstd", "level": 1},
    "gzip": {"id": "gzip", "level": 9},
    "zlib": {"id": "zlib", "level": 9},
    "bz2": {"id": "bz2", "level": 9},
    "lzma": {"id": "lzma"},
    "blosc": {"id": "blosc", "cname": "zstd", "clevel": 9, "shuffle": 0, "blocksize": 0},
    "lz4": {"id": "lz4", "acceleration": 1},
}


@pytest.mark.parametrize("codec", CODECS)
def test_a_piece_that_unpacks_to_far_more_is_not_unpacked(
    codec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numcodecs = pytest.importorskip("numcodecs")
    packing = numcodecs.get_codec(CODECS[codec])
    store = tmp_path / "bomb.zarr"
    array = zarr.create_array(
        str(store), shape=FRAMES.shape, dtype="u1", chunks=(1, 32, 32), compressors=packing,
        filters=None, zarr_format=2,
    )  # fmt: skip
    array[:] = FRAMES
    np.testing.assert_array_equal(p4d.open_recording(store).raw_frame(1), FRAMES[1])
    bomb = packing.encode(np.zeros(3 * 2**20, np.uint8))
    (store / "1.0.0").write_bytes(bomb)
    monkeypatch.setattr("napari_phase4d.io.zarr_packing.HARMLESS", 2**20)
    unpacked: list[int] = []
    once = type(packing).decode

    def decode(self: object, buf: bytes, out: object = None) -> object:
        unpacked.append(len(buf))
        return once(self, buf, out)

    monkeypatch.setattr(type(packing), "decode", decode)
    with pytest.raises(OSError, match=r"piece 1\.0\.0 would unpack to more than 1024 bytes"):
        p4d.open_recording(store).raw_frame(1)
    assert not unpacked


BOMB = gzip.compress(bytes(3 * 2**20), 9)


@pytest.mark.parametrize("codecs", [(GzipCodec(), GzipCodec()), (ZstdCodec(), GzipCodec())])
def test_pieces_that_are_packed_twice_are_not_unpacked(codecs: tuple, tmp_path: Path) -> None:
    """A kilobyte may hold a megabyte that holds a gigabyte."""
    zarr.create_array(str(tmp_path / "a.zarr"), data=FRAMES, compressors=codecs)
    with pytest.raises(OSError, match="packs its pieces more than once .* save it packed once"):
        p4d.open_recording(tmp_path / "a.zarr")


def test_nor_by_a_filter(tmp_path: Path) -> None:
    numcodecs = pytest.importorskip("numcodecs")
    array = zarr.create_array(
        str(tmp_path / "a.zarr"), shape=FRAMES.shape, dtype="u1", chunks=(1, 32, 32),
        compressors=numcodecs.GZip(), filters=[numcodecs.Zlib()], zarr_format=2,
    )  # fmt: skip
    array[:] = FRAMES
    with pytest.raises(OSError, match="packs its pieces more than once"):
        p4d.open_recording(tmp_path / "a.zarr")


@pytest.mark.parametrize("kind", ["with a checksum", "in a shard", "zipped"])
def test_wherever_a_piece_lies_it_is_not_unpacked_to_far_more(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.io.zarr_packing.HARMLESS", 2**20)
    store, in_shard = tmp_path / "bomb.zarr", kind == "in a shard"
    more = [Crc32cCodec()] if kind == "with a checksum" else []
    zarr.create_array(
        str(store), data=FRAMES, chunks=(1, 32, 32), compressors=[GzipCodec(), *more],
        shards=(4, 32, 32) if in_shard else None,
    )  # fmt: skip
    np.testing.assert_array_equal(p4d.open_recording(store).raw_frame(1), FRAMES[1])
    piece = store / "c" / ("0" if in_shard else "1") / "0" / "0"
    if in_shard:
        packed = piece.read_bytes()
        count = 16 * len(FRAMES)  # bytes of the list, before a checksum of four
        listed = np.frombuffer(packed[-count - 4 : -4], "<u8").reshape(-1, 2).copy()
        listed[1] = len(packed), len(BOMB)
        piece.write_bytes(packed + BOMB + listed.tobytes() + packed[-4:])
    else:
        piece.write_bytes(BOMB)
    path = store
    if kind == "zipped":
        path = tmp_path / "bomb.zarr.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for file in store.rglob("*"):
                archive.write(file, file.relative_to(store))
    with pytest.raises(OSError, match="would unpack to more than 1024 bytes"):
        p4d.open_recording(path).raw_frame(1)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_without_workers_is_soon_said(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    from time import monotonic, sleep

    from napari_phase4d.task import Watch

    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as found:
        workers = Cluster(found.scheduler_address)
        results = workers.map(sleep, [0.0, 600.0], Watch(2, "sleeping"))
        assert next(results) is None
        found.scale(0)
        began = monotonic()
        with pytest.raises(OSError, match="sleeping: all workers of the cluster are gone"):
            next(results)
        assert monotonic() - began < 15


def test_a_scheduler_that_asks_for_certificates_is_not_said_to_be_off() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(OSError, match="give dask its certificates .* may be missing") as found:
        Cluster("tls://127.0.0.1:9")
    timeout = found.value.__cause__
    assert "ssl_context" in str(timeout.__cause__ if timeout else "")


def test_what_keeps_from_a_scheduler_is_kept() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(OSError, match="start one with 'dask scheduler'$") as found:
        Cluster("tcp://127.0.0.1:9")
    timeout = found.value.__cause__
    assert isinstance(timeout.__cause__ if timeout else None, ConnectionRefusedError)
