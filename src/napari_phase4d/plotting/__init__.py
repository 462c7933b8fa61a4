"""Figures and movies of recordings and results."""

from napari_phase4d.plotting.colours import (
    CURVE_COLOURS,
    OBJECT_COLOUR,
    colour_of,
    phase_colours,
    safety_colours,
)
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
    "CURVE_COLOURS",
    "EXACT",
    "OBJECT_COLOUR",
    "Circle",
    "colour_of",
    "comparison_figure",
    "look_figure",
    "movie_frames",
    "named_results",
    "phase_colours",
    "phase_limits",
    "safety_colours",
    "telling_frames",
]
