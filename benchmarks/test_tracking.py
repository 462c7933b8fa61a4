"""The same speeds in a form that can be compared over versions (pytest-benchmark).

``python3 dev.py bench --track`` saves a run and compares it with the one before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from holography import LOBES, SHAPE
from scenes import frame, moving_cells

import napari_phase4d as p4d
from napari_phase4d.holography import Demodulator
from napari_phase4d.simulation import swimming_cells
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.unwrapping.growing import Workspace, grow_grid

Benchmark = Callable[..., Any]


@pytest.mark.parametrize("kind", ["gentle", "noise 0.5 rad", "steep", "noise 0.9 rad"])
def test_one_frame(benchmark: Benchmark, kind: str) -> None:
    benchmark(grow_grid, frame(kind, (512, 512), 0), work=Workspace())


@pytest.mark.parametrize("method", methods_for(None))
def test_method(benchmark: Benchmark, method: str) -> None:
    volume = moving_cells(10, 3, 96, 0.4)
    p4d.unwrap(volume[:2], method)
    benchmark(p4d.unwrap, volume, method)


def test_demodulation(benchmark: Benchmark) -> None:
    hologram = np.random.default_rng(0).integers(0, 255, SHAPE).astype(np.uint8)
    benchmark(Demodulator(SHAPE, LOBES), hologram)


def test_cells(benchmark: Benchmark) -> None:
    """Twenty frames of two views of 14 cells each, at the size that masses are told at."""
    shape = (288, 360)
    data = swimming_cells(shape, 20, 14, divisions=2, leaving=2, entering=2)["phase"]
    noise = np.random.default_rng(0).normal(0, 0.3, data.shape).astype(np.float32)
    benchmark(p4d.find_cells, data.copy(data=data.values + noise))
