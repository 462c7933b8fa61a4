"""From a recording and its lobes to wrapped phase and amplitude."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.background import background_advice, curvature_advice
from napari_phase4d.holography.corrections import (
    BACKGROUND_ORDERS,
    Reference,
    background_surface,
    corrections,
    median_advice,
    numbered_frame,
    reference_note,
)
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.emptyfield import FrameTilt
from napari_phase4d.holography.focusing import Focus, autofocus
from napari_phase4d.holography.frames import (
    FrameReconstructor,
    aberration_note,
    focus_note,
    lobe_note,
    propagator_for,
)
from napari_phase4d.holography.lobes import (
    Lobe,
    check_lobes,
    in_order_of_angle,
    lobe_doubts,
    one_wavelength,
    with_wavelengths,
)
from napari_phase4d.holography.lost import STATIC_FRAMES, all_lost, usual_fringes
from napari_phase4d.holography.quality import (
    empty_advice,
    fringe_advice,
    fringe_visibility,
    lost_advice,
    shows_fringes,
)
from napari_phase4d.holography.refocusing import fields_walked, refocus_advice
from napari_phase4d.holography.tilts import tilt_advice
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.warned import warn
from napari_phase4d.words import (
    check_bool,
    check_number,
    has_parts,
    is_list,
    shown,
)

__all__ = [
    "FEW_LOST",
    "PhaseSettings",
    "Refocus",
    "beginning_of",
    "find_focus",
    "frame_reconstructor",
    "reconstruct",
    "reconstruct_frames",
    "reconstruction_advice",
]

#: Frames that the focus is looked for in at most, and about how many pixels of all views.
FOCUS_FRAMES, FOCUS_PIXELS = 4, 500_000
#: So many pixels at most, unless one view alone has more; of more views some are looked at.
MOST_FOCUS_PIXELS = 4_000_000

#: Frames that are looked at for pixels without fringes.
FRINGE_FRAMES = 3

#: A script is not warned of lost frames up to this share of all.
FEW_LOST = 0.1

#: Micrometres, "auto" to find the focus, None to stay in the camera's plane.
Refocus = float | Literal["auto"] | None


@dataclass(frozen=True)
class PhaseSettings:
    """How phase is reconstructed: the settings of `reconstruct`, which says what they mean."""

    reference: Reference = None
    window: str = "smooth-disk"
    background: str = "tilt"
    background_order: int = 4
    refocus_um: Refocus = None
    drift: bool = True
    tilt_per_frame: bool = False
    first_frames: int | None = None


def reconstruct(
    rec: Recording,
    lobes: Iterable[Lobe],
    reference: Reference = None,
    *,
    window: str = "smooth-disk",
    background: str = "tilt",
    background_order: int = 4,
    refocus_um: Refocus = None,
    drift: bool = True,
    tilt_per_frame: bool = False,
    first_frames: int | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Reconstruct the wrapped phase and the amplitude of every view and frame.

    Parameters
    ----------
    rec : Recording
        The hologram video; read one frame at a time.
    lobes : iterable of Lobe
        The views; the result holds them in the order of their angles, and of their wavelengths
        where angles repeat. Where two have the same angle and wavelength, the views are numbered
        instead.
    reference : optional
        What to divide the field by, so that static errors of the optics drop out: ``None`` for
        nothing, a frame number, ``"median"`` for the median over time, which is free of the
        object only where it is away in more than half of the frames, or a hologram without
        the object as an array (y, x) or Recording.
    window : str, optional
        How a lobe is cut out: "disk", "smooth-disk" (default), "gaussian" or "tukey".
    background : str, optional
        What to fit to the empty field and take off, once for the whole recording: "tilt"
        (default), "curvature" (tilt and curvature), "polynomial" or "zernike" (all aberrations
        up to a degree), or "none".
    background_order : int, optional
        The degree of "polynomial" and "zernike", 1 to 8, default 4: up to spherical aberration.
    refocus_um : float, "auto" or None, optional
        How far to carry the fields along the light, in micrometres in the medium: after the
        reference and the background have been taken off, before the phase is read. "auto" looks
        for the focus of some frames, see `autofocus`. Default None: as the camera saw it.
    drift : bool, optional
        Whether to set the phase of the empty field to zero in every frame. Default True.
    tilt_per_frame : bool, optional
        Whether to take a tilt off each frame too, fitted to that frame's own empty field after
        the background of all frames has been taken off; frames with too little of it keep theirs.
        Default False.
    first_frames : int, optional
        Measure what all frames have in common (the background, the median, the focus, and how
        strong fringes usually are) on so many frames from the beginning only. A frame then comes
        out the same whatever follows it, as `napari_phase4d.pipeline.watch` needs. Default: on
        frames from all over the recording.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each frame; ``cancelled()`` stops the work.

    Returns
    -------
    xarray.Dataset
        ``phase`` wrapped to (-pi, pi] and ``amplitude``, float32, dims (time, angle, y, x).
        The pixel is larger than the camera's, since the lobe holds fewer frequencies than the
        frame; ``attrs["pixel_ratio"]`` says by how much. Where lobes differ in wavelength, the
        coordinate ``wavelength`` along the angle holds that of each view in micrometres;
        elsewhere ``attrs["wavelength_um"]`` holds that of all.

        Frames that the camera lost are NaN in both; ``attrs["lost_times"]`` lists them, and
        ``attrs["lost_views"]`` those (time, view) of which other views show fringes, as where one
        beam is blocked.
        ``attrs["background_share"]`` is the smallest share of pixels near the level of the empty
        field in the views of all other frames, 1 if ``drift`` is off. It is 0.25 where phases of
        all turns are as frequent; below 0.15 a view keeps its drift.

    Raises
    ------
    ValueError
        If an option has no such value, the reference does not fit the frames, or the background
        is "curvature" and too little of a view is clearly empty field.
    Cancelled
        If ``cancelled()`` returned True.

    Warns
    -----
    UserWarning
        If a lobe reaches beyond the spectrum or over the zero order, or is perhaps the beat of
        two others.
    UserWarning
        If more than 0.3 rad rms of the background are left in a view where a surface of a higher
        degree would take them off. ``attrs["background_left_rad"]`` says what is left.
    UserWarning
        If the background is "curvature" and too little of a view is surely empty field, so that
        what was fitted may be the object's. ``attrs["curvature_unsure"]`` names the views.
    UserWarning
        If frames tilt against each other by more than 0.3 rad rms, which is left where one tilt
        is taken off all of them. ``attrs["frame_tilt_left_rad"]`` says how much.
    UserWarning
        If more than 5 % of a view show no fringes in most frames, so that their phase is noise;
        `napari_phase4d.holography.fringe_mask` marks them.
        ``attrs["without_fringes_percent"]`` has the share.
    UserWarning
        If more than a tenth of the frames are lost, or of those of a view, or less than 0.3 of a
        view of any other frame looks like empty field.

    See Also
    --------
    find_lobes : Finds the views.
    unwrap : What comes next.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena(n_times=2)
    >>> rec = p4d.simulation.multiplexed_video(exact["phase"])
    >>> lobes = p4d.find_lobes(rec, n_views=2, angles_deg=(-7, 21))
    >>> data = p4d.reconstruct(rec, lobes)
    >>> data.phase.dims, data.phase.shape
    (('time', 'angle', 'y', 'x'), (2, 2, 120, 120))
    """
    task = Task(progress, cancelled)
    settings = PhaseSettings(
        reference,
        window,
        background,
        background_order,
        refocus_um,
        drift,
        tilt_per_frame,
        first_frames,
    )
    views: Any = list(lobes) if has_parts(lobes) else lobes
    work = frame_reconstructor(rec, views, settings, Task(None, cancelled))
    for doubt in lobe_doubts(with_wavelengths(views, rec.optics.wavelength_um)):
        warn(doubt)
    for advice in reconstruction_advice(work.attrs):
        warn(f"{rec.name}: {advice}")
    data = reconstruct_frames(work, rec, task)
    for advice in frames_advice(data.attrs, rec.n_frames, FEW_LOST):
        warn(f"{rec.name}: {advice}")
    return data


def reconstruction_advice(
    attrs: Mapping[str, Any], n_frames: int = 0, few_lost: float = 0.0
) -> list[str]:
    """Return what is to be looked after in a reconstruction, by its notes; each part a sentence.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    n_frames : int, optional
        How many frames there are; default: what is to be said of single frames is not known yet.
    few_lost : float, optional
        Up to which share of all frames lost ones are not worth a word.
    """
    every = (
        background_advice(attrs),
        curvature_advice(attrs),
        tilt_advice(attrs),
        median_advice(attrs),
        fringe_advice(attrs),
        refocus_advice(attrs),
    )
    of_frames = frames_advice(attrs, n_frames, few_lost) if n_frames else []
    return [advice for advice in every if advice] + of_frames


def frames_advice(attrs: Mapping[str, Any], n_frames: int, few_lost: float = 0.0) -> list[str]:
    """Return what is to be looked after in single frames of a reconstruction; see above.

    That little is empty field says nothing more where a background is left, or there are no
    fringes. Lost frames are not worth a word up to a share ``few_lost`` of all.
    """
    told = background_advice(attrs) or fringe_advice(attrs) or tilt_advice(attrs)
    every = ("" if told else empty_advice(attrs), lost_advice(attrs, n_frames, few_lost))
    return [advice for advice in every if advice]


def reconstruct_frames(
    work: FrameReconstructor,
    rec: Recording,
    task: Task = UNWATCHED,
) -> xr.Dataset:
    """Reconstruct all frames in memory by what `frame_reconstructor` measured."""
    phase = np.empty(work.stack_shape(rec.n_frames), dtype=np.float32)
    amplitude = np.empty_like(phase)

    def into_place(index: int) -> tuple[float, ...]:
        return work.read(rec, index, phase[index], amplitude[index])

    watch = Watch(rec.n_frames, "reconstruct", task)
    shares = list(in_threads(into_place, range(rec.n_frames), watch))
    return work.as_dataset(rec, phase, amplitude, shares)


def frame_reconstructor(
    rec: Recording,
    lobes: Sequence[Lobe],
    settings: PhaseSettings,
    task: Task = UNWATCHED,
) -> FrameReconstructor:
    """Measure what all frames have in common; see `reconstruct` for the arguments."""
    background, order = settings.background, settings.background_order
    background_surface(background, order)  # to refuse first what is quick to see
    listed = is_list(lobes) and all(isinstance(lobe, Lobe) for lobe in lobes)
    if not isinstance(rec, Recording) or not listed:
        msg = "reconstruct() takes a Recording from open_recording() and a list of Lobe"
        raise TypeError(msg)
    for switch in ("drift", "tilt_per_frame"):
        check_bool(switch, getattr(settings, switch))
    check_lobes(lobes)
    looked_at = beginning_of(rec, settings.first_frames)
    # Views that name the wavelength of the recording are like those that name none.
    common_um = one_wavelength(lobes, rec.optics.wavelength_um)
    lobes, angles = in_order_of_angle(with_wavelengths(lobes, rec.optics.wavelength_um))
    demodulate = Demodulator(rec.frame_shape, lobes, settings.window)
    lost, seen = usual_fringes(looked_at, demodulate, task)
    middle = list(seen)[len(seen) // 2]
    visibility = fringe_visibility(looked_at.raw_frame(middle), demodulate, seen[middle])
    without = without_fringes_percent(list(seen.values()))
    reference = settings.reference
    numbered = isinstance(reference, (int, np.integer)) and not isinstance(reference, bool)
    if looked_at is not rec and numbered:
        # A number among all frames.
        reference = numbered_frame(rec, reference, demodulate, lost)
    found = corrections(
        looked_at,
        demodulate,
        reference,
        background,
        order,
        lost,
        seen,
        task,
        tilt_per_frame=settings.tilt_per_frame,
    )
    attrs: dict[str, Any] = {} if common_um is None else {"wavelength_um": common_um}
    attrs |= {
        "medium_index": rec.optics.medium_index,
        "recording": rec.name,
        "lobes": [lobe_note(lobe) for lobe in lobes],
        "fringe_visibility": visibility,
        "without_fringes_percent": without,
        "window": settings.window,
        "background": background,
        "drift_removed": settings.drift,
        "tilt_per_frame": settings.tilt_per_frame,
        "reference": reference_note(settings.reference),
        "pixel_ratio": list(demodulate.pixel_ratio),
    }
    if settings.first_frames is not None:
        attrs["first_frames"] = looked_at.n_frames
    attrs |= found.notes()
    if BACKGROUND_ORDERS[background] is None:
        attrs["background_order"] = order
    if background == "zernike":
        attrs["aberrations_rad"] = [aberration_note(view) for view in found.coefficients]
    tilt = FrameTilt(demodulate.output_shape) if settings.tilt_per_frame else None
    light = wavelengths_um(lobes)
    work = FrameReconstructor(
        demodulate, found.factor, settings.drift, angles, attrs, lost=lost, tilt=tilt, light=light
    )
    if settings.refocus_um is None:
        return work
    return with_refocus(work, looked_at, settings.refocus_um, task)


def beginning_of(rec: Recording, first_frames: int | None) -> Recording:
    """Return what is looked at of a recording: all of it, or so many frames from its beginning.

    Parameters
    ----------
    rec : Recording
        The hologram video.
    first_frames : int or None
        See `reconstruct`.

    Returns
    -------
    Recording
        The recording itself if ``first_frames`` is None, else its first frames.

    Raises
    ------
    ValueError
        If it is no number of frames.
    """
    if first_frames is None:
        return rec
    whole = isinstance(first_frames, (int, np.integer)) and not isinstance(first_frames, bool)
    if not whole or first_frames < 1:
        msg = f"first_frames must be a number of frames, 1 or more, but is {shown(first_frames)}"
        raise ValueError(msg)
    return rec.first(int(first_frames))


def wavelengths_um(lobes: Sequence[Lobe]) -> tuple[float, ...] | None:
    """Return the wavelength of each view, None where all have the same."""
    light = [lobe.wavelength_um for lobe in lobes if lobe.wavelength_um is not None]
    return tuple(light) if len(set(light)) > 1 else None


def without_fringes_percent(fields: Sequence[NDArray[np.complex64]]) -> list[float]:
    """Return how much of each view shows no fringes in most of some frames, in percent."""
    some = fields[:: max(1, len(fields) // FRINGE_FRAMES)]
    n_views = len(some[0])
    seen = list(
        in_threads(
            lambda each: shows_fringes(some[each // n_views][each % n_views]),
            range(len(some) * n_views),
            Watch(len(some) * n_views, "looking for fringes"),
        )
    )
    shares = (np.mean(seen[view::n_views], axis=0) > 0.5 for view in range(n_views))
    return [round(100 * float(1 - share.mean()), 1) for share in shares]


def with_refocus(
    work: FrameReconstructor,
    rec: Recording,
    refocus_um: float | str,
    task: Task,
) -> FrameReconstructor:
    """Return the same work with refocusing, by a known distance or to the focus."""
    note: dict[str, Any] = {}
    if isinstance(refocus_um, str) and refocus_um == "auto":
        focus = find_focus(work, rec, cancelled=task.cancelled)
        refocus_um, note = focus.distance_um, focus_note(focus)
    distance_um = checked_distance(refocus_um)
    optics = with_common_light(rec.optics, work)
    carry = propagator_for(
        work.demodulate.shape,
        work.demodulate.output_shape,
        optics,
        distance_um,
        work.light,
    )
    note["refocus_um"] = distance_um
    note["refocus_fields_walked"] = fields_walked(
        distance_um,
        max(lobe["radius"] for lobe in work.attrs["lobes"]) / optics.pixel_um,
        optics.wavelength_um,
        optics.medium_index,
        min(work.demodulate.shape) * optics.pixel_um,
    )
    return replace(work, refocus=carry, attrs=work.attrs | note)


def with_common_light(optics: Optics, work: FrameReconstructor) -> Optics:
    """Return the microscope with the wavelength of the views, their mean where they differ."""
    light = work.attrs.get("wavelength_um", np.mean(work.light or [optics.wavelength_um]))
    return replace(optics, wavelength_um=float(light))


#: Fields are carried no farther.
FARTHEST_UM = 1e5


def checked_distance(refocus_um: object) -> float:
    """Return a distance; ValueError if it is no number."""
    if isinstance(refocus_um, bool) or not isinstance(refocus_um, Real):
        msg = f'refocus_um must be a number of micrometres or "auto", but is {shown(refocus_um)}'
        raise ValueError(msg)
    distance = check_number("refocus_um", refocus_um)
    if not abs(distance) <= FARTHEST_UM:
        msg = (
            f"refocus_um must lie within {FARTHEST_UM:g} um of the camera's focus, but is "
            f"{distance:g}"
        )
        raise ValueError(msg)
    return distance


def find_focus(
    work: FrameReconstructor,
    rec: Recording,
    *,
    metric: str = "dubois",
    objects: str = "auto",
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Focus:
    """Find one distance at which all views of a recording are sharp.

    Parameters
    ----------
    work : FrameReconstructor
        From `frame_reconstructor`, without refocusing.
    rec : Recording
        The hologram video; up to four frames of it are looked at, fewer where they are large,
        and then also fewer of many views. Others stand in for frames that the camera lost.
    metric, objects, progress, cancelled : optional
        As in `autofocus`.

    Returns
    -------
    Focus
        Distance in micrometres, kind of object, and the measure over distance.

    Raises
    ------
    ValueError
        If every frame that was looked at is lost.
    """
    pixels = int(np.prod(work.stack_shape(1)))
    n_frames = int(np.clip(FOCUS_PIXELS // pixels, 1, FOCUS_FRAMES))
    n_views, *shape = work.stack_shape(1)[1:]
    n_looked_at = int(np.clip(MOST_FOCUS_PIXELS // int(np.prod(shape)), 1, n_views))
    views = np.linspace(0, n_views - 1, n_looked_at).round().astype(int)
    fields = np.concatenate([each[views] for each in fields_not_lost(work, rec, n_frames)])
    pixel_um = [rec.optics.pixel_um * ratio for ratio in work.demodulate.pixel_ratio]
    return autofocus(
        fields,
        # One distance for all views: it is looked for at the mean wavelength where they differ.
        with_common_light(rec.optics, work).wavelength_um,
        pixel_um,
        rec.optics.medium_index,
        metric=metric,
        objects=objects,
        progress=progress,
        cancelled=cancelled,
    )


def fields_not_lost(
    work: FrameReconstructor, rec: Recording, at_most: int
) -> list[NDArray[np.complex64]]:
    """Return the fields of some frames over a recording; for a lost one that of one near it."""
    wanted = rec.sample_indices(at_most)
    # Among these the usual strength of fringes was measured, so at least one is not lost.
    some = {*wanted, *rec.sample_indices(STATIC_FRAMES)}
    left = some | {index + 1 for index in some if index + 1 < rec.n_frames}
    found: list[NDArray[np.complex64]] = []
    lost: dict[int, str] = {}
    for middle in wanted:
        others = left.difference(wanted)
        for index in [middle, *sorted(others, key=lambda other: abs(other - middle))]:
            left.discard(index)
            fields, reason = work.fields_or_reason(rec, index)
            if fields is not None:
                found.append(fields)
                break
            lost[index] = reason
    if not found:
        raise ValueError(all_lost(rec.name, lost))
    return found
