"""What a run will need."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from napari_phase4d.holography import Demodulator, Lobe
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import METHODS, STACKS_OF_A_FRAME

__all__ = ["needed_bytes", "working_bytes"]


def needed_bytes(recording: Recording, lobes: list[Lobe], methods: Sequence[str]) -> int:
    """Return about how much memory a run will need, in bytes, beyond the recording itself."""
    height, width = Demodulator(recording.frame_shape, lobes).output_shape
    stack = 4 * recording.n_frames * len(lobes) * height * width
    # Phase and amplitude stay; the transforms of the frames in work do not.
    unwrapping = working_bytes(stack, methods, frame=4 * height * width)
    return 2 * stack + unwrapping + int(64 * np.prod(recording.frame_shape))


def working_bytes(stack: int, methods: Sequence[str], *, frame: int) -> int:
    """Return about how much memory unwrapping needs, in bytes, beyond the wrapped phase.

    Parameters
    ----------
    stack : int
        Bytes of the wrapped phase as float32.
    methods : sequence of str
        Ids of the methods to run, one after the other.
    frame : int
        Bytes of one frame of it.
    """
    largest = max((METHODS[m].working_stacks for m in methods), default=0)
    of_threads = (os.cpu_count() or 1) * STACKS_OF_A_FRAME * frame
    # The two-dimensional step and every result stay.
    return int(stack * (2 + len(methods) + largest) + of_threads)
