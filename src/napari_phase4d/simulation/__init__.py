"""Objects with exact phase, and the holograms that a camera would record of them."""

from napari_phase4d.simulation.ellipsoids import Ellipsoid, projected_phase
from napari_phase4d.simulation.euglena import swimming_euglena
from napari_phase4d.simulation.faults import FAULTS, with_fault
from napari_phase4d.simulation.hard_shapes import HARD_SHAPES, hard_shape
from napari_phase4d.simulation.multiplexing import multiplexed_video
from napari_phase4d.simulation.shapes import SHAPES, moving_shape, with_noise
from napari_phase4d.simulation.stacks import phase_stack
from napari_phase4d.simulation.yeast import Budding, budding_yeast

__all__ = [
    "FAULTS",
    "HARD_SHAPES",
    "SHAPES",
    "Budding",
    "Ellipsoid",
    "budding_yeast",
    "hard_shape",
    "moving_shape",
    "multiplexed_video",
    "phase_stack",
    "projected_phase",
    "swimming_euglena",
    "with_fault",
    "with_noise",
]
