"""Fringe contrast against fringes that were made with it, and figures written whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from napari_phase4d.holography import fringe_contrast
from napari_phase4d.io import write_figure


@pytest.mark.parametrize("contrast", [0.05, 0.3, 0.9])
def test_contrast_of_a_sine(contrast: float) -> None:
    y, x = np.mgrid[:256, :320]
    uneven = 80 + 0.05 * x  # light that falls off to one side hardly counts
    fringes = uneven * (1 + contrast * np.cos(2 * np.pi * (0.19 * y + 0.23 * x)))
    assert fringe_contrast(fringes.astype(np.float32)) == pytest.approx(contrast, rel=0.05)


def test_contrast_of_nothing() -> None:
    assert fringe_contrast(np.zeros((64, 64), np.float32)) == 0
    assert fringe_contrast(np.full((64, 64), 9, np.float32)) == 0
    assert fringe_contrast(np.full((3, 5), 9, np.float32)) == 0


def test_figures_are_written_whole(tmp_path: Path) -> None:
    for name in ("a.png", "a.svg"):
        assert write_figure(tmp_path / name, Figure()).stat().st_size > 100
    with pytest.raises(ValueError, match=r"use one of \.png, \.svg, \.pdf"):
        write_figure(tmp_path / "a.txt", Figure())
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="could not be written"):
        write_figure(tmp_path / "file" / "a.png", Figure())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "a.svg", "file"]
