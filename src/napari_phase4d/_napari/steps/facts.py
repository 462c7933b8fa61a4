"""What a recording or wrapped phase is, in a few lines for the dock."""

from __future__ import annotations

import numpy as np
import xarray as xr

from napari_phase4d.recording import Recording

__all__ = ["facts_of_phase", "facts_of_recording"]

#: Share of saturated pixels that is worth a warning, and fringe contrast that is.
MANY_SATURATED, WEAK_FRINGES = 0.001, 0.05


def facts_of_recording(recording: Recording, contrast: float) -> str:
    """Return what a recording is: size, pixel, fringe contrast, and what to look after."""
    height, width = recording.frame_shape
    dtype = recording.holograms.dtype
    first = recording.frame(0)
    lines = [
        f"<b>{recording.name}</b>",
        f"{recording.n_frames} frames of {width} × {height} pixels, {dtype}, "
        f"{recording.nbytes / 2**20:.1f} MB",
        f"pixel in the sample {recording.optics.pixel_um:.4g} µm, fringe contrast {contrast:.2f}",
    ]
    if contrast < WEAK_FRINGES:
        lines.append("⚠ The fringes are weak; the phase will be noisy.")
    if dtype.kind in "iu":
        share = float((first >= np.iinfo(dtype).max).mean())
        if share > MANY_SATURATED:
            lines.append(f"⚠ {100 * share:.1f} % of the first frame is saturated.")
    lines += [f"⚠ {note}" for note in recording.notes]
    return "<br>".join(lines)


def facts_of_phase(phase: xr.DataArray, name: str) -> str:
    """Return what wrapped phase is, where there is no recording."""
    n_times, n_angles, height, width = phase.shape
    lines = [
        f"<b>{name}</b>",
        f"Wrapped phase: {n_times} times × {n_angles} views, {width} × {height} pixels. "
        "Go on with step 4.",
        *(f"⚠ {note}" for note in phase.attrs.get("notes", ())),
    ]
    return "<br>".join(lines)
