"""What tests need besides fixtures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

MEASURED = Path(__file__).resolve().parents[2] / "shared" / "data"


def measured(name: str) -> Path:
    """Return a measured file, or skip the test."""
    path = MEASURED / name
    if not path.exists():
        pytest.skip(f"measured data {name} is not part of the repository and not on this machine")
    return path


def wrap(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(phase)))
