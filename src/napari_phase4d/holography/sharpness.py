"""Published measures of how sharp an object is, by the amplitude of its field.

All three look at the amplitude of the refocused field, which has an extremum in focus. What is
seen there depends on the object: one that absorbs has most contrast in focus, one that only delays
the light has least, since it becomes invisible. So each measure has a maximum for one kind of
object and a minimum for the other:

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
from numpy.typing import NDArray

__all__ = ["FOCUS_METRICS", "Metric"]


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
