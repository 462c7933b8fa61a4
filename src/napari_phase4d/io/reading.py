"""Choosing the reader of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from napari_phase4d.io.films import FILM_SUFFIXES, read_film
from napari_phase4d.io.hdf5 import HDF5_SUFFIXES, hdf5_parts, read_hdf5
from napari_phase4d.io.microscopes import (
    BIO_SUFFIXES,
    is_koala,
    is_koala_phase,
    is_koala_raw,
    read_bio,
    read_koala,
    read_koala_file,
    times_files,
)
from napari_phase4d.io.raw import RAW_SUFFIXES, RawLayout, read_npy, read_npz, read_raw
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.sequences import (
    IMAGE_SUFFIXES,
    PATTERN_SIGNS,
    PICTURE_SUFFIXES,
    files_of,
    files_of_folder,
    notes_of_names,
    read_files,
    read_image,
)
from napari_phase4d.io.tiff import TIFF_SUFFIXES, read_tiff, tiff_parts
from napari_phase4d.io.video import Video
from napari_phase4d.io.zarr_files import is_zarr, read_zarr

__all__ = [
    "JOINED_SUFFIXES",
    "READABLE_SUFFIXES",
    "check_there",
    "folder_of_list",
    "needs_layout",
    "parts_beside",
    "read_list",
    "read_video",
]

#: Endings of what can be read; folders of them too.
READABLE_SUFFIXES = (
    *IMAGE_SUFFIXES, ".npy", ".npz", *HDF5_SUFFIXES, ".zarr", ".zip", ".ozx", *FILM_SUFFIXES,
    *RAW_SUFFIXES, *BIO_SUFFIXES,
)  # fmt: skip
#: Kinds of which several files may follow one another in time.
JOINED_SUFFIXES = (*IMAGE_SUFFIXES, ".npy", *HDF5_SUFFIXES, *FILM_SUFFIXES)


def read_video(path: Path, dataset: str | None = None, raw: RawLayout | None = None) -> Video:
    """Open a file, a folder, a name with * in it, or the address of a Zarr store.

    Parameters
    ----------
    path : Path
        What to open.
    dataset : str, optional
        Which array of a file with several, or which place on further axes, as "Z=0".
    raw : RawLayout, optional
        How frames lie in a raw file.

    Raises
    ------
    OSError
        If it is missing, damaged, or of a kind that can't be read.
    ValueError
        If it holds no such array, has one only but ``dataset`` is given, or if a raw file's layout
        is missing.
    """
    if address_of(path) is not None:
        return read_zarr(path, dataset)
    if any(sign in path.name for sign in PATTERN_SIGNS) and not path.exists():
        return read_list(files_of(path), path, dataset, raw)
    check_there(path)
    if path.is_dir():
        return read_folder(path, dataset, raw)
    if path.stat().st_size == 0:
        msg = f"{path.name} is empty (0 bytes)"
        raise OSError(msg)
    return read_file(path, dataset, raw)


def check_there(path: Path) -> None:
    """Raise OSError if there is no file or folder; pipes and devices may have no end.

    What lies behind an address is seen when it is read.
    """
    if address_of(path) is not None:
        return
    if not path.exists():
        msg = f"there is no file or folder {path}"
        raise OSError(msg)
    if not (path.is_file() or path.is_dir()):
        msg = f"{path.name} is neither a file nor a folder, but a pipe or a device"
        raise OSError(msg)


def parts_beside(path: Path) -> list[Path]:
    """Return the other files that are read with one: a change of theirs changes the recording.

    Parameters
    ----------
    path : Path
        A file or folder.

    Returns
    -------
    list of Path
        Those that hold frames of an OME-TIFF series or of a virtual HDF5 dataset, and the times
        of a Koala recording. They need not be there.
    """
    if not (path.is_file() or path.is_dir()):  # a pipe would be waited for
        return []
    suffix = path.suffix.lower()
    if path.is_dir():
        return times_files(path) if is_koala(path) else []
    if suffix in TIFF_SUFFIXES:
        return tiff_parts(path)
    if suffix in HDF5_SUFFIXES:
        return hdf5_parts(path)
    return times_files(path.parent) if suffix in RAW_SUFFIXES and is_koala_raw(path) else []


def needs_layout(path: Path) -> bool:
    """Say whether a file is raw and can't say itself how its frames lie.

    Parameters
    ----------
    path : Path
        A file or folder; it need not be there.

    Returns
    -------
    bool
        True if it has to be opened with a `RawLayout`. Files of Koala say it themselves.
    """
    return (
        path.suffix.lower() in RAW_SUFFIXES
        and path.is_file()
        and path.stat().st_size > 0
        and not is_koala_raw(path)
        and not is_koala_phase(path)
    )


def read_folder(path: Path, dataset: str | None, raw: RawLayout | None) -> Video:
    """Open a folder: a Zarr store, a Koala recording, or files that follow one another."""
    if is_zarr(path):
        return read_zarr(path, dataset)
    if is_koala(path) and raw is None:
        refuse_choice(path, dataset)
        return read_koala(path)
    files, notes = files_of_folder(path, joined_suffixes(raw))
    video = read_joined(path, files, dataset, raw)
    return replace(video, notes=(*video.notes, *notes))


def joined_suffixes(raw: RawLayout | None) -> tuple[str, ...]:
    """Return the endings of what a folder is joined of."""
    return JOINED_SUFFIXES if raw is None else (*JOINED_SUFFIXES, *RAW_SUFFIXES)


def folder_of_list(files: Sequence[Path], raw: RawLayout | None = None) -> Path | None:
    """Return the folder that opens as a list of files does, None where there is none."""
    folder = files[0].parent
    if is_zarr(folder) or (is_koala(folder) and raw is None):
        return None
    try:
        joined, _ = files_of_folder(folder, joined_suffixes(raw))
    except OSError:  # it may not be listed
        return None
    same = [file.resolve() for file in joined] == [file.resolve() for file in files]
    return folder if same else None


def read_list(
    files: Sequence[Path],
    name: Path | None = None,
    dataset: str | None = None,
    raw: RawLayout | None = None,
) -> Video:
    """Open files that follow one another in time, as they are listed.

    Parameters
    ----------
    files : sequence of Path
        All of one kind.
    name : Path, optional
        What to call them all. Default: their folder.
    dataset, raw : optional
        As for `read_video`; the same for every file.

    Raises
    ------
    ValueError
        If they are of several kinds, or of one that can't be joined.
    """
    kinds = sorted({path.suffix.lower() for path in files})
    if len(kinds) > 1 or (kinds[0] not in JOINED_SUFFIXES and raw is None):
        msg = (
            f"{len(files)} files with {', '.join(kinds)} can't be joined to one recording; "
            f"give files of one kind out of {', '.join(JOINED_SUFFIXES)}"
        )
        raise ValueError(msg)
    return read_joined(name or files[0].parent, files, dataset, raw)


def read_joined(
    name: Path, files: Sequence[Path], dataset: str | None, raw: RawLayout | None
) -> Video:
    """Open files as one video, each with the same choice."""
    if files[0].suffix.lower() in PICTURE_SUFFIXES and raw is None:
        refuse_choice(name, dataset)
    if not dataset and raw is None:
        video = read_files(name, files, read_part)
    else:
        read_one = partial(read_part, dataset=dataset, raw=raw)
        video = read_files(name, files, read_one, whole=False)
    return replace(video, notes=(*video.notes, *notes_of_names(files)))


def read_part(path: Path, dataset: str | None = None, raw: RawLayout | None = None) -> Video:
    """Open one of several files."""
    return read_file(path, dataset, raw)


def refuse_choice(path: Path, dataset: str | None) -> None:
    """Raise ValueError if something is to be chosen where there is no choice."""
    if dataset:
        msg = f"{path.name} has one array only; leave dataset out, which is {dataset!r}"
        raise ValueError(msg)


def read_file(path: Path, dataset: str | None, raw: RawLayout | None) -> Video:
    """Open one file; its ending says how."""
    check_there(path)  # one of a folder may be a pipe too
    suffix = path.suffix.lower()
    if raw is not None:
        refuse_choice(path, dataset)
        return read_raw(path, raw)
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path, dataset)
    if suffix == ".npz":
        return read_npz(path, dataset)
    if suffix in HDF5_SUFFIXES:
        return read_hdf5(path, dataset)
    if suffix in (".npy", *FILM_SUFFIXES, *PICTURE_SUFFIXES):
        refuse_choice(path, dataset)
    if suffix == ".npy":
        return read_npy(path)
    if suffix in FILM_SUFFIXES:
        return read_film(path)
    if suffix in PICTURE_SUFFIXES:
        return read_image(path)
    return read_other(path, dataset)


def read_other(path: Path, dataset: str | None) -> Video:
    """Open a file whose ending alone doesn't tell all."""
    if is_zarr(path):
        return read_zarr(path, dataset)
    if path.suffix.lower() in RAW_SUFFIXES:
        refuse_choice(path, dataset)
        return read_koala_file(path) if is_koala_raw(path) else read_raw(path, None)
    return read_bio(path, dataset)
