"""What is taken off all frames alike: the reference, and the phase of the empty field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.aberrations import MAX_ORDER, MIN_ORDER
from napari_phase4d.holography.background import (
    BetterSurface,
    Fit,
    Surface,
    aligned_to,
)
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.emptyfield import FrameTilt, background_offset
from napari_phase4d.holography.lost import STATIC_FRAMES, LostFrames, usual_fringes
from napari_phase4d.holography.quality import is_noise, parts_of_views, shows_fringes
from napari_phase4d.holography.surfaces import lit_part
from napari_phase4d.holography.tilts import TiltsBetween, in_line
from napari_phase4d.later import xr
from napari_phase4d.recording import BrokenFrameError, Recording
from napari_phase4d.stacks import PLAIN_AXES, looks_wrapped
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.warned import warn
from napari_phase4d.words import is_table, shown

__all__ = [
    "BACKGROUND_ORDERS",
    "Corrections",
    "Reference",
    "background_surface",
    "corrections",
    "median_advice",
    "numbered_frame",
    "reference_note",
]

#: What to take off the background, and the degree of the surface that does it; None for the
#: degree that is asked for.
BACKGROUND_ORDERS: dict[str, int | None] = {
    "none": 0,
    "tilt": 1,
    "curvature": 2,
    "polynomial": None,
    "zernike": None,
}
#: Phase that differs from a smooth surface by more radians than this stands out; from so many
#: percent of a view on it is worth a warning.
STANDS_OUT_RAD, MUCH_PERCENT = 1.0, 2.0
#: Below this share of its median the reference's amplitude is not divided by.
DARKEST_REFERENCE = 0.05
#: From so many percent of a view on it is worth a warning that the reference shows no fringes.
DARK_PERCENT = 5.0
#: The mean of a reference's frames is weak if half of its bright pixels have less than this share
#: of the amplitude that single frames have there.
WEAK_MEAN = 0.5
NO_FRINGES = "the reference shows no fringes in at least one lobe; choose another reference"

Reference = Any
Fields = NDArray[np.complex64]


def corrections(
    rec: Recording,
    demodulate: Demodulator,
    reference: Reference,
    background: str,
    background_order: int,
    lost: LostFrames,
    seen: dict[int, Fields],
    task: Task,
    *,
    tilt_per_frame: bool,
) -> Corrections:
    """Return what to multiply the fields of all frames by, and what the background was.

    It divides by the reference and takes off the phase that the empty field has in all frames.
    Where each frame loses its own tilt afterwards, what they have in common is measured on frames
    that are levelled to the first of them. The fields of frames seen already are used up.

    Raises
    ------
    ValueError
        If the background is a curvature, and a view does not show enough of its empty field.
    """
    kind, order = background_surface(background, background_order)
    factor = np.ones((1, 1, 1), dtype=np.complex64)
    lit: NDArray[np.bool_] | None = None
    by_median = isinstance(reference, str) and reference == "median"
    if reference is not None and not by_median:
        divisor = reference_fields(rec, reference, demodulate, lost, task)
        if any(is_noise(field) for field in divisor):
            raise ValueError(NO_FRINGES)
        warn_of_dark_parts(divisor, seen)
        factor, lit = inverse(divisor), lit_parts(divisor)
    tilts = TiltsBetween(demodulate.output_shape, tilt_per_frame)
    each = tilts.seen(static_fields(rec, demodulate, lost, seen, task))
    shown: list[float] = []
    if by_median:
        static = np.stack(list(each))
        middle = median_fields(static)
        shown = [percent_not_smooth(field) for field in middle]
        factor, lit = inverse(middle), lit_parts(middle)
        each = iter(static)
    if not order:
        return Corrections(factor, [], [], [], [], shown)
    means = mean_fields(fields if reference is None else fields * factor for fields in each)
    if lit is not None:
        means *= lit  # noise over noise is as bright as what is lit
    given = reference is not None and not by_median
    surface = Surface(kind, order, means.shape[1:])
    fits = fitted_views(rec.name, means, background, surface, task, given=given)
    surfaces = np.stack([fit.surface for fit, _ in fits])
    factor = factor * np.exp(-1j * surfaces).astype(np.complex64)
    return Corrections(
        factor,
        [fit.coefficients for fit, _ in fits],
        [left for _, left in fits],
        [view for view, (fit, _) in enumerate(fits) if background == "curvature" and fit.unsure],
        [] if tilt_per_frame else tilts.left_rad(),
        shown,
    )


def fitted_views(
    name: str,
    means: Fields,
    background: str,
    surface: Surface,
    task: Task,
    *,
    given: bool,
) -> list[tuple[Fit, float]]:
    """Return the surface that fits each view, and what is left of its background, in rad rms.

    ``given`` says whether there is a reference hologram, so that it is not asked for.
    """
    better = BetterSurface(background, means.shape[1:])
    watch = Watch(len(means), "fit the background", task.quiet)

    def fitted(view: int) -> tuple[Fit, float]:
        fit = surface.fit(means[view])
        left = better.leaves(means[view], fit.surface)
        if background == "curvature" and fit.doubt and not left.explained:
            raise ValueError(refusal(fit.doubt, view, name, given=given))
        return fit, left.rad

    return list(in_threads(fitted, range(len(means)), watch))


@dataclass(frozen=True)
class Corrections:
    """What all frames are corrected by.

    Parameters
    ----------
    factor : ndarray of shape (view, y, x) or (1, 1, 1)
        What to multiply the fields by.
    coefficients : list of ndarray
        For each view those of the background's terms in radians; empty if none was fitted.
    left_rad : list of float
        For each view what is left in its empty field, in radians rms; empty likewise.
    unsure : list of int
        The views whose fitted curvature may be the object's.
    tilt_left_rad : list of float
        For each view how far frames tilt against each other, in radians rms; empty if that is
        taken off each of them.
    median_shows : list of float
        For each view in how much of the median over time something stands out, in percent; empty
        if the reference is another.
    """

    factor: NDArray[np.complex64]
    coefficients: list[NDArray[np.float64]]
    left_rad: list[float]
    unsure: list[int]
    tilt_left_rad: list[float]
    median_shows: list[float]

    def notes(self) -> dict[str, Any]:
        """Return what to note of what is left and doubted, as far as there is any."""
        notes = {
            "background_left_rad": [round(left, 6) for left in self.left_rad],
            "frame_tilt_left_rad": [round(left, 6) for left in self.tilt_left_rad],
            "curvature_unsure": self.unsure,
            "median_shows_percent": self.median_shows,
        }
        return {name: values for name, values in notes.items() if values}


def refusal(doubt: str, view: int, name: str, *, given: bool) -> str:
    """Say why a curvature can't be fitted, and what to do."""
    hologram = "" if given else "a reference hologram or "
    return (
        f"curvature can't be fitted to view {view + 1} of {name}: {doubt}; "
        f'use {hologram}background="tilt"'
    )


def background_surface(background: str, background_order: int) -> tuple[str, int]:
    """Return the kind of terms and the degree that a way to remove the background stands for.

    Raises
    ------
    ValueError
        If there is no such way or degree.
    """
    if not isinstance(background, str) or background not in BACKGROUND_ORDERS:
        msg = (
            f"background must be one of {', '.join(BACKGROUND_ORDERS)}, but is {shown(background)}"
        )
        raise ValueError(msg)
    fixed = BACKGROUND_ORDERS[background]
    if fixed is not None:
        return "powers", fixed
    whole = isinstance(background_order, (int, np.integer)) and background_order is not True
    if not whole or not MIN_ORDER <= background_order <= MAX_ORDER:
        msg = (
            f"background_order must lie between {MIN_ORDER} and {MAX_ORDER}, a whole number, "
            f"but is {shown(background_order)}"
        )
        raise ValueError(msg)
    return background, int(background_order)


def inverse(fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return 1 / the fields of a reference, held small where the reference is dark."""
    amplitude = np.abs(fields)
    darkest = DARKEST_REFERENCE * np.median(amplitude, axis=(1, 2), keepdims=True)
    if not (darkest > 0).all():
        raise ValueError(NO_FRINGES)
    result: NDArray[np.complex64] = fields.conj() / np.maximum(amplitude, darkest) ** 2
    return result


def lit_parts(fields: Fields) -> NDArray[np.bool_]:
    """Mark what is lit in each view of a reference (view, y, x)."""
    return np.stack([lit_part(field) for field in fields])


def static_fields(
    rec: Recording,
    demodulate: Demodulator,
    lost: LostFrames,
    seen: dict[int, Fields],
    task: Task,
) -> Iterator[Fields]:
    """Yield the fields (view, y, x) of some frames that are not lost, over the recording."""
    # All of those evenly apart may be dark, where light is on in every second frame.
    indices = sorted({*rec.sample_indices(STATIC_FRAMES), *seen})
    watch = Watch(len(indices), "look at the background", task.quiet)

    def fields(index: int) -> Fields | None:
        if index in seen:
            return seen.pop(index)
        try:
            frame = rec.raw_frame(index)
        except BrokenFrameError:
            return None
        found = demodulate(frame)
        return None if lost.reason(frame, found) else found

    return (found for found in in_threads(fields, indices, watch) if found is not None)


def mean_fields(each: Iterator[Fields]) -> Fields:
    """Return the mean over frames of every view, turned to agree with the first frame's.

    The fields are turned in place.
    """
    first = next(each)
    total, count = first.copy(), 1
    for fields in each:
        for view, field in enumerate(fields):
            total[view] += aligned_to(first[view], field)
        count += 1
    total /= np.float32(count)
    return total


def median_fields(stack: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the median over time of fields, whose constant phases are aligned in place.

    A large object moves the overlap of two frames; so they are aligned once more, by what most
    pixels have in common with a first median.
    """
    overlap = np.einsum("avyx,vyx->av", stack, stack[0].conj())
    stack *= np.exp(-1j * np.angle(overlap)).astype(np.complex64)[..., None, None]
    first = median_of_parts(stack)
    for fields in stack:
        for field, common in zip(fields, first, strict=True):
            field *= np.complex64(np.exp(-1j * background_offset(field * common.conj())))
    return median_of_parts(stack)


def percent_not_smooth(field: NDArray[np.complex64]) -> float:
    """Return in how much of a field (y, x) the phase is no smooth surface, in percent.

    That is where it differs from a surface of second degree by more than `STANDS_OUT_RAD`.
    """
    surface = Surface("powers", 2, field.shape).fit(field).surface
    flat = field * np.exp(-1j * surface)
    flat *= np.exp(-1j * background_offset(flat))
    size = np.abs(field)
    lit = size > DARKEST_REFERENCE * np.median(size[size > 0])  # what is darker is no phase
    return round(100 * float((lit & (np.abs(np.angle(flat)) > STANDS_OUT_RAD)).mean()), 1)


def median_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views the median over time shows something that stays; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    views, count = parts_of_views(attrs.get("median_shows_percent", ()), MUCH_PERCENT)
    if not count:
        return ""
    return (
        f"The median over time shows something that stays in {views}: if that is the object, it "
        "is divided away, and its phase is too small; take another reference"
    )


def median_of_parts(stack: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the median over time of the real and of the imaginary parts."""
    middle: NDArray[np.complex64] = (
        np.median(stack.real, axis=0) + 1j * np.median(stack.imag, axis=0)
    ).astype(np.complex64)
    return middle


def numbered_frame(
    rec: Recording, number: int, demodulate: Demodulator, lost: LostFrames
) -> NDArray[np.generic]:
    """Return the frame of a recording that is the reference, by its number.

    Raises
    ------
    ValueError
        If there is no such frame, or if it is lost: nothing can be divided by what it lacks.
    """
    if not -rec.n_frames <= number < rec.n_frames:
        msg = f"reference frame {number} does not exist; {rec.name} has {rec.n_frames} frames"
        raise ValueError(msg)
    frame = rec.raw_frame(int(number) % rec.n_frames)
    if reason := lost.reason(frame, demodulate(frame)):
        msg = (
            f"reference frame {number} of {rec.name} is lost ({reason}); choose another frame, or "
            "give the hologram of an empty field"
        )
        raise ValueError(msg)
    return frame


def reference_fields(
    rec: Recording,
    reference: Reference,
    demodulate: Demodulator,
    lost: LostFrames,
    task: Task,
) -> Fields:
    """Return the fields (view, y, x) of the reference, the mean of those of its frames."""
    if isinstance(reference, bool) or is_table(reference):
        what = "a frame number, an array or a Recording"
        msg = f"reference must be {what}, but is {shown(reference)}"
        raise TypeError(msg)
    if isinstance(reference, (int, np.integer)):
        return demodulate(numbered_frame(rec, int(reference), demodulate, lost))
    recording = reference_recording(rec, reference)
    if recording.n_frames == 1:
        return demodulate(recording.frame(0))
    return mean_of_frames(recording, demodulate, task)


def reference_recording(rec: Recording, reference: Reference) -> Recording:
    """Return a reference as a recording; ValueError if it is not as large as the frames."""
    if isinstance(reference, Recording):
        recording = reference
    elif isinstance(reference, (str, Path)):
        msg = f"open the reference {reference} with open_recording() first"
        raise TypeError(msg)
    else:
        frames = in_order_of_axes(reference) if hasattr(reference, "dims") else reference
        if isinstance(frames, np.ndarray) and looks_wrapped(frames):
            warn(
                "the reference lies between -pi and pi on both sides of zero, as wrapped phase "
                "does and light does not; give the hologram of an empty field"
            )
        recording = Recording.from_frames(frames, optics=rec.optics, name="the reference")
    if recording.frame_shape != rec.frame_shape:
        msg = (
            f"the reference is {recording.frame_shape} pixels, "
            f"but the frames are {rec.frame_shape}"
        )
        raise ValueError(msg)
    return recording


def mean_of_frames(rec: Recording, demodulate: Demodulator, task: Task) -> Fields:
    """Return the mean fields of the frames that are not lost, each in line with the first.

    Fringes move from frame to frame; so grey values, or fields as they are, would cancel.
    """
    # It refuses what has no frame that is not lost.
    lost, _ = usual_fringes(rec, demodulate, task)

    def seen(index: int) -> Fields | None:
        try:
            frame = rec.raw_frame(index)
        except BrokenFrameError:
            return None
        fields = demodulate(frame)
        return None if lost.reason(frame, fields) else fields

    watch = Watch(rec.n_frames, "look at the reference", task.quiet)
    found = in_threads(seen, range(rec.n_frames), watch)
    return aligned_average(fields for fields in found if fields is not None)


def aligned_average(each: Iterator[Fields]) -> Fields:
    """Return the mean over frames of every view, in line with the first; say if it is weak."""
    first = next(each, None)
    if first is None:
        msg = "every frame of the reference is lost; record it again"
        raise ValueError(msg)
    tilt = FrameTilt((first.shape[1], first.shape[2]))
    total, sizes, count = first.astype(np.complex128), np.abs(first).astype(np.float64), 1
    for fields in each:
        for view, field in enumerate(fields):
            sizes[view] += np.abs(field)
            total[view] += in_line(first[view], field, tilt)
        count += 1
    weak = [view for view, both in enumerate(zip(total, sizes, strict=True)) if cancels(*both)]
    if weak:
        views = " and ".join(f"view {view + 1}" for view in weak)
        warn(
            f"the frames of the reference don't agree in {views}, so that their mean is much "
            "weaker than they are; give one of them, or a reference in which nothing moves"
        )
    total /= count
    return total.astype(np.complex64)


def cancels(total: NDArray[np.complex128], sizes: NDArray[np.float64]) -> bool:
    """Say whether summed fields are much weaker than the sum of their amplitudes."""
    bright = sizes >= np.median(sizes)
    return bool(np.median(np.abs(total[bright])) < WEAK_MEAN * np.median(sizes[bright]))


def warn_of_dark_parts(divisor: Fields, seen: Mapping[int, Fields]) -> None:
    """Say where a reference shows no fringes, but a frame from the middle of those seen does."""
    if not seen:
        return
    fields = seen[sorted(seen)[len(seen) // 2]]
    percents = [
        100 * float((shows_fringes(field) & ~shows_fringes(by)).mean())
        for field, by in zip(fields, divisor, strict=True)
    ]
    views, count = parts_of_views(percents, DARK_PERCENT)
    if count:
        warn(
            f"the reference shows no fringes on {views}, where the recording does: the phase "
            "there is noise; choose another reference"
        )


def in_order_of_axes(reference: xr.DataArray) -> NDArray[np.generic]:
    """Return frames (time, y, x) or (y, x) of a named array, whatever the order of its axes."""
    axes = [axis for axis in PLAIN_AXES[3] if axis in reference.dims]
    if len(axes) != reference.ndim or axes[-2:] != ["y", "x"]:
        msg = f"the reference has dims {tuple(reference.dims)}; it must have y and x, or time too"
        raise ValueError(msg)
    return np.asarray(reference.transpose(*axes).values)


def reference_note(reference: Reference) -> str:
    """Say in a few words what was divided by."""
    if reference is None:
        return "none"
    if isinstance(reference, Recording):
        return reference.name
    if isinstance(reference, (int, np.integer)):
        return f"frame {reference}"
    return reference if isinstance(reference, str) else "array"
