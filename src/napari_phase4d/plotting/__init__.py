"""Figures and movies of recordings and results."""

from napari_phase4d.plotting.figures import (
    EXACT,
    Circle,
    comparison_figure,
    look_figure,
    movie_frames,
    named_results,
    phase_limits,
    telling_frames,
)

__all__ = [
    "EXACT",
    "Circle",
    "comparison_figure",
    "look_figure",
    "movie_frames",
    "named_results",
    "phase_limits",
    "telling_frames",
]
