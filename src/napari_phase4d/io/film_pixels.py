"""Grey values of decoded frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["grey_values", "is_lossy", "is_tinted", "palette_of", "through_palette"]

#: Codecs that keep every value.
LOSSLESS = {
    "rawvideo", "ffv1", "huffyuv", "ffvhuff", "utvideo", "png", "v210", "v410", "r210", "tiff",
    "magicyuv", "qtrle", "msrle", "bmp", "targa", "lagarith", "zlib", "rawvid", "gif",
    "bitpacked",
}  # fmt: skip
#: Where brightness stands in formats that mix it with colour: first byte, step.
MIXED = {"yuyv422": (0, 2), "yvyu422": (0, 2), "uyvy422": (1, 2)}
#: Colour difference, in units of 1 / 255, that a grey film may have after compression.
FAINT = 6


def grey_values(picture: Any) -> NDArray[Any] | None:
    """Return the grey values of a decoded frame (y, x), None if it is in colour.

    Brightness comes as it is stored, without stretching its range. Pictures with a palette are for
    `through_palette`.
    """
    name = picture.format.name
    if name in MIXED:
        first, step = MIXED[name]
        return plane(picture, 0, 2 * picture.width)[:, first::step].copy()
    if picture.format.is_rgb:
        return equal_channels(picture)
    if name.startswith("bayer"):
        return None
    if name.startswith("mono"):
        return plane_of(picture.reformat(format="gray"))
    return plane_of(picture)


def plane_of(picture: Any) -> NDArray[Any]:
    """Return the first plane: grey, or the brightness of YUV."""
    bits = picture.format.components[0].bits
    kind: np.dtype[Any] = np.dtype(np.uint8 if bits <= 8 else np.uint16)
    if is_float(picture):
        kind = np.dtype(np.float32)
    if picture.format.is_big_endian:
        kind = kind.newbyteorder(">")
    values = plane(picture, 0, picture.width * kind.itemsize).view(kind)
    return values.astype(kind.newbyteorder("="))


def is_float(picture: Any) -> bool:
    """Say whether grey values are floating-point numbers."""
    return str(picture.format.name).startswith("grayf32")


def plane(picture: Any, number: int, width: int) -> NDArray[np.uint8]:
    """Return the bytes of a plane without the padding of its lines."""
    part = picture.planes[number]
    lines = np.frombuffer(part, np.uint8).reshape(-1, abs(part.line_size))
    return np.ascontiguousarray(lines[: part.height, :width])


def palette_of(picture: Any) -> NDArray[np.uint8]:
    """Return the colours that the numbers of a picture stand for, shape (256, 4)."""
    return np.frombuffer(picture.planes[1], np.uint8)[:1024].reshape(256, 4).copy()


def through_palette(picture: Any, palette: NDArray[np.uint8]) -> NDArray[Any] | None:
    """Return the grey values that the numbers of a picture stand for, None if any is a colour."""
    numbers = plane(picture, 0, picture.width)
    used = palette[np.unique(numbers)]
    if (used[:, 0] != used[:, 1]).any() or (used[:, 1] != used[:, 2]).any():
        return None
    return np.asarray(palette[:, 0][numbers])


def equal_channels(picture: Any) -> NDArray[Any] | None:
    """Return one channel of red, green and blue if they are equal, else None."""
    deep = picture.format.components[0].bits > 8
    image = picture.to_ndarray(format="rgb48le" if deep else "rgb24")
    first = image[..., 0]
    if (image[..., 1] == first).all() and (image[..., 2] == first).all():
        return np.ascontiguousarray(first)
    return None


def is_tinted(picture: Any) -> bool:
    """Say whether a YUV frame has colour."""
    form = picture.format
    if form.is_rgb or len(picture.planes) < 2 or form.name == "pal8":
        return False
    bits = form.components[1].bits
    kind = np.dtype(np.uint8 if bits <= 8 else np.uint16)
    if form.is_big_endian:
        kind = kind.newbyteorder(">")
    middle, faint = 2 ** (bits - 1), FAINT * 2 ** (bits - 8)
    for number in range(1, len(picture.planes)):
        width = picture.planes[number].width * kind.itemsize
        values = plane(picture, number, width).view(kind)[::2, ::2].astype(np.int32)
        if np.abs(values - middle).mean() > faint:
            return True
    return False


def is_lossy(codec: Any) -> bool:
    """Say whether a codec may change values."""
    return codec.name not in LOSSLESS
