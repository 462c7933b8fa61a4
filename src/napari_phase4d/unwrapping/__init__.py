"""Unwrapping methods behind one function."""

from napari_phase4d.unwrapping.problem import DIMS, Problem
from napari_phase4d.unwrapping.registry import (
    METHODS,
    Method,
    Option,
    check_method,
    run_method,
    unwrap,
)

__all__ = [
    "DIMS",
    "METHODS",
    "Method",
    "Option",
    "Problem",
    "check_method",
    "run_method",
    "unwrap",
]
