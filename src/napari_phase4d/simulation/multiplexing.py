"""A camera that sees several sample beams at once, of one wavelength or of several."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation.ellipsoids import check_asked, with_exact_phase, wrap
from napari_phase4d.stacks import (
    AXES,
    KIND,
    WAVELENGTH,
    WRAPPED,
    coordinate,
    wavelength_coordinate,
    wavelengths_of,
)
from napari_phase4d.words import (
    advised_call,
    as_numbers,
    check_finite,
    shown,
)

__all__ = ["CARRIERS", "at_wavelengths", "multiplexed_video", "step_phantom"]

#: Two carriers whose lobes, beat and zero order have room next to each other.
CARRIERS = ((0.19, 0.21), (-0.21, 0.19))
#: 60x, numerical aperture 0.65, 632.8 nm, 5.2 um pixels: 0.65 / 0.6328 * 5.2 / 60.
PUPIL_RADIUS = 0.089
#: Brightest pixel as a share of the camera's range.
EXPOSURE = 0.9


@advised_call(
    phase="give exact phase, as budding_yeast() makes it", optics="give Optics(wavelength_um=...)"
)
def multiplexed_video(
    phase: xr.DataArray,
    optics: Optics | None = None,
    carriers: Sequence[tuple[float, float]] = CARRIERS,
    *,
    pupil_radius: float = PUPIL_RADIUS,
    beam_amplitudes: Sequence[float] | None = None,
    reference_amplitude: float = 1.5,
    bits: int = 8,
    full_well_electrons: float = 10_000,
    read_noise_electrons: float = 8.0,
    unevenness: float = 0.15,
    curvature_rad: float = 0.0,
    drift_rad: float = 0.0,
    seed: int = 0,
    name: str = "simulated hologram video",
) -> Recording:
    """Record sample beams and a reference beam on one camera.

    The frame is |R + sum_i S_i exp(2 pi i k_i r)|^2 with S_i = a_i P[exp(i phase_i)], P the
    objective's pupil, summed over the wavelengths if there are several: so all cross-correlation
    pairs of a wavelength appear, those of each sample beam with the reference at +-k_i, and those
    of the sample beams with each other ("beats") at k_i - k_j.
    Then come the camera's shot noise, read noise and quantisation.

    Parameters
    ----------
    phase : xarray.DataArray
        Exact phase, dims (time, angle, y, x), radians, on the camera's pixels; ``time`` in
        seconds. Its views may differ in the coordinate ``wavelength``, as `at_wavelengths` makes
        them: then each wavelength has a reference of its own, and beams interfere with those of
        their wavelength only.
    optics : Optics, optional
        The microscope, by default that of the paper.
    carriers : sequence of (ky, kx), optional
        One carrier for each view, in cycles per camera pixel. The lobe at +k holds +phase.
    pupil_radius : float, optional
        Radius of the pupil in cycles per camera pixel at the wavelength of the optics; default
        0.089, a numerical aperture of 0.65 in the paper's microscope. At other wavelengths the
        same aperture has a radius in inverse proportion.
    beam_amplitudes : sequence of float, optional
        Amplitude of each sample beam, default 1.
    reference_amplitude : float, optional
        Amplitude of the reference beam, default 1.5.
    bits : int, optional
        Depth of the camera, 1 to 16, default 8.
    full_well_electrons, read_noise_electrons : float, optional
        The camera: electrons at the top of its range, and standard deviation of its read noise.
    unevenness : float, optional
        How much darker the corners are than the middle, 0 to below 1, default 0.15.
    curvature_rad : float, optional
        Static defocus of the reference wave, in radians at the corner, default 0.
    drift_rad : float, optional
        Standard deviation of the step that the phase between the arms makes from frame to frame
        in radians, default 0. All views drift together, since they share the sample arm.
    seed : int, optional
        Of the noise and drift.
    name : str, optional
        Name of the recording.

    Returns
    -------
    Recording
        ``holograms`` uint8 or uint16; their attrs note carriers, angles and drift.

    Raises
    ------
    ValueError
        If a number is out of range or the carriers do not match the angles.

    See Also
    --------
    swimming_euglena : An object to record.
    find_lobes : Finds the carriers again.

    Examples
    --------
    >>> from napari_phase4d import simulation
    >>> exact = simulation.swimming_euglena(n_times=2)
    >>> rec = simulation.multiplexed_video(exact["phase"], bits=12, seed=1)
    >>> rec.holograms.shape, str(rec.holograms.dtype)
    ((2, 512, 512), 'uint16')
    """
    optics = optics or Optics()
    if set(phase.dims) != set(AXES):
        msg = f"phase has dims {tuple(phase.dims)}; it must have time, angle, y and x"
        raise ValueError(msg)
    phase = phase.transpose(*AXES)
    check_light_of(phase, optics)
    n_times, n_angles, height, width = phase.shape
    amplitudes = [1.0] * n_angles if beam_amplitudes is None else list(beam_amplitudes)
    check_beams(n_angles, carriers, amplitudes, bits, unevenness)
    for argument, value, most in (
        ("pupil_radius", pupil_radius, 1),
        ("reference_amplitude", reference_amplitude, 1e3),
        ("full_well_electrons", full_well_electrons, 1e12),
        ("read_noise_electrons", read_noise_electrons, 1e9),
        ("drift_rad", drift_rad, 1e6),
        ("seed", seed, 2**128),
    ):
        if not 0 <= check_finite(argument, value) <= most:
            msg = f"{argument} must be a number from 0 to {most:g}, but is {shown(value)}"
            raise ValueError(msg)
    check_finite("curvature_rad", curvature_rad)
    rng = np.random.default_rng(seed)
    envelope = uneven_beam((height, width), unevenness)
    light = wavelengths_of(phase) if WAVELENGTH in phase.coords else None
    colours = np.full(n_angles, optics.wavelength_um) if light is None else light
    radii = pupil_radius * optics.wavelength_um / colours
    pupils = [pupil_mask((height, width), radius) for radius in radii]
    tilts = [tilted_wave((height, width), k) for k in carriers]
    drift = drifting(drift_rad, n_times, rng)
    bent = np.exp(-1j * curvature_rad * radius_squared((height, width)))
    reference = reference_amplitude * envelope * bent
    # The brightest possible pixel: all beams of each wavelength in phase.
    together = [np.flatnonzero(colours == colour) for colour in np.unique(colours)]
    brightest = sum((reference_amplitude + sum(amplitudes[a] for a in v)) ** 2 for v in together)
    camera = Camera(bits, full_well_electrons, read_noise_electrons, brightest)
    video = np.empty((n_times, height, width), dtype=np.uint8 if bits <= 8 else np.uint16)
    for t in range(n_times):
        intensity = np.zeros((height, width))
        for views in together:
            total = reference * np.exp(-1j * drift[t])
            for a in views:
                field = np.exp(1j * phase.values[t, a].astype(np.float64))
                seen = scipy.fft.ifft2(scipy.fft.fft2(field) * pupils[a])
                total = total + amplitudes[a] * envelope * seen * tilts[a]
            intensity += np.abs(total) ** 2
        video[t] = camera.exposed(intensity, rng)
    return Recording.from_frames(
        video,
        optics=optics,
        times_s=np.asarray(phase["time"].values, dtype=np.float64),
        name=name,
        attrs={
            "carriers": [tuple(float(v) for v in k) for k in carriers],
            "angles_deg": [float(v) for v in phase["angle"].values],
            "pupil_radius": pupil_radius,
            "drift_rad": [float(v) for v in drift],
            **({} if light is None else {"wavelengths_um": light.tolist()}),
        },
    )


def check_light_of(phase: xr.DataArray, optics: Optics) -> None:
    """Refuse phase that notes another wavelength than the optics, which the recording will note.

    Its pixel is not looked at: simulated objects are drawn in pixels of any width.
    """
    noted = phase.attrs.get("wavelength_um")
    if WAVELENGTH in phase.coords or noted is None:
        return
    if not math.isclose(
        check_finite('attrs["wavelength_um"] of the phase', noted),
        optics.wavelength_um,
        rel_tol=1e-6,
    ):
        msg = (
            f"the phase is that of a wavelength of {noted:g} um, but the optics say "
            f"{optics.wavelength_um:g} um; give the optics that the phase was made for"
        )
        raise ValueError(msg)


@dataclass(frozen=True)
class Camera:
    """What counts electrons.

    Parameters
    ----------
    bits : int
        Depth.
    full_well_electrons, read_noise_electrons : float
        Electrons at the top of its range, and standard deviation of its read noise.
    brightest : float
        The intensity that it is set for.
    """

    bits: int
    full_well_electrons: float
    read_noise_electrons: float
    brightest: float

    def exposed(
        self, intensity: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return the grey values of a frame, with shot noise, read noise and quantisation."""
        electrons_per_unit = EXPOSURE * self.full_well_electrons / self.brightest
        counted = rng.poisson(intensity * electrons_per_unit)
        electrons = counted + rng.normal(0, self.read_noise_electrons, counted.shape)
        top = 2**self.bits - 1
        grey: NDArray[np.float64] = np.round(electrons / self.full_well_electrons * top)
        return np.clip(grey, 0, top)


def drifting(drift_rad: float, n_times: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the phase between the arms at every time: a random walk from 0."""
    if not drift_rad:
        return np.zeros(n_times)
    return np.concatenate([[0.0], np.cumsum(rng.normal(0, drift_rad, n_times - 1))])


def check_beams(
    n_angles: int,
    carriers: Sequence[tuple[float, float]],
    amplitudes: Sequence[float],
    bits: int,
    unevenness: float,
) -> None:
    """Raise ValueError if the beams do not fit the phase or the camera does not exist."""
    if len(carriers) != n_angles:
        msg = f"{len(carriers)} carriers were given for {n_angles} angles; give one each"
        raise ValueError(msg)
    if len(amplitudes) != n_angles:
        msg = f"{len(amplitudes)} beam_amplitudes were given for {n_angles} angles; give one each"
        raise ValueError(msg)
    if not 1 <= bits <= 16:
        msg = f"bits must lie between 1 and 16, but is {bits}"
        raise ValueError(msg)
    if not 0 <= unevenness < 1:
        msg = f"unevenness must be at least 0 and below 1, but is {unevenness}"
        raise ValueError(msg)


def radius_squared(shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the squared distance from the middle, 1 at the corners."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return (y[:, None] ** 2 + x[None, :] ** 2) / 2


def uneven_beam(shape: tuple[int, int], unevenness: float) -> NDArray[np.float64]:
    """Return a Gaussian beam's amplitude: 1 in the middle, 1 - unevenness at the corners."""
    envelope: NDArray[np.float64] = (1 - unevenness) ** radius_squared(shape)
    return envelope


def pupil_mask(shape: tuple[int, int], radius: float) -> NDArray[np.bool_]:
    """Return the frequencies that pass the objective, in the order of `fft2`."""
    ky, kx = (scipy.fft.fftfreq(n) for n in shape)
    mask: NDArray[np.bool_] = ky[:, None] ** 2 + kx[None, :] ** 2 <= radius**2
    return mask


def tilted_wave(shape: tuple[int, int], carrier: tuple[float, float]) -> NDArray[np.complex128]:
    """Return exp(2 pi i (ky y + kx x)) on the camera's pixels."""
    y, x = (np.arange(n) for n in shape)
    return np.outer(np.exp(2j * np.pi * carrier[0] * y), np.exp(2j * np.pi * carrier[1] * x))


# ---- several wavelengths, and steps that one can't tell -------------------------------------


#: Optical paths of the plates, in micrometres: from less than half a wavelength to 20 um.
PATHS_UM = (0.25, 0.6, 1.5, 4.0, 9.0, 20.0)


@advised_call(data='give one with "phase", as step_phantom() does')
def at_wavelengths(
    data: xr.Dataset, wavelengths_um: Iterable[float], *, cauchy_um2: float = 0.0
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
    wavelengths_um : iterable of float
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
    if "phase" not in data:
        msg = f'data holds {", ".join(map(str, data)) or "nothing"}, but no exact "phase"'
        raise ValueError(msg)
    exact = data["phase"]
    own = wavelengths_of(exact)
    if own is None or len(set(own)) > 1 or WAVELENGTH in exact.coords:
        msg = 'data must note its one wavelength, as attrs["wavelength_um"] of its phase'
        raise ValueError(msg)
    wavelengths_um = list(wavelengths_um)
    light = np.sort(as_numbers("wavelengths_um", wavelengths_um).astype(np.float64).ravel())
    if not len(light) or not (light > 0).all() or (np.diff(light) <= 0).any():
        msg = f"wavelengths_um must be different lengths above 0, but is {shown(wavelengths_um)}"
        raise ValueError(msg)
    bent = float(cauchy_um2)
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
    if len(paths_um) == 0:
        msg = "paths_um must be lengths in micrometres, one for each plate, but is empty"
        raise ValueError(msg)
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
