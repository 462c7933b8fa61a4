"""The sample recording: a simulated hologram video whose exact phase is known."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

__all__ = ["Sample", "euglena_sample"]

SHAPE = (512, 512)
N_TIMES = 40
#: Drift between the arms from frame to frame, as real interferometers have it.
DRIFT_RAD = 0.2


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
    angles_deg: tuple[float, ...]
    boundary: tuple[int, int]

    def truth(self, like: xr.DataArray) -> xr.DataArray:
        """Return the exact phase on the grid of a reconstruction (time, angle, y, x)."""
        pixel = self.recording.optics.pixel_um
        height, width = like.sizes["y"], like.sizes["x"]
        exact = swimming_euglena(
            (height, width),
            like.sizes["time"],
            optics=self.recording.optics,
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
    angles = tuple(float(v) for v in exact["angle"].values)
    return Sample(recording, angles, (0, 0))
