"""Unwrapping methods behind one function."""

from napari_phase4d.unwrapping.boundaries import score_boundaries
from napari_phase4d.unwrapping.framewise import frame_by_frame
from napari_phase4d.unwrapping.masks import both_ends
from napari_phase4d.unwrapping.method import STACKS_OF_A_FRAME, Method, Option
from napari_phase4d.unwrapping.problem import DIMS, Problem, is_known
from napari_phase4d.unwrapping.registry import BUILT_IN, METHODS
from napari_phase4d.unwrapping.running import (
    all_options,
    check_method,
    label_of,
    noted,
    run_method,
    unwrap,
)
from napari_phase4d.unwrapping.sharing import SharedSteps
from napari_phase4d.unwrapping.spatial import border_medians
from napari_phase4d.unwrapping.warming import warm_up_elsewhere

__all__ = [
    "BUILT_IN",
    "DIMS",
    "METHODS",
    "STACKS_OF_A_FRAME",
    "Method",
    "Option",
    "Problem",
    "SharedSteps",
    "all_options",
    "border_medians",
    "both_ends",
    "check_method",
    "frame_by_frame",
    "is_known",
    "label_of",
    "noted",
    "run_method",
    "score_boundaries",
    "unwrap",
    "warm_up_elsewhere",
]
