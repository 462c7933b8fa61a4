"""Grey pictures that are stored as colour ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["colour_sentence", "grey"]


def grey(image: NDArray[Any]) -> NDArray[Any]:
    """Return the grey values of an image whose colour channels are all equal (else the image)."""
    if image.ndim == 3 and image.shape[-1] in (3, 4):
        first = image[..., 0]
        if (image[..., 1] == first).all() and (image[..., 2] == first).all():
            return np.ascontiguousarray(first)
    return image


def colour_sentence(name: str) -> str:
    """Return the sentence for a recording in colour."""
    return f"{name} is in colour; a hologram has one grey value a pixel, so pick one channel first"
