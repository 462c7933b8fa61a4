"""Region growing: joining pixels along the cheapest steps first (reliability sorting).

`grow_grid` does it on grids of one to four dimensions, `grow_list` on any list of steps. Both run
compiled where that is possible, and give the same result where it is not.
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
from napari_phase4d.unwrapping.growing.plain import jumps
from napari_phase4d.unwrapping.growing.rows import PerThread, Workspace

__all__ = [
    "Contracted",
    "Costs",
    "CostsOf",
    "Joining",
    "PerThread",
    "Workspace",
    "closed",
    "coherence",
    "contracted",
    "grow_grid",
    "grow_list",
    "grow_through_residues",
    "jumps",
    "second_differences",
    "smooth_turns",
]
