"""Numerical refocusing: what the light would look like in a plane before or behind the camera's.

The field is taken apart into plane waves (its *angular spectrum*), each gets the phase that it
gains on its way, and they are put together again (Goodman, Introduction to Fourier Optics, section
3.10). In a medium of index n, over a distance d, the wave with the transverse frequency (ky, kx)
gains d (sqrt(K^2 - ky^2 - kx^2) - K), where K = 2 pi n / wavelength: what a wave straight ahead
gains is left out, so that the empty field keeps its phase. Waves with ky^2 + kx^2 >= K^2 would be
evanescent and are cut off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.words import shown

__all__ = [
    "EDGES",
    "PixelSize",
    "Propagator",
    "check_light",
    "fields_walked",
    "pixel_sides",
    "propagate",
    "refocus_advice",
    "refocused",
]

#: How a field goes on beyond its edges.
EDGES = ("mirrored", "periodic")
#: Transfer functions that are kept: the frames of a video share one, as large as a frame.
KEPT = 1

PixelSize = float | Sequence[float]


class Propagator:
    """Carries fields of one size over one distance; several threads may use one.

    Mirrored edges need no more room than periodic ones: the mirrored field has a cosine
    transform, and the transfer function is even. They leave no jump at the edges, which would
    send out waves of its own, keep the energy in the frame, and come back exactly.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the fields in pixels.
    distance_um : float
        How far, in micrometres; positive in the direction of the light.
    wavelength_um : float
        Vacuum wavelength in micrometres, above 0.
    pixel_um : float or pair of float
        Pixel in the sample in micrometres, (y, x) if its sides differ, above 0.
    medium_index : float
        Refractive index round the object, at least 1.
    edges : str, optional
        How the field goes on beyond its edges: "mirrored" (default) or "periodic".
    keep : bool, optional
        Whether to keep what was worked out for the next one of the same kind (default True).

    Raises
    ------
    ValueError
        If a number is out of range or ``edges`` has no such value.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        distance_um: float,
        wavelength_um: float,
        pixel_um: PixelSize,
        medium_index: float,
        edges: str = "mirrored",
        *,
        keep: bool = True,
    ) -> None:
        if edges not in EDGES:
            msg = f"edges must be one of {', '.join(EDGES)}, but is {shown(edges)}"
            raise ValueError(msg)
        pixel = pixel_sides(pixel_um)
        check_light(distance_um, wavelength_um, medium_index)
        self.shape = (int(shape[0]), int(shape[1]))
        self.edges = edges
        self.distance_um = float(distance_um)
        worked_out = transfer_function if keep else transfer_function.__wrapped__
        self._transfer = worked_out(
            self.shape, self.distance_um, float(wavelength_um) / float(medium_index), pixel, edges
        )

    def __call__(self, fields: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
        """Return the fields in the other plane.

        Parameters
        ----------
        fields : ndarray of shape (..., y, x)
            Complex fields.

        Returns
        -------
        ndarray of shape (..., y, x)
            complex64.

        Raises
        ------
        ValueError
            If the fields have another size than this is made for.
        """
        if fields.shape[-2:] != self.shape:
            msg = f"the field is {fields.shape[-2:]} pixels, but {self.shape} were announced"
            raise ValueError(msg)
        if self.distance_um == 0:
            return np.array(fields, dtype=np.complex64)
        return self.from_spectrum(self.spectrum(fields))

    def spectrum(self, fields: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
        """Return the spectra of fields, which serve all distances."""
        fields = np.asarray(fields, dtype=np.complex64)
        if self.edges == "periodic":
            found: NDArray[np.complex64] = scipy.fft.fft2(fields)
        else:
            found = scipy.fft.dctn(fields, type=2, axes=(-2, -1))
        return found

    def from_spectrum(self, spectra: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Return the fields in the other plane from what `spectrum` returned."""
        moved = spectra * self._transfer
        if self.edges == "periodic":
            found: NDArray[np.complex64] = scipy.fft.ifft2(moved, overwrite_x=True)
        else:
            found = scipy.fft.idctn(moved, type=2, axes=(-2, -1), overwrite_x=True)
        return found


def propagate(
    field: NDArray[np.complexfloating],
    distance_um: float,
    wavelength_um: float,
    pixel_um: PixelSize,
    medium_index: float,
    *,
    edges: str = "mirrored",
) -> NDArray[np.complex64]:
    """Return a field as it is in a plane farther along the light, by its angular spectrum.

    Parameters
    ----------
    field : ndarray of shape (..., y, x)
        Complex field; the last two axes lie in the plane.
    distance_um : float
        How far, in micrometres in the medium; positive in the direction of the light.
    wavelength_um, pixel_um, medium_index, edges
        As in `Propagator`.

    Returns
    -------
    ndarray of shape (..., y, x)
        complex64. A plane wave straight ahead keeps its phase.

    Raises
    ------
    ValueError
        If the field is no image, or a number is out of range.
    """
    field = np.asarray(field)
    if field.ndim < 2 or not field.size:
        msg = f"a field has at least the axes (y, x), but this one has the shape {field.shape}"
        raise ValueError(msg)
    carry = Propagator(field.shape[-2:], distance_um, wavelength_um, pixel_um, medium_index, edges)
    return carry(field)


def refocused(
    ds: xr.Dataset,
    distance_um: float,
    *,
    medium_index: float | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Return a reconstruction as it is in a plane farther along the light.

    Parameters
    ----------
    ds : xarray.Dataset
        What `reconstruct` returns: ``phase`` wrapped, ``amplitude``, dims (time, angle, y, x);
        read a time at a time. What else it holds stays as it is.
    distance_um : float
        How far, in micrometres in the medium; positive in the direction of the light.
    medium_index : float, optional
        Refractive index round the object. Default: that of the recording.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each time; ``cancelled()`` stops the work.

    Returns
    -------
    xarray.Dataset
        Like ``ds``, with phase and amplitude in memory; ``attrs["refocus_um"]`` is how far it is
        from the camera's plane by now.

    Raises
    ------
    ValueError
        If ``ds`` has no amplitude, doesn't say the light, medium or pixel, or a number is out of
        range.
    Cancelled
        If ``cancelled()`` returned True.
    """
    task = Task(progress, cancelled)
    if "amplitude" not in ds or "phase" not in ds:
        msg = "refocusing needs phase and amplitude; give what reconstruct() returns"
        raise ValueError(msg)
    light = wavelengths_of(ds)
    missing = [
        name
        for name, known in (
            ("wavelength_um", light is not None),
            ("medium_index", medium_index is not None or "medium_index" in ds.attrs),
            ("y", "y" in ds.coords and ds.sizes["y"] > 1),
            ("x", "x" in ds.coords and ds.sizes["x"] > 1),
        )
        if not known
    ]
    if missing:
        msg = (
            f"refocusing needs {', '.join(missing)}, which the dataset does not have; "
            "give what reconstruct() returns"
        )
        raise ValueError(msg)
    assert light is not None
    index = ds.attrs["medium_index"] if medium_index is None else medium_index
    shape = (ds.sizes["y"], ds.sizes["x"])
    carry = {
        own: Propagator(shape, distance_um, own, pixel_of(ds), index)
        for own in dict.fromkeys(light.tolist())
    }
    phase, amplitude = (np.empty(ds[n].shape, np.float32) for n in ("phase", "amplitude"))

    def work(index: int) -> None:
        angles, sizes = (ds[n][index].values.astype(np.float32) for n in ("phase", "amplitude"))
        before = sizes * np.exp(1j * angles)
        if len(carry) == 1:
            fields = carry[light[0]](before)
        else:
            fields = np.stack([carry[own](view) for own, view in zip(light, before, strict=True)])
        np.abs(fields, out=amplitude[index])
        np.arctan2(fields.imag, fields.real, out=phase[index])

    watch = Watch(len(phase), "refocus", task)
    for _ in in_threads(work, range(len(phase)), watch):
        pass
    moved = ds.assign(
        phase=ds["phase"].copy(data=phase), amplitude=ds["amplitude"].copy(data=amplitude)
    )
    note = {"refocus_um": float(ds.attrs.get("refocus_um") or 0.0) + float(distance_um)}
    moved.attrs |= note
    for name in ("phase", "amplitude"):
        moved[name].attrs |= note
    return moved


#: Sine of the steepest angle that light is taken to come from.
STEEPEST = 0.95


def fields_walked(
    distance_um: float, finest: float, wavelength_um: float, medium_index: float, side_um: float
) -> float:
    """Return how far light walks aside while it is carried along, in sizes of the field.

    Detail of the transverse frequency f leaves at the sine f wavelength / n. Half of a disk of
    frequencies lies beyond 1 / sqrt(2) of its radius: looked at is the light on that ring. At 1,
    it comes from one whole field aside, where a mirrored edge stands for what nobody recorded;
    its phase in the transfer function, too, then changes by half a turn from one frequency to the
    next.

    Parameters
    ----------
    distance_um : float
        How far the field is carried, in micrometres in the medium.
    finest : float
        Radius of the disk of frequencies, in cycles per micrometre in the sample.
    wavelength_um : float
        Vacuum wavelength in micrometres.
    medium_index : float
        Refractive index round the object.
    side_um : float
        Shorter side of the field in micrometres.

    Returns
    -------
    float
        Above 1, most of what is seen can't have been recorded.
    """
    sine = min(finest / math.sqrt(2) * wavelength_um / medium_index, STEEPEST)
    return abs(distance_um) * sine / math.sqrt(1 - sine**2) / side_um


def refocus_advice(attrs: Mapping[str, Any]) -> str:
    """Say where a field was carried farther than it can hold; empty if it was not.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    walked = attrs.get("refocus_fields_walked", 0)
    if walked <= 1:
        return ""
    distance = attrs["refocus_um"]
    return (
        f"refocusing by {distance:.4g} um needs light from beyond the edges of the field, which "
        f"was not recorded: stay within {abs(distance) / walked:.2g} um"
    )


def pixel_of(ds: xr.Dataset | xr.DataArray) -> tuple[float, float]:
    """Return height and width of a pixel in micrometres."""
    return abs(float(ds["y"][1] - ds["y"][0])), abs(float(ds["x"][1] - ds["x"][0]))


def pixel_sides(pixel_um: PixelSize) -> tuple[float, float]:
    """Return (y, x) of a pixel size given as one number or two."""
    sides = np.broadcast_to(np.asarray(pixel_um, dtype=np.float64), 2)
    if not (np.isfinite(sides).all() and (sides > 0).all()):
        msg = f"pixel_um must be a size above 0, or two of them (y, x), but is {shown(pixel_um)}"
        raise ValueError(msg)
    return float(sides[0]), float(sides[1])


def check_light(distance_um: float, wavelength_um: float, medium_index: float) -> None:
    """Raise ValueError if there is no such distance, light or medium."""
    if not math.isfinite(distance_um):
        msg = f"distance_um must be a number of micrometres, but is {shown(distance_um)}"
        raise ValueError(msg)
    if not (math.isfinite(wavelength_um) and wavelength_um > 0):
        msg = f"wavelength_um must be a number above 0, but is {shown(wavelength_um)}"
        raise ValueError(msg)
    if not (math.isfinite(medium_index) and medium_index >= 1):
        msg = f"medium_index must be at least 1, but is {shown(medium_index)}"
        raise ValueError(msg)


@lru_cache(maxsize=KEPT)
def transfer_function(
    shape: tuple[int, int],
    distance_um: float,
    wavelength_in_medium_um: float,
    pixel_um: tuple[float, float],
    edges: str,
) -> NDArray[np.complex64]:
    """Return what to multiply the spectrum by, in the order of its frequencies.

    The phase is worked out in double precision, and without the difference of two large numbers
    that sqrt(K^2 - k^2) - K would be.
    """
    step = scipy.fft.fftfreq if edges == "periodic" else cosine_frequencies
    ky, kx = (2 * np.pi * step(n, d) for n, d in zip(shape, pixel_um, strict=True))
    whole = 2 * np.pi / wavelength_in_medium_um
    across = ky[:, None] ** 2 + kx[None, :] ** 2
    along = np.sqrt(np.maximum(whole**2 - across, 0))
    gained = -distance_um * across / (along + whole)
    transfer: NDArray[np.complex64] = np.where(across < whole**2, np.exp(1j * gained), 0).astype(
        np.complex64
    )
    transfer.flags.writeable = False
    return transfer


def cosine_frequencies(n: int, pixel_um: float) -> NDArray[np.float64]:
    """Return the frequencies of a cosine transform of n pixels, in cycles per micrometre."""
    return np.arange(n) / (2 * n * pixel_um)
