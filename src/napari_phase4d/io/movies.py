"""Moving pictures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.atomic import written_whole

__all__ = ["write_movie"]


def write_movie(
    path: str | Path, frames: Iterable[NDArray[np.uint8]], frames_a_second: float = 4.0
) -> Path:
    """Write frames (y, x, 3) as an animated GIF that starts again when it ends.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    """
    path = Path(path)
    with written_whole(path) as temporary:
        iio.imwrite(
            temporary, list(frames), extension=".gif", duration=1000 / frames_a_second, loop=0
        )
    return path
