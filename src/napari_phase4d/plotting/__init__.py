"""Figures and movies of recordings and results, and colours that are told apart everywhere."""

from napari_phase4d.plotting.colours import (
    CURVE_COLOURS,
    OBJECT_COLOUR,
    colour_of,
    phase_colours,
    phase_limits,
    safety_colours,
)
from napari_phase4d.plotting.look import Circle, look_figure
from napari_phase4d.plotting.results import (
    EXACT,
    comparison_figure,
    movie_frames,
    named_results,
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
