"""Objects with exact phase, and the holograms that a camera would record of them."""

from napari_phase4d.simulation.cells import Budding, budding_yeast, swimming_euglena
from napari_phase4d.simulation.ellipsoids import Ellipsoid, phase_stack, pixels_of, projected_phase
from napari_phase4d.simulation.faults import FAULTS, with_fault, with_noise
from napari_phase4d.simulation.multiplexing import at_wavelengths, multiplexed_video, step_phantom
from napari_phase4d.simulation.populations import swimming_cells
from napari_phase4d.simulation.shapes import HARD_SHAPES, SHAPES, hard_shape, moving_shape

__all__ = [
    "FAULTS",
    "HARD_SHAPES",
    "SHAPES",
    "Budding",
    "Ellipsoid",
    "at_wavelengths",
    "budding_yeast",
    "hard_shape",
    "moving_shape",
    "multiplexed_video",
    "phase_stack",
    "pixels_of",
    "projected_phase",
    "step_phantom",
    "swimming_cells",
    "swimming_euglena",
    "with_fault",
    "with_noise",
]
