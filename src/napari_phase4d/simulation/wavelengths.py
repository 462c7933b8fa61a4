"""The same object seen at several wavelengths, and steps that one wavelength can't tell."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from napari_phase4d.axes import AXES, WAVELENGTH, coordinate
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import check_asked, with_exact_phase, wrap
from napari_phase4d.stacks import KIND, WRAPPED, wavelength_coordinate, wavelengths_of
from napari_phase4d.words import as_numbers, check_number, check_type

__all__ = ["at_wavelengths", "step_phantom"]

#: Optical paths of the plates, in micrometres: from less than half a wavelength to 20 um.
PATHS_UM = (0.25, 0.6, 1.5, 4.0, 9.0, 20.0)


def at_wavelengths(
    data: xr.Dataset, wavelengths_um: Sequence[float], *, cauchy_um2: float = 0.0
) -> xr.Dataset:
    """Show an object at several wavelengths, each from all of its angles.

    Phase goes with 2 pi / wavelength times the optical path, and the path with the difference of
    the refractive indices, which is taken to depend on the wavelength as 1 + C / wavelength^2 (the
    first two terms of Cauchy's equation; Born & Wolf, section 2.3).

    Parameters
    ----------
    data : Dataset
        With exact ``phase`` in radians, dims (time, angle, y, x), at one wavelength, which its
        ``attrs["wavelength_um"]`` holds, as `step_phantom` or `swimming_euglena` makes it.
    wavelengths_um : sequence of float
        In micrometres, all different.
    cauchy_um2 : float, optional
        C in square micrometres, default 0: an object without dispersion. At the wavelength of
        the data the path stays as it is. Of protein in water it is about 0.003.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, float32; along the angle every angle is there once for
        each wavelength, and the coordinate ``wavelength`` holds these.

    Raises
    ------
    TypeError, ValueError
        If the data says no wavelength, or the wavelengths are not different lengths above 0.

    See Also
    --------
    multiplexed_video : Records them in one hologram.

    Examples
    --------
    >>> from napari_phase4d import simulation
    >>> two = simulation.at_wavelengths(simulation.step_phantom(), (0.6328, 0.532))
    >>> two["phase"].sizes["angle"], two["wavelength"].values.tolist()
    (2, [0.532, 0.6328])
    """
    check_type("data", data, xr.Dataset, 'give one with "phase", as step_phantom() does')
    exact = data["phase"]
    own = wavelengths_of(exact)
    if own is None or len(set(own)) > 1 or WAVELENGTH in exact.coords:
        msg = 'data must note its one wavelength, as attrs["wavelength_um"] of its phase'
        raise ValueError(msg)
    light = np.sort(as_numbers("wavelengths_um", wavelengths_um).astype(np.float64).ravel())
    if not len(light) or not (light > 0).all() or (np.diff(light) <= 0).any():
        msg = f"wavelengths_um must be different lengths above 0, but is {wavelengths_um!r}"
        raise ValueError(msg)
    bent = check_number("cauchy_um2", cauchy_um2)
    dispersion = (1 + bent / light**2) / (1 + bent / own[0] ** 2)
    scale = (own[0] / light * dispersion).astype(np.float32)
    n_times, n_angles, height, width = exact.shape
    values = exact.values[:, :, None] * scale[:, None, None]
    shape = (n_times, n_angles * len(light), height, width)
    angles = np.repeat(np.asarray(exact["angle"].values, np.float64), len(light))
    coords = {d: coordinate(d, exact[d].values) for d in ("time", "y", "x")}
    coords |= {
        "angle": coordinate("angle", angles),
        WAVELENGTH: wavelength_coordinate(np.tile(light, n_angles)),
    }
    attrs = {name: value for name, value in exact.attrs.items() if name != "wavelength_um"}
    phase = xr.DataArray(values.reshape(shape), dims=AXES, coords=coords, attrs=attrs)
    wrapped = wrap(phase)
    wrapped.attrs = {n: value for n, value in attrs.items() if n != "exact"} | {KIND: WRAPPED}
    return xr.Dataset({"phase": phase, "wrapped": wrapped})


def step_phantom(
    shape: tuple[int, int] = (96, 144),
    paths_um: Sequence[float] = PATHS_UM,
    n_times: int = 3,
    *,
    angles_deg: Sequence[float] = (0.0,),
    slope_um: float = 0.0,
    optics: Optics | None = None,
) -> xr.Dataset:
    """Simulate flat plates with sheer walls, side by side in an empty field.

    A wall is one step from pixel to pixel. Where it is higher than half a wavelength, no unwrapper
    that looks at one wavelength can tell by how much, whatever it looks at beside.

    Parameters
    ----------
    shape : tuple of int, optional
        Height and width in pixels.
    paths_um : sequence of float, optional
        Optical path difference of each plate against the empty field, in micrometres; default 0.25
        to 20.
    n_times : int, optional
        Number of frames, one a second; the plates move by a pixel from one to the next.
    angles_deg : sequence of float, optional
        Viewing angles in degrees; the path through a plate is longer by the cosine.
    slope_um : float, optional
        How much the path rises over each plate from left to right, in micrometres. Default 0.
    optics : Optics, optional
        Gives the wavelength and the pixel.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, dims (time, angle, y, x), radians; the attribute
        ``wavelength_um`` of both is that of the optics.

    Raises
    ------
    ValueError
        If the plates have no room.

    Examples
    --------
    >>> from napari_phase4d import simulation
    >>> exact = simulation.step_phantom(paths_um=(1.0,))["phase"]
    >>> round(float(exact.max()) * 0.6328 / 6.283185, 3)
    1.0
    """
    check_asked(shape, n_times, angles_deg, optics)
    optics = optics or Optics()
    columns = math.ceil(math.sqrt(len(paths_um) * shape[1] / shape[0]))
    rows = math.ceil(len(paths_um) / columns)
    cell_y, cell_x = shape[0] // (rows + 1), shape[1] // (columns + 1)
    if min(cell_y, cell_x) < 4 or n_times < 1:
        msg = (
            f"{len(paths_um)} plates have no room in {shape}; give a larger shape, or fewer paths"
        )
        raise ValueError(msg)
    path = np.zeros((n_times, *shape))
    for number, height in enumerate(paths_um):
        row, column = divmod(number, columns)
        # Plates and gaps of the same width, the first gap half of one.
        top, left = (
            int((2 * k + 1) * n / (2 * m + 1))
            for k, n, m in ((row, shape[0], rows), (column, shape[1], columns))
        )
        tall, wide = shape[0] // (2 * rows + 1), shape[1] // (2 * columns + 1)
        plate = height + slope_um * np.linspace(-0.5, 0.5, wide)
        path[:, top : top + tall, left : left + wide] = plate
    for time in range(n_times):
        path[time] = np.roll(path[time], time, axis=1)
    longer = 1 / np.cos(np.deg2rad(np.asarray(angles_deg, dtype=np.float64)))
    phase = 2 * np.pi / optics.wavelength_um * path[:, None] * longer[:, None, None]
    return with_exact_phase(
        phase,
        np.arange(n_times),
        angles_deg,
        (np.arange(shape[0]) * optics.pixel_um, np.arange(shape[1]) * optics.pixel_um),
        optics,
        {"object": "steps", "boundary": (0, 0)},
    )
