"""What a film says of itself: codec, times, and what the user should know."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.film_index import FilmIndex

__all__ = ["gaps_in", "kind_of", "notes_of", "timing"]

CONTAINERS = {"avi": "AVI", "matroska": "MKV"}
CODECS = {
    "rawvideo": "uncompressed", "ffv1": "FFV1", "h264": "H.264", "hevc": "H.265",
    "mjpeg": "Motion JPEG", "mpeg4": "MPEG-4", "huffyuv": "HuffYUV", "png": "PNG",
}  # fmt: skip


def notes_of(index: FilmIndex, told: int, *, lossy: bool, tinted: bool) -> Iterator[str]:
    """Yield what the user should know of a film."""
    if lossy:
        yield "The film is compressed with loss, which changes fringes and so the phase."
    if tinted:
        yield "The film is in colour; its brightness is used."
    if told and told != index.n_frames:
        yield f"The header tells of {told} frames, but the film has {index.n_frames}."
    if index.by_counting:
        yield "The file doesn't say in which order frames are shown; going back in it is slow."


def timing(
    index: FilmIndex, tick: float, rate: float
) -> tuple[float | None, NDArray[np.float64] | None]:
    """Return the interval of evenly spaced frames, or else the times of all."""
    ticks = index.times()
    if ticks is None or index.n_frames < 2:
        return (1 / rate if rate > 0 else None), None
    times = ticks * tick
    mean = float(times[-1] / (len(times) - 1))
    even = np.abs(times - mean * np.arange(len(times))).max() <= 1.01 * tick
    if not even:
        return None, np.asarray(times, np.float64)
    # Ticks are coarse (milliseconds in MKV); the rate is exact where it means the same.
    agrees = rate > 0 and abs(times[-1] - (len(times) - 1) / rate) <= 1.01 * tick
    return (1 / rate if agrees else mean), None


def gaps_in(times: NDArray[np.float64], tick: float) -> Iterator[str]:
    """Yield a note if frames seem to be missing: even steps, but for a few that are multiples."""
    steps = np.diff(times)
    usual = float(np.median(steps))
    missing = np.round(steps / usual) - 1
    even = np.abs(steps - (missing + 1) * usual) <= 2.01 * tick
    if even.all() and 0 < (missing > 0).mean() < 0.1:
        place = int(np.argmax(missing > 0))
        yield (
            f"{int(missing.sum())} frames seem to be missing, the first behind frame {place}; "
            "the times are as the film gives them."
        )


def kind_of(path: Path, container: Any, stream: Any) -> str:
    """Return what a film is, in words."""
    codec = stream.codec_context.name
    outer = CONTAINERS.get(container.format.name.split(",")[0], path.suffix[1:].upper())
    return f"{CODECS.get(codec, codec)} in {outer}"
