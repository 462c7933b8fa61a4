"""Work that is cancelled inside a long line of frames goes no further."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from napari_phase4d.progress import THREADS, Cancelled
from napari_phase4d.unwrapping.four_d import one_pass


def test_a_line_ends_at_the_next_frame() -> None:
    """The threads look up by themselves: what calls them has long gone on."""
    wrapped = np.random.default_rng(0).uniform(-3, 3, (12, 1, 8, 8)).astype(np.float32)
    result = np.full_like(wrapped, np.nan)
    with pytest.raises(Cancelled):
        one_pass(
            "time", wrapped, wrapped, np.ones(wrapped.shape, bool), result, [(0, 0)],
            None, lambda: bool(np.isfinite(result[3]).all()), split=False,
        )  # fmt: skip
    for thread in threading.enumerate():
        if thread.name.startswith(THREADS):
            thread.join(timeout=20)
    done = np.isfinite(result).all(axis=(1, 2, 3))
    assert done.tolist() == [True] * 4 + [False] * 8
