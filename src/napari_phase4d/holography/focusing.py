"""Autofocus: in which plane the object is sharp, by published measures.

All three measures look at the amplitude of the refocused field, which has an extremum in focus.
What is seen there depends on the object: one that absorbs has most contrast in focus, one that
only delays the light has least, since it becomes invisible. So each measure has a maximum for one
kind of object and a minimum for the other:

* "dubois": the integrated amplitude, least in focus for amplitude objects and greatest for phase
  objects (Dubois, Schockaert, Callens, Yourassowsky, Optics Express 14, 5895, 2006);
* "tamura": sqrt(standard deviation / mean) of the intensity, Tamura's coefficient of contrast,
  greatest in focus for amplitude objects (Memmolo et al., Optics Letters 36, 1945, 2011);
* "gradient": the mean squared gradient, greatest in focus for amplitude objects (Tenenbaum's
  measure; compared with fourteen others by Fonseca et al., Applied Optics 55, 7663, 2016).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.emptyfield import background_offset
from napari_phase4d.holography.refocusing import PixelSize, Propagator, check_light, pixel_sides
from napari_phase4d.later import xr
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.words import shown

__all__ = ["FOCUS_METRICS", "FOCUS_OBJECTS", "Focus", "autofocus", "depth_of_focus_um"]


@dataclass(frozen=True)
class Metric:
    """A measure of sharpness.

    Parameters
    ----------
    score : callable
        Amplitude (y, x) -> number.
    greatest_for : str
        The objects for which it is greatest in focus, "phase" or "amplitude".
    """

    score: Callable[[NDArray[np.float32]], float]
    greatest_for: str

    def sign(self, objects: str) -> float:
        """Return +1 if it is greatest in focus for such objects, else -1."""
        return 1.0 if objects == self.greatest_for else -1.0


def integrated_amplitude(amplitude: NDArray[np.float32]) -> float:
    """Return the mean amplitude over its root mean square, which refocusing leaves as it is."""
    power = float(np.mean(np.square(amplitude), dtype=np.float64))
    return float(amplitude.mean(dtype=np.float64)) / math.sqrt(power) if power else 0.0


def tamura_coefficient(amplitude: NDArray[np.float32]) -> float:
    """Return sqrt(standard deviation / mean) of the intensity."""
    intensity = np.square(amplitude)
    mean = float(intensity.mean(dtype=np.float64))
    return math.sqrt(float(intensity.std(dtype=np.float64)) / mean) if mean else 0.0


def mean_squared_gradient(amplitude: NDArray[np.float32]) -> float:
    """Return the mean squared step between neighbours, over the squared mean amplitude."""
    mean = float(amplitude.mean(dtype=np.float64))
    steps = sum(float(np.mean(np.square(np.diff(amplitude, axis=i)))) for i in (0, 1))
    return steps / mean**2 if mean else 0.0


#: Measures of sharpness by their names.
FOCUS_METRICS = MappingProxyType(
    {
        "dubois": Metric(integrated_amplitude, "phase"),
        "tamura": Metric(tamura_coefficient, "amplitude"),
        "gradient": Metric(mean_squared_gradient, "amplitude"),
    }
)


#: Kinds of objects that a search may be told of.
FOCUS_OBJECTS = ("auto", "phase", "amplitude")
#: How far a search goes to either side if it is not told, in depths of focus ...
USUAL_SPAN = 40
#: ... and how many planes it looks at within one.
PLANES_PER_DEPTH = 1.0
#: No search looks at fewer or more planes before it refines.
FEWEST_PLANES, MOST_PLANES = 41, 401
#: Share of the field that is faded out at each edge.
FADED_SHARE = 1 / 8
#: How exact the refined distance is, as a share of the step between planes.
EXACT_SHARE = 1e-3


@dataclass(frozen=True)
class Focus:
    """Where an object is sharp.

    Parameters
    ----------
    distance_um : float
        How far to refocus, in micrometres; positive in the direction of the light.
    objects : str
        What the object was taken for: "phase" or "amplitude".
    metric : str
        The measure.
    scores : xarray.DataArray
        The measure over ``distance`` in micrometres, as it is: greatest in focus or least, see
        `FOCUS_METRICS`.
    at_the_end : bool
        Whether the extremum lies at an end of the search, so that the focus may lie beyond.
    """

    distance_um: float
    objects: str
    metric: str
    scores: xr.DataArray
    at_the_end: bool = False


def autofocus(
    field: NDArray[np.complexfloating],
    wavelength_um: float,
    pixel_um: PixelSize,
    medium_index: float,
    *,
    span_um: float | tuple[float, float] | None = None,
    metric: str = "dubois",
    objects: str = "auto",
    region: tuple[slice, slice] | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Focus:
    """Find the distance at which an object is sharp.

    The measure is worked out in evenly spaced planes, one a depth of focus, and its extremum is
    then refined between the neighbouring planes (Brent's method). An eighth of the field is faded
    into the background at each edge first: a cut-out lobe rings there, and that is sharpest in
    the camera's plane, wherever the object is.

    Parameters
    ----------
    field : ndarray of shape (..., y, x)
        Complex field, with its background as flat as it can be had. Several fields, such as
        frames or views, give one distance: their measures are averaged.
    wavelength_um, pixel_um, medium_index : float
        As in `propagate`.
    span_um : float or pair of float, optional
        How far to look: so many micrometres to either side, or from the first number to the
        second. Default: 40 depths of focus to either side.
    metric : str, optional
        "dubois" (default), "tamura" or "gradient".
    objects : str, optional
        "phase", "amplitude", or "auto" (default): the kind whose extremum stands out more
        from what is on both its sides.
    region : pair of slice, optional
        Rows and columns to look at, where not all of the field is to count. Default: all.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each plane; ``cancelled()`` stops the search.

    Returns
    -------
    Focus
        Distance, kind of object, and the measure over distance.

    Raises
    ------
    ValueError
        If a setting has no such value or a number is out of range.
    Cancelled
        If ``cancelled()`` returned True.
    """
    task = Task(progress, cancelled)
    fields = checked_fields(field)
    check_choices(metric, objects)
    check_light(0.0, wavelength_um, medium_index)
    pixel = pixel_sides(pixel_um)
    depth = depth_of_focus_um(wavelength_um, pixel, medium_index)
    distances = planes(checked_span(span_um, depth), depth)
    measure = FOCUS_METRICS[metric]
    light = (float(wavelength_um), pixel, float(medium_index))
    part = region or (slice(None), slice(None))
    if not fields[0][part].size:
        msg = f"region holds no pixel of a field of {fields.shape[-2:]} pixels"
        raise ValueError(msg)
    watch = Watch(len(distances), "looking for the focus", task)
    here = Propagator(fields.shape[-2:], 0.0, *light, keep=False)
    spectra = [here.spectrum(with_faded_edges(one)) for one in fields]

    def score(distance: float) -> float:
        carry = Propagator(fields.shape[-2:], distance, *light, keep=False)
        total = 0.0
        for spectrum in spectra:
            watch.check()
            total += measure.score(np.abs(carry.from_spectrum(spectrum)[part]))
        return total / len(spectra)

    scores = np.empty(len(distances))
    for i, distance in enumerate(distances):
        scores[i] = score(float(distance))
        watch.step()
    kind = objects if objects != "auto" else kind_of_object(scores, measure)
    sign = measure.sign(kind)
    best = int(np.argmax(sign * scores))
    return Focus(
        refined(lambda d: -sign * score(d), distances, best),
        kind,
        metric,
        as_curve(scores, distances, metric, kind),
        at_the_end=best in (0, len(distances) - 1),
    )


def depth_of_focus_um(wavelength_um: float, pixel_um: PixelSize, medium_index: float) -> float:
    """Return the depth of focus in micrometres of the finest detail that pixels can hold.

    The refocused field changes little within n wavelength / NA^2 (Born & Wolf, section 8.8), where
    the pixels hold a numerical aperture NA of wavelength / (2 pixel), and the medium one of n.

    Parameters
    ----------
    wavelength_um : float
        Vacuum wavelength in micrometres.
    pixel_um : float or sequence of float
        Size of a pixel in the sample in micrometres, or its (y, x); the larger side counts.
    medium_index : float
        Refractive index of the medium, at least 1.

    Returns
    -------
    float
        In micrometres along the light, in the medium.
    """
    aperture = min(wavelength_um / (2 * max(pixel_sides(pixel_um))), medium_index)
    return medium_index * wavelength_um / aperture**2


def checked_fields(field: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
    """Return fields as (field, y, x)."""
    fields = np.asarray(field, dtype=np.complex64)
    if fields.ndim < 2 or min(fields.shape[-2:]) < 2:
        msg = f"a field has at least the axes (y, x), but this one has the shape {fields.shape}"
        raise ValueError(msg)
    return fields.reshape(-1, *fields.shape[-2:])


def with_faded_edges(field: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return a field that goes over into its empty background towards its edges."""
    level = np.median(np.abs(field)) * np.exp(1j * background_offset(field))
    rows, columns = (fading(n) for n in field.shape)
    faded: NDArray[np.complex64] = (
        level + (field - level) * (rows[:, None] * columns[None, :])
    ).astype(np.complex64)
    return faded


def fading(n: int) -> NDArray[np.float64]:
    """Return 1 in the middle and a cosine down to 0 at both ends of n pixels."""
    to_the_end = np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5
    inside = np.clip(to_the_end / (FADED_SHARE * n), 0, 1)
    found: NDArray[np.float64] = 0.5 - 0.5 * np.cos(np.pi * inside)
    return found


def check_choices(metric: str, objects: str) -> None:
    """Raise ValueError if there is no such measure or kind of object."""
    for name, value, known in (
        ("metric", metric, tuple(FOCUS_METRICS)),
        ("objects", objects, FOCUS_OBJECTS),
    ):
        if value not in known:
            msg = f"{name} must be one of {', '.join(known)}, but is {shown(value)}"
            raise ValueError(msg)


def checked_span(
    span_um: float | tuple[float, float] | None, depth_um: float
) -> tuple[float, float]:
    """Return the first and the last distance of a search."""
    if span_um is None:
        span_um = USUAL_SPAN * depth_um
    ends = np.asarray(span_um, dtype=np.float64)
    first, last = (-float(ends), float(ends)) if ends.ndim == 0 else (float(e) for e in ends)
    if not (math.isfinite(first) and math.isfinite(last) and first < last):
        msg = (
            "span_um must be a distance above 0, or a lower and an upper one, but is "
            f"{shown(span_um)}"
        )
        raise ValueError(msg)
    return first, last


def planes(span_um: tuple[float, float], depth_um: float) -> NDArray[np.float64]:
    """Return the distances to look at first: about one a depth of focus."""
    wanted = round(PLANES_PER_DEPTH * (span_um[1] - span_um[0]) / depth_um) + 1
    return np.linspace(*span_um, int(np.clip(wanted, FEWEST_PLANES, MOST_PLANES)))


def kind_of_object(scores: NDArray[np.float64], measure: Metric) -> str:
    """Return the kind of object whose extremum stands out more from what is on both its sides."""
    greatest = measure.greatest_for
    least = "amplitude" if greatest == "phase" else "phase"
    return greatest if prominence(scores) >= prominence(-scores) else least


def prominence(scores: NDArray[np.float64]) -> float:
    """Return how far one has to go down from the maximum on both sides, 0 if it is at an end."""
    top = int(scores.argmax())
    return float(scores[top] - max(scores[: top + 1].min(), scores[top:].min()))


def refined(cost: Callable[[float], float], distances: NDArray[np.float64], best: int) -> float:
    """Return the distance of least cost between the neighbours of the best plane."""
    low, high = distances[max(best - 1, 0)], distances[min(best + 1, len(distances) - 1)]
    step = float(distances[1] - distances[0])
    found = scipy.optimize.minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": EXACT_SHARE * step}
    )
    return float(found.x)


def as_curve(
    scores: NDArray[np.float64], distances: NDArray[np.float64], metric: str, objects: str
) -> xr.DataArray:
    """Give the measure its axis."""
    return xr.DataArray(
        scores,
        dims=("distance",),
        coords={"distance": ("distance", distances, {"units": "um"})},
        name=metric,
        attrs={"metric": metric, "objects": objects},
    )
