"""Recordings larger than memory: a block of frames at a time, here or on a cluster.

Reading, transforming, unwrapping and writing overlap on all cores; results lie on disk and are
the same numbers as in memory.
"""

from napari_phase4d.pipeline.starting import FrameSource
from napari_phase4d.pipeline.streaming.problem import ProblemOnDisk
from napari_phase4d.pipeline.streaming.stored import (
    GrowingStack,
    Shelf,
    reconstruct_to_disk,
    stored_at,
)

__all__ = [
    "FrameSource",
    "GrowingStack",
    "ProblemOnDisk",
    "Shelf",
    "reconstruct_to_disk",
    "stored_at",
]
