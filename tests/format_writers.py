"""Writers of one recording in every format."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import imageio.v3 as iio
import numpy as np
import pytest
import tifffile

from napari_phase4d.io import RawLayout

#: Pixel in the sample and time between frames that formats note which can.
PIXEL_UM, INTERVAL_S = 0.25, 0.125
#: Side of the blocks that spell a frame's number in films that lose detail.
BLOCK = 16


def noise(n: int, shape: tuple[int, int], dtype: Any) -> np.ndarray:
    """Frames without any likeness, so that a wrong one can't be taken for right."""
    top = 256 if np.dtype(dtype).itemsize == 1 else 4096
    return np.random.default_rng(n).integers(0, top, (n, *shape)).astype(dtype)


def numbered(n: int, shape: tuple[int, int], dtype: Any) -> np.ndarray:
    """Frames that spell their number in large black and white blocks, most significant first."""
    frames = np.full((n, *shape), 40, dtype)
    for number in range(n):
        for bit in range(8):
            if number >> (7 - bit) & 1:
                row, column = divmod(bit * BLOCK, 4 * BLOCK)
                place = np.s_[row * BLOCK : (row + 1) * BLOCK, column : column + BLOCK]
                frames[number][place] = 210
    return frames


def spelled(frame: np.ndarray) -> int:
    """Return the number that a frame spells."""
    number = 0
    for bit in range(8):
        row, column = divmod(bit * BLOCK, 4 * BLOCK)
        block = frame[row * BLOCK : (row + 1) * BLOCK, column : column + BLOCK]
        number = 2 * number + int(block.mean() > 125)
    return number


Write = Callable[[Path, np.ndarray], Path]


def tiff(**options: Any) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        path = folder / "rec.tif"
        tifffile.imwrite(path, frames, photometric="minisblack", **options)
        return path

    return write


def imagej(folder: Path, frames: np.ndarray) -> Path:
    path = folder / "rec.tif"
    tifffile.imwrite(
        path, frames, imagej=True, resolution=(1 / PIXEL_UM, 1 / PIXEL_UM),
        metadata={"axes": "TYX", "unit": "um", "finterval": INTERVAL_S},
    )  # fmt: skip
    return path


OME = {
    "axes": "TYX", "PhysicalSizeX": PIXEL_UM * 1000, "PhysicalSizeXUnit": "nm",
    "TimeIncrement": INTERVAL_S * 1000, "TimeIncrementUnit": "ms",
}  # fmt: skip


def ome_tiff(folder: Path, frames: np.ndarray) -> Path:
    path = folder / "rec.ome.tif"
    tifffile.imwrite(path, frames, ome=True, photometric="minisblack", metadata=OME)
    return path


def ome_series(folder: Path, frames: np.ndarray) -> Path:
    """Write an OME-TIFF in one file a frame, with the description that joins them."""
    n, height, width = frames.shape
    names = [f"rec_{i}.ome.tif" for i in range(n)]
    blocks = "".join(
        f'<TiffData FirstT="{i}" FirstC="0" FirstZ="0" IFD="0" PlaneCount="1">'
        f'<UUID FileName="{name}">urn:uuid:{i:08d}-0000-0000-0000-000000000000</UUID></TiffData>'
        for i, name in enumerate(names)
    )
    for i, name in enumerate(names):
        xml = (
            '<?xml version="1.0" encoding="UTF-8"?>'
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
            f'UUID="urn:uuid:{i:08d}-0000-0000-0000-000000000000"><Image ID="Image:0">'
            f'<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="{frames.dtype}" SizeX="{width}" '
            f'SizeY="{height}" SizeZ="1" SizeC="1" SizeT="{n}" PhysicalSizeX="{PIXEL_UM}" '
            f'TimeIncrement="{INTERVAL_S}"><Channel ID="Channel:0:0" SamplesPerPixel="1"/>'
            f"{blocks}</Pixels></Image></OME>"
        )
        tifffile.imwrite(folder / name, frames[i], description=xml, metadata=None,
                         photometric="minisblack")  # fmt: skip
    return folder / names[0]


def images(ending: str) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        (folder / "rec").mkdir()
        for i, frame in enumerate(frames):
            iio.imwrite(folder / "rec" / f"frame{i}{ending}", frame)
        return folder / "rec"

    return write


def stacks(folder: Path, frames: np.ndarray) -> Path:
    (folder / "rec").mkdir()
    for i, start in enumerate(range(0, len(frames), 5)):
        tifffile.imwrite(folder / "rec" / f"rec_{i}.tif", frames[start : start + 5],
                         photometric="minisblack", metadata={"axes": "TYX"})  # fmt: skip
    return folder / "rec"


def pattern(folder: Path, frames: np.ndarray) -> Path:
    stacks(folder, frames)
    tifffile.imwrite(folder / "rec" / "dark.tif", frames[0])
    return folder / "rec" / "rec_*.tif"


def npy(folder: Path, frames: np.ndarray) -> Path:
    np.save(folder / "rec.npy", frames)
    return folder / "rec.npy"


def npz(folder: Path, frames: np.ndarray) -> Path:
    np.savez_compressed(folder / "rec.npz", mux=frames, times=np.arange(len(frames)))
    return folder / "rec.npz"


def hdf5(**options: Any) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        with h5py.File(folder / "rec.h5", "w") as file:
            data = file.create_dataset("run/camera", data=frames, **options)
            data.attrs["pixel_size_um"] = PIXEL_UM
            file.attrs["frame_rate_hz"] = 1 / INTERVAL_S
            file["run/positions"] = np.zeros((len(frames), 3))
            file["run/dark"] = frames[0]
        return folder / "rec.h5"

    return write


def hdf5_numbered(folder: Path, frames: np.ndarray) -> Path:
    with h5py.File(folder / "rec.h5", "w") as file:
        for i, frame in enumerate(frames):
            file[str(i)] = frame
            file[str(i)].attrs["pixel size"] = PIXEL_UM * 1e-6
        file["reference"] = frames[0]
    return folder / "rec.h5"


def hyperspy(folder: Path, frames: np.ndarray) -> Path:
    axes = (("t", INTERVAL_S * 1000, "ms"), ("y", 250.0, "nm"), ("x", PIXEL_UM * 1000, "nm"))
    with h5py.File(folder / "rec.hspy", "w") as file:
        group = file.create_group("Experiments/cells")
        group["data"] = frames
        for i, (name, scale, unit) in enumerate(axes):
            group.create_group(f"axis-{i}").attrs.update(name=name, scale=scale, units=unit)
    return folder / "rec.hspy"


def zarr_array(version: int, **options: Any) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        import zarr

        path = folder / "rec.zarr"
        chunks = options.get("chunks", (1, *frames.shape[1:]))
        shards = options.get("shards")
        if shards:
            shards = (shards[0], *frames.shape[1:])
        array = zarr.create_array(path, shape=frames.shape, dtype=frames.dtype, chunks=chunks,
                                  shards=shards, zarr_format=version)  # fmt: skip
        array[:] = frames
        return path

    return write


def zarr_zip(folder: Path, frames: np.ndarray) -> Path:
    import zarr

    path = folder / "rec.zarr.zip"
    with zarr.storage.ZipStore(path, mode="w") as store:
        root = zarr.create_group(store)
        array = root.create_array("frames", shape=frames.shape, dtype=frames.dtype,
                                  chunks=(1, *frames.shape[1:]))  # fmt: skip
        array[:] = frames
    return path


def ome_zarr(version: str) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        import zarr

        path = folder / "rec.ome.zarr"
        root = zarr.create_group(path, zarr_format=2 if version == "0.4" else 3)
        levels = []
        for level, data in enumerate((frames, frames[:, ::2, ::2])):
            video = data[:, None, None]
            array = root.create_array(str(level), shape=video.shape, dtype=video.dtype,
                                      chunks=(1, 1, 1, *data.shape[1:]))  # fmt: skip
            array[:] = video
            size = 125.0 * 2**level
            scale = {"type": "scale", "scale": [INTERVAL_S * 500, 1, 1, size, size]}
            levels.append({"path": str(level), "coordinateTransformations": [scale]})
        axes = [
            {"name": "t", "type": "time", "unit": "millisecond"}, {"name": "c", "type": "channel"},
            {"name": "z", "type": "space"},
            {"name": "y", "type": "space", "unit": "nanometer"},
            {"name": "x", "type": "space", "unit": "nanometer"},
        ]  # fmt: skip
        image = {
            "axes": axes, "datasets": levels,
            "coordinateTransformations": [{"type": "scale", "scale": [2, 1, 1, 2, 2]}],
        }  # fmt: skip
        if version == "0.4":
            root.attrs["multiscales"] = [{"version": version, **image}]
        else:
            root.attrs["ome"] = {"version": version, "multiscales": [image]}
        return path

    return write


def film(
    ending: str, codec: str, pixels: str, options: dict[str, str] | None = None,
    times: Sequence[float] | None = None,
) -> Write:  # fmt: skip
    def write(folder: Path, frames: np.ndarray) -> Path:
        import av

        path = folder / f"rec{ending}"
        given = "gray" if frames.dtype == np.uint8 else "gray16le"
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=Fraction(1 / INTERVAL_S))
            stream.height, stream.width = frames.shape[1:]
            stream.pix_fmt = pixels
            stream.options = options or {}
            if times is not None:
                stream.codec_context.time_base = Fraction(1, 1000)
            for i, frame in enumerate(frames):
                picture = picture_of(frame, given, pixels)
                if times is not None:
                    picture.pts, picture.time_base = round(1000 * times[i]), Fraction(1, 1000)
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))
        return path

    return write


def windows_film(folder: Path, frames: np.ndarray) -> Path:
    """Write an AVI of grey values in a palette, from the bottom up, as frame grabbers do."""
    pytest.importorskip(
        "av", minversion="18", reason="older PyAV takes the last line for the first"
    )
    n, height, width = frames.shape
    stride = -(-width // 4) * 4

    def chunk(name: bytes, data: bytes) -> bytes:
        return name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)

    rows = np.zeros((n, height, stride), np.uint8)
    rows[..., :width] = frames[:, ::-1]
    pictures = [chunk(b"00db", picture.tobytes()) for picture in rows]
    size = stride * height
    tick = round(1e6 * INTERVAL_S)
    film_head = struct.pack("<14I", tick, 0, 0, 16, n, 0, 1, size, width, height, 0, 0, 0, 0)
    stream_head = struct.pack(
        "<4s4s10I4H", b"vids", b"DIB ", 0, 0, 0, tick, 10**6, 0, n, size, 0, 0, 0, 0, width, height
    )
    picture_head = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 8, 0, size, 0, 0, 256, 0)
    picture_head += b"".join(bytes((i, i, i, 0)) for i in range(256))
    stream = chunk(b"strh", stream_head) + chunk(b"strf", picture_head)
    header = b"hdrl" + chunk(b"avih", film_head) + chunk(b"LIST", b"strl" + stream)
    places = [4 + i * len(pictures[0]) for i in range(n)]
    index = b"".join(struct.pack("<4s3I", b"00db", 16, place, size) for place in places)
    body = b"AVI " + chunk(b"LIST", header) + chunk(b"LIST", b"movi" + b"".join(pictures))
    path = folder / "rec.avi"
    path.write_bytes(chunk(b"RIFF", body + chunk(b"idx1", index)))
    return path


def picture_of(frame: np.ndarray, given: str, pixels: str) -> Any:
    """Return a frame for an encoder; of YUV the brightness is set to the values as they are."""
    import av

    if pixels == "yuyv422":
        mixed = np.full((frame.shape[0], frame.shape[1], 2), 128, np.uint8)
        mixed[..., 0] = frame
        return av.VideoFrame.from_ndarray(mixed, format=pixels)
    if pixels.startswith("yuv"):
        height, width = frame.shape
        rest = np.full((height // 2, width), 128, np.uint8)
        return av.VideoFrame.from_ndarray(np.concatenate([frame, rest]), format=pixels)
    picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format=given)
    return picture if pixels == given else picture.reformat(format=pixels)


RAW = RawLayout(96, 128, "uint16", ">", header_bytes=100, gap_bytes=12)


def raw(folder: Path, frames: np.ndarray) -> Path:
    parts = [b"\0" * RAW.header_bytes]
    for frame in frames:
        parts += [frame.astype(">u2").tobytes(), b"\xff" * RAW.gap_bytes]
    (folder / "rec.raw").write_bytes(b"".join(parts)[: -RAW.gap_bytes])
    return folder / "rec.raw"


#: Uneven, as a computer's clock gives them.
KOALA_MS = [0.0, 120.5, 251.0, 377.25]


def koala_times(folder: Path, n: int) -> None:
    times = [KOALA_MS[i % 4] + 500 * (i // 4) for i in range(n)]
    lines = [f"{i:05d} 12:00:00.000 2026.01.31 {t}" for i, t in enumerate(times)]
    (folder / "timestamps.txt").write_text("\r\n".join(lines) + "\r\n")


def koala_raw(folder: Path, frames: np.ndarray) -> Path:
    root = folder / "rec"
    (root / "Holograms").mkdir(parents=True)
    n, height, width = frames.shape
    head = np.array([width, height, 8, n], "<i4").tobytes()
    (root / "Holograms" / "holo.raw").write_bytes(head + frames.tobytes())
    koala_times(root, n)
    return root


def koala_images(folder: Path, frames: np.ndarray) -> Path:
    root = folder / "rec"
    (root / "Holograms").mkdir(parents=True)
    for i, frame in enumerate(frames):
        tifffile.imwrite(root / "Holograms" / f"{i:05d}_holo.tif", frame)
    koala_times(root, len(frames))
    return root


def gif(folder: Path, frames: np.ndarray) -> Path:
    iio.imwrite(folder / "rec.gif", frames, duration=125, loop=0)
    return folder / "rec.gif"


def picture(ending: str) -> Write:
    def write(folder: Path, frames: np.ndarray) -> Path:
        iio.imwrite(folder / f"rec{ending}", frames[0])
        return folder / f"rec{ending}"

    return write


def inside(name: str) -> Callable[[Path], Path]:
    """Return what is damaged of a folder."""
    return lambda path: path / name if path.is_dir() else path.parent / name
