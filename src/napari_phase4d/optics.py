"""The microscope: what turns pixels into micrometres, and phase into thickness and mass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.warned import warn
from napari_phase4d.words import (
    as_numbers,
    check_finite,
    check_number,
    check_positive,
    shown,
)

__all__ = [
    "REFRACTION_INCREMENT_ML_PER_G",
    "Optics",
    "optics_for_pixel",
    "pixel_note",
    "with_typed_numbers",
]

#: Refraction increment of cell material in mL/g, the usual value for protein
#: (Barer, Nature 169, 366, 1952).
REFRACTION_INCREMENT_ML_PER_G = 0.18
#: Beyond these, a wavelength or a camera pixel in micrometres is probably in nanometres.
LONG_WAVE_UM, LARGE_CAMERA_PIXEL_UM = 100.0, 500.0
#: Below this, both are probably in metres.
SHORT_UM = 1e-4
#: Nothing transparent bends light more.
LARGE_INDEX = 5.0
#: Width of a pixel in the sample: from an atomic nucleus to the earth, in micrometres.
LEAST_PIXEL_UM, LARGEST_PIXEL_UM = 1e-9, 1e13


@dataclass(frozen=True)
class Optics:
    """Wavelength, camera and magnification of a holographic microscope.

    The defaults are those of Dardikman, Singh & Shaked (2018), section 3: a helium-neon laser,
    a 5.2 um camera pixel and a 60x objective, in water.

    Parameters
    ----------
    wavelength_um : float
        Vacuum wavelength of the laser in micrometres, above 0.
    camera_pixel_um : float
        Pitch of the camera's square pixels in micrometres, above 0.
    magnification : float
        From the sample to the camera, above 0.
    medium_index : float
        Refractive index of the medium around the object, at least 1.

    Raises
    ------
    TypeError
        If it is no number.
    ValueError
        If a number is not finite or outside its range, or the pixel in the sample is absurd.

    Warns
    -----
    UserWarning
        If a length is probably in nanometres or metres, or the index is absurd.

    Examples
    --------
    >>> from napari_phase4d import Optics
    >>> Optics(magnification=52).pixel_um
    0.1
    """

    wavelength_um: float = 0.6328
    camera_pixel_um: float = 5.2
    magnification: float = 60.0
    medium_index: float = 1.333

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(field.name, getattr(self, field.name))
        for name in ("wavelength_um", "camera_pixel_um", "magnification"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                msg = f"{name} must be a number above 0, but is {shown(value)}"
                raise ValueError(msg)
        if not 0 < self.pixel_um < math.inf:
            msg = (
                f"camera_pixel_um / magnification is the pixel in the sample and must be a number "
                f"above 0, but is {shown(self.pixel_um)}"
            )
            raise ValueError(msg)
        if not LEAST_PIXEL_UM <= self.pixel_um <= LARGEST_PIXEL_UM:
            msg = (
                f"the pixel in the sample, camera_pixel_um / magnification, must be "
                f"{LEAST_PIXEL_UM:g} to {LARGEST_PIXEL_UM:g} um wide, but is {self.pixel_um:g}"
            )
            raise ValueError(msg)
        if not (math.isfinite(self.medium_index) and self.medium_index >= 1):
            msg = f"medium_index must be at least 1, but is {shown(self.medium_index)}"
            raise ValueError(msg)
        self._doubt()

    def _doubt(self) -> None:
        """Warn of numbers that are probably in another unit."""
        for name, most in (
            ("wavelength_um", LONG_WAVE_UM),
            ("camera_pixel_um", LARGE_CAMERA_PIXEL_UM),
        ):
            value = getattr(self, name)
            said = f"{name} is {value:g} micrometres; if that is in"
            if value > most:
                warn(f"{said} nanometres, give {name}={value / 1000:g}")
            elif value < SHORT_UM:
                warn(f"{said} metres, give {name}={value * 1e6:g}")
        if self.medium_index > LARGE_INDEX:
            warn(f"medium_index is {self.medium_index:g}, but water has 1.33 and glass 1.5")

    @property
    def pixel_um(self) -> float:
        """Width of one camera pixel in the sample, in micrometres."""
        return self.camera_pixel_um / self.magnification

    def optical_path_um(self, phase: ArrayLike) -> NDArray[Any]:
        """Return the optical path difference in micrometres: phase times wavelength / 2 pi.

        Parameters
        ----------
        phase : array_like
            Unwrapped phase in radians, any shape.

        Examples
        --------
        >>> path_um = Optics().optical_path_um([6.283185])  # one cycle
        >>> round(float(path_um[0]), 4)
        0.6328
        """
        return as_numbers("phase", phase) * (self.wavelength_um / (2 * np.pi))

    def height_um(self, phase: ArrayLike, object_index: float) -> NDArray[Any]:
        """Return the thickness in micrometres of an object of one refractive index.

        Parameters
        ----------
        phase : array_like
            Unwrapped phase in radians, any shape.
        object_index : float
            Refractive index of the object; must differ from that of the medium.

        Raises
        ------
        ValueError
            If the object has the index of the medium, so that phase says nothing of its height.

        Examples
        --------
        >>> height_um = Optics().height_um([6.283185], object_index=1.38)
        >>> round(float(height_um[0]), 2)
        13.46
        """
        contrast = check_finite("object_index", object_index) - self.medium_index
        if contrast == 0:
            msg = (
                f"object_index must differ from the medium's {self.medium_index}, "
                "or the height can't be told"
            )
            raise ValueError(msg)
        return self.optical_path_um(phase) / contrast

    def dry_mass_pg(
        self,
        phase: ArrayLike,
        pixel_area_um2: float,
        refraction_increment_ml_per_g: float = REFRACTION_INCREMENT_ML_PER_G,
    ) -> float:
        """Return the dry mass in picograms: optical path summed over area / refraction increment.

        Parameters
        ----------
        phase : array_like
            Unwrapped phase in radians over the object, background at 0; NaN counts as outside.
        pixel_area_um2 : float
            Area of one pixel in square micrometres.
        refraction_increment_ml_per_g : float, optional
            Default 0.18 mL/g (Barer 1952), which is 0.18 um^3/pg.

        Raises
        ------
        ValueError
            If the area or the increment is not above 0.

        Examples
        --------
        A hundred pixels of 0.01 um^2, of 1 rad each:

        >>> round(Optics().dry_mass_pg([1.0] * 100, pixel_area_um2=0.01), 2)
        0.56
        """
        for name, value in (
            ("pixel_area_um2", pixel_area_um2),
            ("refraction_increment_ml_per_g", refraction_increment_ml_per_g),
        ):
            if not (math.isfinite(check_number(name, value)) and value > 0):
                msg = f"{name} must be a number above 0, but is {shown(value)}"
                raise ValueError(msg)
        volume_um3 = float(np.nansum(self.optical_path_um(phase))) * pixel_area_um2
        return volume_um3 / refraction_increment_ml_per_g


def optics_for_pixel(pixel_um: float) -> Optics:
    """Return the paper's microscope with the magnification that gives this pixel."""
    base = Optics()
    return replace(base, magnification=base.camera_pixel_um / pixel_um)


def pixel_note(given_um: float, file_um: float | None, whose: str = "the file says") -> str:
    """Return a note that the pixel that was given is not that of the file; "" where it is.

    Pixels that differ by no more than 1 % count as the same.
    """
    if file_um is None or math.isclose(given_um, file_um, rel_tol=0.01):
        return ""
    return f"The pixel is {given_um:.4g} um wide as given; {whose} {file_um:.4g} um."


def with_typed_numbers(
    known: Optics, numbers: Mapping[str, float], pixel_um: float | None
) -> Optics:
    """Return a microscope with numbers that were typed in, and the pixel that a file names.

    Parameters
    ----------
    known : Optics
        What holds where nothing was typed in.
    numbers : mapping of str to float
        Fields of `Optics`.
    pixel_um : float or None
        Width of a pixel in the sample according to the file. It stays: of camera pixel and
        magnification the one follows from the other, unless both are typed in. None where the
        file says nothing of it, or what is known differs from it.
    """
    changes = dict(numbers)
    if pixel_um is not None and "magnification" not in numbers:
        camera_pixel_um = numbers.get("camera_pixel_um", known.camera_pixel_um)
        changes["magnification"] = camera_pixel_um / pixel_um
    elif pixel_um is not None and "camera_pixel_um" not in numbers:
        magnification = check_positive("magnification", numbers["magnification"])
        changes["camera_pixel_um"] = pixel_um * magnification
    return replace(known, **changes)
