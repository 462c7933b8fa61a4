"""Work that is cancelled inside a long line of frames goes no further."""

from __future__ import annotations

import numpy as np
import pytest

from napari_phase4d.stack import InMemory
from napari_phase4d.task import Cancelled, Task, Watch
from napari_phase4d.unwrapping.chain import Chain, along_time
from napari_phase4d.unwrapping.given import as_given


def test_a_line_ends_at_the_next_frame(threads_end) -> None:
    """The threads look up by themselves: what calls them has long gone on."""
    wrapped = np.random.default_rng(0).uniform(-3, 3, (12, 1, 8, 8)).astype(np.float32)
    nothing = np.zeros(wrapped.shape, np.int16)
    result = np.full(wrapped.shape, -99, np.int16)
    mask, shifts = InMemory(np.ones(wrapped.shape, bool)), np.zeros((12, 1, 2), np.intp)
    chain = Chain(as_given(wrapped), mask, shifts, [(0, 0)], split=False)
    watch = Watch(1, "", Task(None, lambda: bool((result[3] > -99).all())))
    with pytest.raises(Cancelled):
        along_time(chain, InMemory(nothing), InMemory(result), watch)
    threads_end()
    done = (result > -99).all(axis=(1, 2, 3))
    assert done.tolist() == [True] * 4 + [False] * 8
