"""From which frames each line of frames is unwrapped (the paper's Fig. 1)."""

from __future__ import annotations

import numpy as np
import pytest

from napari_phase4d.unwrapping.chain import starts_on
from napari_phase4d.unwrapping.problem import Problem

BOUNDARIES = [(3, 1), (5, 0), (0, 1)]


@pytest.mark.parametrize(
    ("dim", "line", "starts"),
    [
        ("time", 0, [5]),  # a line with thin frames starts at its own
        ("time", 1, [0, 3]),
        ("time", 2, [0, 3, 5]),  # one without starts where the others do
        ("angle", 3, [1]),
        ("angle", 5, [0]),
        ("angle", 4, [0, 1]),
    ],
)
def test_lines_start_at_their_thin_frames(dim: str, line: int, starts: list[int]) -> None:
    assert starts_on(dim, line, BOUNDARIES) == starts


def test_boundaries_may_be_counted_from_the_end() -> None:
    problem = Problem(np.zeros((5, 4, 6, 6), np.float32), boundary=[(-2, -1), (1, -4), (3, 3)])
    assert problem.boundaries == [(3, 3), (1, 0)]
