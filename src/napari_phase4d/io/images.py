"""Folders of numbered images, and single images."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_phase4d.io.video import Video

__all__ = ["IMAGE_SUFFIXES", "read_image", "read_image_folder"]

TIFF_SUFFIXES = (".tif", ".tiff")
IMAGE_SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg", *TIFF_SUFFIXES)


def read_image(path: Path) -> Video:
    """Read one image as a recording of one frame.

    Raises
    ------
    OSError
        If the image can't be decoded.
    """
    image = grey(load_image(path))
    return Video(image, colour=image.ndim == 3)


def read_image_folder(folder: Path) -> Video:
    """Open a folder of equally large images as a video, lazily, in the order of their numbers.

    Raises
    ------
    OSError
        If the folder holds no images.
    ValueError
        If the images differ in size (found while reading that frame).
    """
    paths = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES), key=by_number
    )
    if not paths:
        msg = f"{folder.name} holds no images ({', '.join(IMAGE_SUFFIXES)})"
        raise OSError(msg)
    first = grey(load_image(paths[0]))
    if first.ndim == 3 and first.shape[-1] not in (3, 4):
        msg = f"{paths[0].name} holds a stack of images; a folder must hold one frame a file"
        raise ValueError(msg)

    def load(path: Path) -> NDArray[Any]:
        frame = grey(load_image(path))
        if frame.shape != first.shape:
            msg = (
                f"{path.name} is {frame.shape}, but {paths[0].name} is {first.shape}; "
                "all images of a folder must be of one size"
            )
            raise ValueError(msg)
        if frame.dtype != first.dtype:
            msg = (
                f"{path.name} holds {frame.dtype} values, but {paths[0].name} {first.dtype}; "
                "all images of a folder must be of one kind"
            )
            raise ValueError(msg)
        return frame

    import dask.array as da
    from dask import delayed

    lazy = [da.from_delayed(delayed(load)(p), first.shape, first.dtype) for p in paths]
    return Video(da.stack(lazy), colour=first.ndim == 3)


def load_image(path: Path) -> NDArray[Any]:
    """Return an image as an array, or raise OSError in one sentence."""
    try:
        if path.suffix.lower() in TIFF_SUFFIXES:
            return np.asarray(tifffile.imread(path))
        import imageio.v3 as iio

        return np.asarray(iio.imread(path))
    except (OSError, ValueError, SyntaxError, tifffile.TiffFileError) as error:
        msg = f"{path.name} can't be read as an image; it may be cut short or damaged"
        raise OSError(msg) from error


def grey(image: NDArray[Any]) -> NDArray[Any]:
    """Return the grey values of an image whose colour channels are all equal (else the image)."""
    if image.ndim == 3 and image.shape[-1] in (3, 4):
        first = image[..., 0]
        if (image[..., 1] == first).all() and (image[..., 2] == first).all():
            return first
    return image


def by_number(path: Path) -> tuple[list[int], str]:
    """Sort key: the numbers in the name as numbers, so that frame2 comes before frame10."""
    return [int(n) for n in re.findall(r"\d+", path.stem)], path.name
