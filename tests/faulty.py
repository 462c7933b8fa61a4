"""A small sound file of every format, and what reading a faulty one may lead to."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.io import open_input

SHAPE = (5, 32, 48)
#: One sentence is no longer than this.
LONGEST = 600


def smooth_frames() -> np.ndarray:
    """Return moving fringes, which lossy films keep well enough."""
    time, y, x = np.indices(SHAPE)
    return (127 + 100 * np.cos(0.5 * y + 0.3 * x + time)).astype(np.uint8)


FRAMES = smooth_frames()


def tiff(**options: Any) -> Callable[[Path], None]:
    return lambda path: tifffile.imwrite(path, FRAMES, photometric="minisblack", **options)


def tiff_pages(path: Path) -> None:
    """Write frames one by one, each a series of its own."""
    with tifffile.TiffWriter(path) as writer:
        for frame in FRAMES:
            writer.write(frame, photometric="minisblack", metadata=None)


def picture(path: Path) -> None:
    import imageio.v3 as iio

    iio.imwrite(path, FRAMES[0])


def hdf5(**options: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import h5py

        with h5py.File(path, "w") as file:
            file.create_dataset("holograms", data=FRAMES, **options)

    return write


def film(codec: str, pixel: str, source: str = "gray") -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import av

        with av.open(str(path), "w") as container:
            stream: Any = container.add_stream(codec, rate=25)
            stream.height, stream.width, stream.pix_fmt = *SHAPE[1:], pixel
            for frame in FRAMES:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, source)))
            container.mux(stream.encode())

    return write


def zarr_store(version: int, path: Path) -> None:
    import zarr

    store = zarr.create_array(
        str(path), shape=SHAPE, chunks=(1, *SHAPE[1:]), dtype="u1", zarr_format=version
    )
    store[:] = FRAMES


def zarr_zip(path: Path) -> None:
    import zarr

    with zarr.storage.ZipStore(path, mode="w") as store:
        array = zarr.create_array(store, shape=SHAPE, chunks=(1, *SHAPE[1:]), dtype="u1")
        array[:] = FRAMES


def raw(path: Path) -> None:
    path.write_bytes(FRAMES.tobytes())


def koala(folder: Path) -> None:
    """Write a Koala sequence: numbered holograms, and a list of their times."""
    holograms = folder / "Holograms"
    holograms.mkdir(parents=True)
    for number, frame in enumerate(FRAMES):
        tifffile.imwrite(holograms / f"{number:05d}_holo.tif", frame)
    lines = [f"{i:05d}\t12:00:{i:02d}\t{1000 * i}\t{i}" for i in range(len(FRAMES))]
    (folder / "timestamps.txt").write_text("\n".join(lines) + "\n")


def numbered(folder: Path) -> None:
    import imageio.v3 as iio

    folder.mkdir()
    for number, frame in enumerate(FRAMES):
        iio.imwrite(folder / f"frame{number}.png", frame)


#: Format -> ending, writer. A new format is a new line.
FILES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "TIFF": (".tif", tiff()),
    "TIFF, big-endian": (".tif", tiff(byteorder=">", bigtiff=False)),
    "TIFF, compressed": (".tif", tiff(compression="zlib", predictor=True)),
    "TIFF, LZW tiles": (".tif", tiff(compression="lzw", tile=(16, 16))),
    "TIFF, page by page": (".tif", tiff_pages),
    "BigTIFF": (".tif", tiff(bigtiff=True)),
    "ImageJ TIFF": (".tif", tiff(imagej=True, metadata={"axes": "TYX", "finterval": 0.2})),
    "OME-TIFF": (".ome.tif", tiff(ome=True, metadata={"axes": "TYX", "PhysicalSizeX": 0.2})),
    "NPY": (".npy", lambda path: np.save(path, FRAMES)),
    "NPZ": (".npz", lambda path: np.savez(path, holograms=FRAMES)),
    "NPZ, compressed": (".npz", lambda path: np.savez_compressed(path, holograms=FRAMES)),
    "PNG": (".png", picture),
    "BMP": (".bmp", picture),
    "JPEG": (".jpg", picture),
    "HDF5": (".h5", hdf5()),
    "HDF5, compressed": (".h5", hdf5(chunks=(1, *SHAPE[1:]), compression="gzip")),
    "AVI, uncompressed": (".avi", film("rawvideo", "gray")),
    "AVI, Motion JPEG": (".avi", film("mjpeg", "yuvj420p")),
    "MKV, FFV1": (".mkv", film("ffv1", "gray")),
    "MP4, MPEG-4": (".mp4", film("mpeg4", "yuv420p")),
    "Zarr, zipped": (".zarr.zip", zarr_zip),
    "raw": (".raw", raw),
}
#: The same for folders; any of their files may be at fault.
FOLDERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "images": ("", numbered),
    "Koala": ("", koala),
    "Zarr 2": (".zarr", lambda path: zarr_store(2, path)),
    "Zarr 3": (".zarr", lambda path: zarr_store(3, path)),
}
FORMATS = FILES | FOLDERS


def result(path: Path) -> None:
    """Write unwrapped phase as the program does."""
    shape = (3, 2, 16, 20)
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    coords = {
        d: np.arange(n) * 0.5 for d, n in zip(("time", "angle", "y", "x"), shape, strict=True)
    }
    stack = xr.DataArray(values, dims=tuple(coords), coords=coords, attrs={"units": "rad"})
    p4d.write_phase(path, stack)


#: What the program writes; read as a result, and as input of the next run.
RESULTS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "result, OME-TIFF": (".ome.tif", result),
    "result, OME-Zarr": (".ome.zarr", result),
}


def sound(name: str, folder: Path) -> Path:
    """Write a sound file of a format."""
    ending, write = (FORMATS | RESULTS)[name]
    path = folder / f"sound{ending}"
    write(path)
    return path


def opened(path: Path) -> p4d.Recording:
    """Open a recording; of raw files, say how large frames are."""
    if path.suffix == ".raw":
        from napari_phase4d.io import RawLayout

        return p4d.open_recording(path, raw=RawLayout(*SHAPE[1:], dtype="uint8"))
    return p4d.open_recording(path)


def outcome_of(path: Path, at: Sequence[float] = (0.0, 1.0)) -> str:
    """Open a recording and read some frames; say how that went.

    Returns
    -------
    str
        "fine", "sentence", or what else happened, with the error.
    """

    def read() -> str:
        recording = opened(path)
        last = recording.n_frames - 1
        for place in at:
            frame = recording.frame(round(place * last))
            if frame.shape != recording.frame_shape:
                return f"frame of {frame.shape}, not {recording.frame_shape}"
        return "fine"

    return outcome(read, path)


def outcome_as_input(path: Path) -> str:
    """Open a file as a run does, which looks whether it is phase; say how that went."""

    def read() -> str:
        if path.suffix == ".raw":
            return "fine"  # a run has to be told how large its frames are
        found = open_input(path)
        _ = found.values if isinstance(found, xr.DataArray) else found.frame(0)
        return "fine"

    return outcome(read, path)


def outcome_as_result(path: Path) -> str:
    """Read a result of this program; say how that went."""

    def read() -> str:
        p4d.read_results(path).load()
        return "fine"

    return outcome(read, path)


def outcome(read: Callable[[], str], path: Path) -> str:
    """Return what reading a file says, or how it failed."""
    try:
        return read()
    except (ValueError, OSError, TypeError) as error:
        return judged(error, path)
    except MemoryError as error:
        return f"memory: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def judged(error: Exception, path: Path) -> str:
    """Say "sentence" if an error is one, made by this program, that names the file."""
    said = str(error)
    if type(error) not in known_kinds() or "\n" in said or not 10 < len(said) < LONGEST:
        return f"{type(error).__name__}: {said}"
    if path.name not in said and not any(p.name in said for p in path.rglob("*")):
        return f"without the file's name: {type(error).__name__}: {said}"
    return "sentence"


def known_kinds() -> tuple[type, ...]:
    """Return the kinds of error that may come out: built-in ones, and the program's own."""
    own = {OSError, ValueError, TypeError, FileNotFoundError, PermissionError}
    kinds = list(own)
    while kinds:
        for kind in kinds.pop().__subclasses__():
            if kind.__module__.startswith("napari_phase4d"):
                own.add(kind)
                kinds.append(kind)
    return tuple(own)


@contextmanager
def public_folder() -> Iterator[Path]:
    """Give a folder that other users may look into, unlike those of pytest."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)
