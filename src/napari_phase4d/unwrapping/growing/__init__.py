"""Region growing: joining pixels along the cheapest steps first (reliability sorting).

`grow_grid` does it on grids of one to four dimensions, `grow_list` on any list of steps,
`contracted` and `Joining` on grids that are given a block of frames at a time.
"""

from __future__ import annotations

from napari_phase4d.unwrapping.growing.contracting import Contracted, Joining, closed, contracted
from napari_phase4d.unwrapping.growing.costs import Costs, coherence, second_differences
from napari_phase4d.unwrapping.growing.growth import (
    CostsOf,
    grow_grid,
    grow_list,
    grow_through_residues,
    smooth_turns,
)
from napari_phase4d.unwrapping.growing.rows import Workspace, integrated

__all__ = [
    "Contracted",
    "Costs",
    "CostsOf",
    "Joining",
    "Workspace",
    "closed",
    "coherence",
    "contracted",
    "grow_grid",
    "grow_list",
    "grow_through_residues",
    "integrated",
    "second_differences",
    "smooth_turns",
]
