"""Single images, as cameras and other programs write them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_phase4d.io.chatter import quiet
from napari_phase4d.io.grey import grey
from napari_phase4d.io.lazy import Unsound
from napari_phase4d.io.tiff import TIFF_SUFFIXES
from napari_phase4d.io.tiff_checks import check_described
from napari_phase4d.io.video import Video

__all__ = ["IMAGE_SUFFIXES", "PICTURE_SUFFIXES", "load_image", "read_image"]

PICTURE_SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg", ".pgm", ".jp2")
IMAGE_SUFFIXES = (*PICTURE_SUFFIXES, *TIFF_SUFFIXES)
#: Values that an image may have: more than any camera's, times three for colour.
MOST_VALUES = 2**29
#: Values in a byte: more than deflate (1032) and JPEG make of one. Small images are never absurd.
MOST_PER_BYTE, NEVER_ABSURD = 1100, 2**24


def read_image(path: Path) -> Video:
    """Read one image as a recording of one frame.

    Raises
    ------
    OSError
        If the image can't be decoded.
    """
    image = load_image(path)
    kind = "JPEG" if path.suffix.lower() in (".jpg", ".jpeg") else path.suffix[1:].upper()
    return Video(image, colour=image.ndim == 3, kind=f"{kind} image")


def load_image(path: Path) -> NDArray[Any]:
    """Return an image, (y, x) where its channels are equal, or raise OSError in one sentence."""
    try:
        if path.suffix.lower() in TIFF_SUFFIXES:
            with quiet(), tifffile.TiffFile(path) as tif:
                check_described(tif, path)
                check_size(path, tif.series[0].shape)
                return grey(np.asarray(tif.asarray()))
        import imageio.v3 as iio
        from PIL import Image

        # Opened here, since Pillow leaves open what it refuses.
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # Pillow's warning of large images
            with Image.open(file) as image:
                check_size(path, (image.height, image.width, len(image.getbands())))
            return grey(np.asarray(iio.imread(path)))
    except Unsound:
        raise
    except Exception as error:
        # Decoders raise SyntaxError, struct.error and more for damaged files.
        msg = f"{path.name} can't be read as an image; it may be cut short or damaged"
        raise OSError(msg) from error


def check_size(path: Path, shape: tuple[int, ...]) -> None:
    """Raise Unsound if an image has absurdly many pixels."""
    values = np.prod([float(n) for n in shape])
    most = max(NEVER_ABSURD, MOST_PER_BYTE * path.stat().st_size)
    if values > min(MOST_VALUES, most):
        size = " x ".join(str(n) for n in shape)
        msg = f"{path.name} says that it has {size} pixels, more than so small a file can hold"
        raise Unsound(msg)
