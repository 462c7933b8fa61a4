"""A fixed suite of 4-D recordings with exact truth, on which every installed method is scored."""

from napari_phase4d.benchmark.cases import GROUPS, SUITE_VERSION, Case, cases
from napari_phase4d.benchmark.scoring import (
    check_folder,
    run_benchmark,
    summary_of,
    write_benchmark,
)

__all__ = [
    "GROUPS",
    "SUITE_VERSION",
    "Case",
    "cases",
    "check_folder",
    "run_benchmark",
    "summary_of",
    "write_benchmark",
]
