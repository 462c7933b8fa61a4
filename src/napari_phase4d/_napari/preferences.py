"""The user's own microscope, kept in napari's preferences."""

from __future__ import annotations

from typing import Any

from napari.settings import get_plugin_settings

from napari_phase4d.io import PROGRAM
from napari_phase4d.optics import REFRACTION_INCREMENT_ML_PER_G, Optics
from napari_phase4d.recording import Recording

__all__ = [
    "in_micrometres",
    "own_optics",
    "own_refraction_increment",
    "remember_optics",
    "with_own_optics",
]


def own_optics() -> Optics | None:
    """Return the microscope of the preferences, None if it was never changed there."""
    chosen = preferred("microscope")
    try:
        optics = Optics(
            in_micrometres(chosen.wavelength_nm),
            chosen.camera_pixel_um,
            chosen.magnification,
            chosen.medium_index,
        )
    except (AttributeError, TypeError, ValueError):  # no such settings, or edited by hand
        return None
    return None if optics == Optics() else optics


def with_own_optics(recording: Recording) -> Recording:
    """Return a recording that does not say its microscope with that of the preferences."""
    own = own_optics()
    if own is None or not any("microscope is not" in note for note in recording.notes):
        return recording
    return recording.calibrated(own)


def own_refraction_increment() -> float:
    """Return the refraction increment of the preferences in mL/g."""
    value = getattr(preferred("measuring"), "refraction_increment_ml_per_g", None)
    return float(value) if value else REFRACTION_INCREMENT_ML_PER_G


def remember_optics(optics: Optics) -> None:
    """Put a microscope into the preferences."""
    chosen = preferred("microscope")
    chosen.wavelength_nm = round(1000 * optics.wavelength_um, 6)
    chosen.camera_pixel_um = optics.camera_pixel_um
    chosen.magnification = optics.magnification
    chosen.medium_index = optics.medium_index


def in_micrometres(nanometres: float) -> float:
    """Return a length in micrometres, 632.8 nm as 0.6328 without a rest of rounding."""
    return round(nanometres / 1000, 9)


def preferred(group: str) -> Any:
    """Return one group of this plugin's preferences, None where napari has none."""
    try:
        return getattr(get_plugin_settings(PROGRAM), group)
    except (AttributeError, KeyError):
        return None
