"""The one place where a stack comes in: its names, order, units, coordinates, values and kind.

What is surely wrong is refused in one sentence that says what to do; what is probably wrong is
warned of once. All public functions that take phase, masks, regions or frames ask here.
"""

from napari_phase4d.stacks.coordinates import (
    AXES,
    PLAIN_AXES,
    UNITS,
    WAVELENGTH,
    check_pixel,
    check_rising,
    coordinate,
    doubt_numbers,
    factor_to,
    in_full,
    in_units,
    pixel_um,
    spacing,
    times_in_s,
    with_coordinates,
)
from napari_phase4d.stacks.entry import (
    as_stack,
    beside,
    checked_labels,
    doubts_of,
    in_all_axes,
    mask_on,
    on_grid_of,
    unwrapped_stack,
    without_masked,
    wrapped_stack,
)
from napari_phase4d.stacks.notes import (
    KIND,
    UNWRAPPED,
    WRAPPED,
    kind_of,
    wavelength_coordinate,
    wavelengths_of,
    with_light,
)
from napari_phase4d.stacks.numbers import Doubt, looks_wrapped

__all__ = [
    "AXES",
    "KIND",
    "PLAIN_AXES",
    "UNITS",
    "UNWRAPPED",
    "WAVELENGTH",
    "WRAPPED",
    "Doubt",
    "as_stack",
    "beside",
    "check_pixel",
    "check_rising",
    "checked_labels",
    "coordinate",
    "doubt_numbers",
    "doubts_of",
    "factor_to",
    "in_all_axes",
    "in_full",
    "in_units",
    "kind_of",
    "looks_wrapped",
    "mask_on",
    "on_grid_of",
    "pixel_um",
    "spacing",
    "times_in_s",
    "unwrapped_stack",
    "wavelength_coordinate",
    "wavelengths_of",
    "with_coordinates",
    "with_light",
    "without_masked",
    "wrapped_stack",
]
