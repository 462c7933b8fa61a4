"""Sample recordings and phases: simulated, so that their exact phase is known.

Each has a name, "sample:euglena" and "sample:yeast", that stands in a recipe where the name of a
file would. It is simulated anew from fixed seeds, with the same numbers every time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import xarray as xr

from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import budding_yeast, multiplexed_video, swimming_euglena

__all__ = [
    "EUGLENA",
    "EUGLENA_SOURCE",
    "SAMPLES",
    "SAMPLE_PREFIX",
    "YEAST_SOURCE",
    "Sample",
    "euglena_sample",
    "is_sample",
    "open_sample",
    "yeast_sample",
]

#: What the names of samples begin with, and all of them.
SAMPLE_PREFIX = "sample:"
EUGLENA_SOURCE = f"{SAMPLE_PREFIX}euglena"
YEAST_SOURCE = f"{SAMPLE_PREFIX}yeast"
SAMPLES = (EUGLENA_SOURCE, YEAST_SOURCE)

#: What a layer of the sample notes, so that it is known again.
EUGLENA = "euglena"
SHAPE = (512, 512)
N_TIMES = 40
#: Drift between the arms from frame to frame, as real interferometers have it.
DRIFT_RAD = 0.2
EUGLENA_ANGLES_DEG = (-7.0, 21.0)


@dataclass(frozen=True)
class Sample:
    """A recording with what is known about it.

    Parameters
    ----------
    recording : Recording
        Hologram video of two multiplexed views.
    angles_deg : tuple of float
        Viewing angles, in the order in which `find_lobes` finds the views.
    boundary : tuple of int
        The optically thin frame (time, angle).
    """

    recording: Recording
    angles_deg: tuple[float, ...] = EUGLENA_ANGLES_DEG
    boundary: tuple[int, int] = (0, 0)

    def truth(self, like: xr.DataArray) -> xr.DataArray:
        """Return the exact phase on the grid of a reconstruction (time, angle, y, x).

        Raises
        ------
        ValueError
            If the reconstruction has other viewing angles.
        """
        if tuple(like["angle"].values) != self.angles_deg:
            msg = f"the exact phase is known at {self.angles_deg} degrees only"
            raise ValueError(msg)
        optics = Optics()  # those it was simulated with, whatever has been typed in since
        pixel = optics.pixel_um
        height, width = like.sizes["y"], like.sizes["x"]
        exact = swimming_euglena(
            (height, width),
            like.sizes["time"],
            optics=optics,
            pixel_um=(SHAPE[0] * pixel / height, SHAPE[1] * pixel / width),
        )
        return exact["phase"].assign_coords(like.coords)


def euglena_sample() -> Sample:
    """Simulate the sample: a euglena seen at -7 and +21 degrees, 6 frames a second."""
    optics = Optics()
    exact = swimming_euglena(SHAPE, N_TIMES, optics=optics)
    recording = multiplexed_video(
        exact["phase"], optics, drift_rad=DRIFT_RAD, name="euglena hologram video"
    )
    return Sample(replace(recording, source=EUGLENA_SOURCE))


def yeast_sample() -> xr.Dataset:
    """Simulate the other sample: a budding yeast's ``phase``, exact, and ``wrapped``."""
    data = budding_yeast()
    data["wrapped"].attrs["source"] = YEAST_SOURCE
    return data


def is_sample(source: str) -> bool:
    """Say whether a recording's name is meant as that of a sample, known or not."""
    return source.startswith(SAMPLE_PREFIX)


def open_sample(
    source: str, optics: Optics | None = None, frame_rate_hz: float | None = None
) -> Recording | xr.DataArray:
    """Return the recording, or the wrapped phase, that a sample's name stands for.

    Parameters
    ----------
    source : str
        "sample:euglena" for a hologram video, "sample:yeast" for wrapped phase.
    optics, frame_rate_hz : Optics, float, optional
        Microscope and frames per second to take a hologram video for recorded with. Default:
        those that it was simulated with. Wrapped phase has its own pixel and times.

    Raises
    ------
    ValueError
        If there is no such sample.
    """
    if source == EUGLENA_SOURCE:
        recording = euglena_sample().recording
        as_simulated = optics is None and frame_rate_hz is None
        return recording if as_simulated else recording.calibrated(optics, frame_rate_hz)
    if source == YEAST_SOURCE:
        return yeast_sample()["wrapped"]
    msg = f"there is no sample {source!r}; the samples are {' and '.join(SAMPLES)}"
    raise ValueError(msg)
