"""Wrapped phase and amplitude of a recording, straight to disk."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from napari_phase4d.holography import FrameReconstructor
from napari_phase4d.pipeline.streaming.source import FrameSource
from napari_phase4d.pipeline.streaming.stored import Shelf, Stored
from napari_phase4d.pipeline.streaming.workers import Workers
from napari_phase4d.stack import Block, Limits, blocks_of, limits_of, widest
from napari_phase4d.task import UNWATCHED, Task, Watch

__all__ = ["reconstruct_to_disk"]


def reconstruct_to_disk(
    source: FrameSource,
    work: FrameReconstructor,
    shelf: Shelf,
    workers: Workers,
    task: Task = UNWATCHED,
) -> xr.Dataset:
    """Reconstruct a recording a block of frames at a time.

    Parameters
    ----------
    source : FrameSource
        The frames.
    work : FrameReconstructor
        What turns one into phase and amplitude.
    shelf : Shelf
        Where "wrapped" and "amplitude" go.
    workers : Workers
        Who works on the blocks.
    task : Task, optional
        Who is told of it, and may stop it.

    Returns
    -------
    xarray.Dataset
        As `reconstruct` returns it, its stacks on disk.
    """
    recording = source.recording
    shape = work.stack_shape(recording.n_frames)
    phase, amplitude = shelf.new("wrapped", shape), shelf.new("amplitude", shape)
    blocks = blocks_of(shape)
    watch = Watch(len(blocks), "reconstruct", task)
    each = ReconstructBlock(source, work, phase, amplitude)
    shares, limits = zip(*workers.map(each, blocks, watch), strict=True)
    import dask.array as da  # which takes a tenth of a second

    # The values do not count here: these are the axes and notes.
    empty = da.broadcast_to(da.zeros(1, dtype=np.float32), shape)
    each_share = [share for of_block in shares for share in of_block]
    plan = work.as_dataset(recording, empty, empty, each_share)
    plan["phase"] = shelf.put("wrapped", plan["phase"], (-math.pi, math.pi))
    plan["amplitude"] = shelf.put("amplitude", plan["amplitude"], widest(limits))
    return plan


@dataclass(frozen=True)
class ReconstructBlock:
    """Reads, transforms and writes the frames of a block.

    Parameters
    ----------
    source : FrameSource
        The frames.
    work : FrameReconstructor
        What turns one into phase and amplitude.
    phase, amplitude : Stored
        Where they go.
    """

    source: FrameSource
    work: FrameReconstructor
    phase: Stored
    amplitude: Stored

    def __call__(self, block: Block) -> tuple[list[float], Limits]:
        """Do a block.

        Returns
        -------
        list of float, Limits
            What `FrameReconstructor` tells of each frame; smallest and largest amplitude.
        """
        phase = np.empty((len(block), *self.phase.shape[1:]), dtype=np.float32)
        amplitude = np.empty_like(phase)
        shares = [
            self.work.read(self.source, time, phase[i], amplitude[i])
            for i, time in enumerate(block.times)
        ]
        self.phase.write(block, phase)
        self.amplitude.write(block, amplitude)
        return shares, limits_of(amplitude)
