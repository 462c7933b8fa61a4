"""A camera that sees several sample beams and one reference beam at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.axes import WAVELENGTH
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation.ellipsoids import check_optics
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.words import check_type

__all__ = ["CARRIERS", "multiplexed_video"]

#: Two carriers whose lobes, beat and zero order have room next to each other.
CARRIERS = ((0.19, 0.21), (-0.21, 0.19))
#: 60x, numerical aperture 0.65, 632.8 nm, 5.2 um pixels: 0.65 / 0.6328 * 5.2 / 60.
PUPIL_RADIUS = 0.089
#: Brightest pixel as a share of the camera's range.
EXPOSURE = 0.9


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
    check_optics(optics)
    optics = optics or Optics()
    check_type("phase", phase, xr.DataArray, "give exact phase, as budding_yeast() makes it")
    if phase.ndim != 4:
        msg = f"phase has dims {tuple(phase.dims)}; it must have time, angle, y and x"
        raise ValueError(msg)
    n_times, n_angles, height, width = phase.shape
    amplitudes = [1.0] * n_angles if beam_amplitudes is None else list(beam_amplitudes)
    check_beams(n_angles, carriers, amplitudes, bits, unevenness)
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
