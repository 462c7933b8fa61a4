"""How noisy phase and amplitude are, where the field is empty: in time and in space."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.later import pd, xr
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.words import as_numbers, checked_call, shown

__all__ = ["noise_figures", "noise_sentence", "with_wavelength"]

#: Frames that are looked at, spread over the recording; each with the one after it.
FRAMES = 24
#: Width in pixels of the Gaussian that the field is smoothed with to see where it is empty, ...
SMOOTHING = 2.0
#: ... how far its phase may then lie from the level, in radians, ...
FLAT_RAD = 0.5
#: ... and how many pixels at the rim of what is not empty are left out.
RIM = 3
#: This share of the frame is left out at each edge, where a cut-out lobe rings.
MARGIN_SHARE = 1 / 16
#: A smaller share of empty field says nothing.
LEAST_EMPTY = 0.02
#: Bins of the histogram whose peak is the level of the empty field.
BINS = 72

Image = NDArray[np.floating]
Mask = NDArray[np.bool_]


@dataclass
class Sums:
    """Mean squares of one view, gathered frame by frame."""

    temporal_phase: list[float] = field(default_factory=list)
    spatial_phase: list[float] = field(default_factory=list)
    temporal_amplitude: list[float] = field(default_factory=list)
    spatial_amplitude: list[float] = field(default_factory=list)
    empty: list[float] = field(default_factory=list)


@checked_call
def noise_figures(
    ds: xr.Dataset,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> pd.DataFrame:
    """Measure the noise of a reconstruction in its empty field.

    The empty field is where the smoothed phase lies within 0.5 rad of the commonest phase and is
    joined to the border of the frame; a sixteenth of the frame is left out at each edge.

    Parameters
    ----------
    ds : xarray.Dataset
        ``phase`` wrapped, in radians, and ``amplitude`` where it is known, dims (time, angle, y,
        x), as `reconstruct` returns them. Up to 24 frames are read, each with the one after it.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each frame; ``cancelled()`` stops the work.

    Returns
    -------
    pandas.DataFrame
        One row a view, index ``view`` from 1: ``angle_deg``, ``fringe_visibility`` (0 to 1),
        ``temporal_phase_mrad``, ``temporal_path_nm``, ``spatial_phase_mrad``,
        ``spatial_path_nm``, ``temporal_amplitude_percent``, ``spatial_amplitude_percent`` (of
        the mean amplitude), ``empty_percent`` of the frame. NaN where there is too little empty
        field, only one frame, or nothing known.

    Raises
    ------
    ValueError
        If ``ds`` holds no phase.
    Cancelled
        If ``cancelled()`` returned True.
    """
    task = Task(progress, cancelled)
    if "phase" not in ds:
        msg = "noise is measured on phase; give what reconstruct() returns"
        raise ValueError(msg)
    phase = ds["phase"]
    known = wavelengths_of(phase)
    light = wavelengths_of(ds) if known is None else known
    visibility = visibility_of_angles(ds)
    times = chosen_times(phase.sizes["time"])
    watch = Watch(len(times) * phase.sizes["angle"], "noise", task)
    rows = []
    for view, angle in enumerate(phase["angle"].values):
        rows.append(
            {"view": view + 1, "angle_deg": float(angle), "fringe_visibility": visibility[view]}
            | figures_of(sums_of(ds, view, times, watch))
        )
    table = pd.DataFrame(rows).set_index("view")
    return with_wavelength(table, np.full(len(rows), math.nan) if light is None else light)


def visibility_of_angles(ds: xr.Dataset) -> list[float]:
    """Return the fringe visibility of the views that are there, NaN where it isn't known."""
    angles = [float(a) for a in ds["phase"]["angle"].values]
    visibility = [float(v) for v in ds.attrs.get("fringe_visibility", ())]
    lobes = ds.attrs.get("lobes", ())
    if len(set(angles)) < len(angles):  # of several wavelengths
        return visibility if len(visibility) == len(angles) else [math.nan] * len(angles)
    noted = [float(lobe["angle_deg"]) for lobe in lobes if isinstance(lobe, dict)]
    if len(noted) != len(visibility):
        return visibility if len(visibility) == len(angles) else [math.nan] * len(angles)
    if len(set(noted)) < len(noted):  # such views are numbered instead
        noted = [float(i) for i in range(len(noted))]
    known = dict(zip(noted, visibility, strict=True))
    return [known.get(angle, math.nan) for angle in angles]


@checked_call
def with_wavelength(
    table: pd.DataFrame, wavelength_um: float | NDArray[np.floating]
) -> pd.DataFrame:
    """Return the same phase noise with its optical path at another wavelength, in micrometres.

    It may be one for each view.

    Parameters
    ----------
    table : pandas.DataFrame
        What `noise_figures` gives, one row a view.
    wavelength_um : float or ndarray of float, shape (view,)
        Vacuum wavelength in micrometres; NaN where it is not known.

    Returns
    -------
    pandas.DataFrame
        A new table in the form of `noise_figures`; ``temporal_path_nm`` and ``spatial_path_nm``,
        in nanometres, are those of the wavelength.
    """
    if "temporal_phase_mrad" not in table or "spatial_phase_mrad" not in table:
        msg = "table has no columns of phase noise; give the one that noise_figures() makes"
        raise ValueError(msg)
    light = as_numbers("wavelength_um", wavelength_um)
    if light.shape not in ((), (len(table),)):
        given = shown(wavelength_um)
        msg = f"wavelength_um must be one number, or one for each view, but is {given}"
        raise ValueError(msg)
    paths = {
        f"{name}_path_nm": table[f"{name}_phase_mrad"] * light / (2 * np.pi)
        for name in ("temporal", "spatial")
    }
    return table.assign(**paths)[COLUMNS]


COLUMNS = [
    "angle_deg",
    "fringe_visibility",
    "temporal_phase_mrad",
    "temporal_path_nm",
    "spatial_phase_mrad",
    "spatial_path_nm",
    "temporal_amplitude_percent",
    "spatial_amplitude_percent",
    "empty_percent",
]


@checked_call
def noise_sentence(table: pd.DataFrame) -> str:
    """Return the noise in words, as the root mean square over the views.

    Parameters
    ----------
    table : DataFrame
        From `noise_figures`.

    Returns
    -------
    str
        Such as "Noise: 12 mrad (1.2 nm) in time, 18 mrad (1.8 nm) in space; amplitude 1.5 %.".
        Where there is no empty field to measure it in, it says so.
    """
    parts = []
    for name in ("temporal", "spatial"):
        phase, path = (
            rms(table[f"{name}_{what}"].to_numpy(np.float64)) for what in ("phase_mrad", "path_nm")
        )
        words = "in time" if name == "temporal" else "in space"
        if math.isfinite(phase):
            length = f" ({path:.2g} nm)" if math.isfinite(path) else ""
            parts.append(f"{phase:.3g} mrad{length} {words}")
    if not parts:
        return "Noise: there is no empty field to measure it in."
    sentence = "Noise: " + ", ".join(parts)
    for name in ("temporal", "spatial"):
        amplitude = rms(table[f"{name}_amplitude_percent"].to_numpy(np.float64))
        if math.isfinite(amplitude):
            return f"{sentence}; amplitude {amplitude:.2g} %."
    return sentence + "."


def chosen_times(n_times: int) -> list[range]:
    """Return the frames to look at, each with the one after it, spread over the recording."""
    last = max(n_times - 2, 0)
    firsts = sorted({int(t) for t in np.linspace(0, last, min(FRAMES, last + 1)).round()})
    return [range(first, min(first + 2, n_times)) for first in firsts]


def sums_of(ds: xr.Dataset, view: int, times: list[range], watch: Watch) -> Sums:
    """Return the mean squares of a view's noise."""
    sums = Sums()
    for pair in times:
        watch.step()
        frames = list(frames_of(ds, view, pair))
        empty = np.logical_and.reduce([empty_field(phase) for phase, _ in frames])
        share = float(empty.mean())
        sums.empty.append(share)
        if share < LEAST_EMPTY:
            continue
        phase, amplitude = frames[0]
        sums.spatial_phase.append(variance_in_space(levelled(phase, empty), empty))
        if amplitude is not None:
            sums.spatial_amplitude.append(variance_in_space(relative(amplitude, empty), empty))
        if len(frames) == 2:
            later, later_amplitude = frames[1]
            steps = levelled(later - phase, empty)[empty]
            sums.temporal_phase.append(float(np.var(steps)) / 2)
            if amplitude is not None and later_amplitude is not None:
                steps = relative(later_amplitude, empty) - relative(amplitude, empty)
                sums.temporal_amplitude.append(float(np.var(steps[empty])) / 2)
    return sums


def frames_of(ds: xr.Dataset, view: int, times: range) -> Iterator[tuple[Image, Image | None]]:
    """Yield phase and amplitude of some frames, as far as they are known."""
    for time in times:
        phase, amplitude = (
            np.asarray(ds[name].isel(time=time, angle=view).values, np.float64)
            if name in ds
            else None
            for name in ("phase", "amplitude")
        )
        assert phase is not None
        yield phase, amplitude


def figures_of(sums: Sums) -> dict[str, float]:
    """Return the square roots of the mean squares, in mrad and percent."""

    def root(squares: list[float]) -> float:
        return math.sqrt(float(np.mean(squares))) if squares else math.nan

    return {
        "temporal_phase_mrad": 1000 * root(sums.temporal_phase),
        "spatial_phase_mrad": 1000 * root(sums.spatial_phase),
        "temporal_amplitude_percent": 100 * root(sums.temporal_amplitude),
        "spatial_amplitude_percent": 100 * root(sums.spatial_amplitude),
        "empty_percent": 100 * float(np.mean(sums.empty)),
    }


def empty_field(phase: Image) -> Mask:
    """Mark the empty field of a frame; NaN are not empty."""
    known = np.isfinite(phase)
    unit = np.where(known, np.exp(1j * np.where(known, phase, 0)), 0)
    counts, edges = np.histogram(phase[known], BINS, (-np.pi, np.pi))
    peak = int(scipy.ndimage.uniform_filter1d(counts.astype(float), 5, mode="wrap").argmax())
    unit = unit * np.exp(-0.5j * (edges[peak] + edges[peak + 1]))
    smooth = scipy.ndimage.gaussian_filter(
        unit.real, SMOOTHING
    ) + 1j * scipy.ndimage.gaussian_filter(unit.imag, SMOOTHING)
    near = np.abs(np.angle(smooth)) < FLAT_RAD
    smooth *= np.exp(-1j * np.angle(smooth[near].sum())) if near.any() else 1
    flat = scipy.ndimage.binary_erosion(
        known & (np.abs(np.angle(smooth)) < FLAT_RAD), iterations=RIM, border_value=1
    )
    labels, count = scipy.ndimage.label(flat)
    joined = np.zeros(count + 1, dtype=bool)
    for line in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        joined[line] = True
    joined[0] = False
    empty: Mask = joined[labels]
    for axis, n in enumerate(empty.shape):
        margin = math.ceil(MARGIN_SHARE * n)
        inside = (np.arange(n) >= margin) & (np.arange(n) < n - margin)
        empty &= np.expand_dims(inside, 1 - axis)
    return empty


def levelled(phase: Image, empty: Mask) -> Image:
    """Return phase against that of the empty field, within half a turn of it."""
    level = np.angle(np.exp(1j * phase[empty]).mean())
    turned: Image = np.angle(np.exp(1j * (phase - level)))
    return turned


def relative(amplitude: Image, empty: Mask) -> Image:
    """Return amplitude over its mean in the empty field."""
    return amplitude / max(float(amplitude[empty].mean()), np.finfo(float).tiny)


def variance_in_space(image: Image, empty: Mask) -> float:
    """Return the variance over the empty field after a tilt has been taken off."""
    y, x = np.nonzero(empty)
    terms = np.stack([np.ones(len(y)), y - y.mean(), x - x.mean()])
    values = image[empty]
    # The normal equations are three by three; y and x are centred, so they are solved exactly.
    tilt, *_ = np.linalg.lstsq(terms @ terms.T, terms @ values, rcond=None)
    return float(np.mean((values - tilt @ terms) ** 2))


def rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square of the numbers that are known, NaN if none is."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan
