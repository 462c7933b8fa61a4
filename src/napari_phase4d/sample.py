"""Sample recordings and phases: simulated, so that their exact phase is known.

Each has a name, "sample:euglena", "sample:cells" and "sample:yeast", that stands in a recipe where
the name of a file would. It is simulated anew from fixed seeds, with the same numbers every time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import (
    budding_yeast,
    multiplexed_video,
    swimming_cells,
    swimming_euglena,
)

__all__ = [
    "CELLS",
    "CELLS_SOURCE",
    "EUGLENA",
    "EUGLENA_SOURCE",
    "RECORDINGS",
    "SAMPLES",
    "SAMPLE_PREFIX",
    "YEAST_SOURCE",
    "Sample",
    "cells_sample",
    "euglena_sample",
    "is_sample",
    "open_sample",
    "yeast_sample",
]

#: What the names of samples begin with, and all of them.
SAMPLE_PREFIX = "sample:"
EUGLENA_SOURCE = f"{SAMPLE_PREFIX}euglena"
CELLS_SOURCE = f"{SAMPLE_PREFIX}cells"
YEAST_SOURCE = f"{SAMPLE_PREFIX}yeast"
SAMPLES = (EUGLENA_SOURCE, CELLS_SOURCE, YEAST_SOURCE)

#: What a layer of the samples notes, so that they are known again.
EUGLENA, CELLS = "euglena", "cells"
SHAPE, CELLS_SHAPE = (512, 512), (512, 640)
N_TIMES = 40
#: Cells at the first frame; one divides, one leaves, one comes in.
N_CELLS = 5
#: Drift between the arms from frame to frame, as real interferometers have it.
DRIFT_RAD = 0.2
EUGLENA_ANGLES_DEG = (-7.0, 21.0)


#: Two lengths in micrometres, along y and x.
Lengths = tuple[float, float]


class Exact(Protocol):
    """Returns exact phase (time, angle, y, x) of frames of a height and width in pixels."""

    def __call__(
        self, shape: tuple[int, int], n_times: int, pixel_um: Lengths, first_um: Lengths
    ) -> xr.DataArray:
        """Pixels are so high and wide in micrometres, and the first one lies there."""


@dataclass(frozen=True)
class Sample:
    """A recording with what is known about it.

    Parameters
    ----------
    recording : Recording
        Hologram video of two multiplexed views.
    exact : callable
        ``exact(shape, n_times, pixel_um, first_um)``, see `Exact`.
    angles_deg : tuple of float
        Viewing angles, in the order in which `find_lobes` finds the views.
    boundary : tuple of int
        The optically thin frame (time, angle).
    """

    recording: Recording
    exact: Exact
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
        pixel = Optics().pixel_um  # as it was simulated with, whatever has been typed in since
        height, width = like.sizes["y"], like.sizes["x"]
        rows, columns = self.recording.frame_shape
        sides = (rows * pixel / height, columns * pixel / width)
        first = ((sides[0] - pixel) / 2, (sides[1] - pixel) / 2)  # each stands for its middle
        exact = self.exact((height, width), like.sizes["time"], sides, first)
        return exact.assign_coords(like.coords)


def euglena_sample() -> Sample:
    """Simulate the sample: a euglena seen at -7 and +21 degrees, 6 frames a second."""
    return sample_of(exact_euglena, SHAPE, EUGLENA_SOURCE, "euglena hologram video")


def cells_sample() -> Sample:
    """Simulate several cells that swim, touch, divide, leave and come in, seen likewise."""
    return sample_of(exact_cells, CELLS_SHAPE, CELLS_SOURCE, "hologram video of cells")


def sample_of(
    exact: Exact,
    shape: tuple[int, int],
    source: str,
    name: str,
) -> Sample:
    """Return a sample whose arms drift, as those of real interferometers do."""
    optics = Optics()
    phase = exact(shape, N_TIMES, (optics.pixel_um, optics.pixel_um), (0.0, 0.0))
    recording = multiplexed_video(phase, optics, drift_rad=DRIFT_RAD, name=name)
    return Sample(replace(recording, source=source), exact)


def exact_euglena(
    shape: tuple[int, int], n_times: int, pixel_um: Lengths, first_um: Lengths
) -> xr.DataArray:
    """Return the exact phase of the euglena."""
    data = swimming_euglena(shape, n_times, optics=Optics(), pixel_um=pixel_um, first_um=first_um)
    return data["phase"]


def exact_cells(
    shape: tuple[int, int], n_times: int, pixel_um: Lengths, first_um: Lengths
) -> xr.DataArray:
    """Return the exact phase of the cells, whose pixels must be squares."""
    data = swimming_cells(
        shape, n_times, N_CELLS, optics=Optics(), pixel_um=pixel_um[0], first_um=first_um
    )
    return data["phase"]


#: How the exact phase of each recording is simulated, by what its layer notes.
RECORDINGS = {EUGLENA: exact_euglena, CELLS: exact_cells}


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
        "sample:euglena" or "sample:cells" for a hologram video, "sample:yeast" for wrapped phase.
    optics, frame_rate_hz : Optics, float, optional
        Microscope and frames per second to take a hologram video for recorded with. Default:
        those that it was simulated with. Wrapped phase has its own pixel and times.

    Raises
    ------
    ValueError
        If there is no such sample.
    """
    if source in (EUGLENA_SOURCE, CELLS_SOURCE):
        recording = (euglena_sample() if source == EUGLENA_SOURCE else cells_sample()).recording
        as_simulated = optics is None and frame_rate_hz is None
        return recording if as_simulated else recording.calibrated(optics, frame_rate_hz)
    if source == YEAST_SOURCE:
        return yeast_sample()["wrapped"]
    msg = f"there is no sample {source!r}; the samples are {', '.join(SAMPLES)}"
    raise ValueError(msg)
