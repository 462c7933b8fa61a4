"""Spectrum, demodulation, background, reconstruction, against exact truth."""

from __future__ import annotations

import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.holography import WINDOWS, Demodulator, Lobe, lobe_warnings, stray_terms
from napari_phase4d.holography.background import fitted_surface
from napari_phase4d.holography.emptyfield import background_offset, write_levelled
from napari_phase4d.holography.frames import FrameReconstructor
from napari_phase4d.phasors import parts_of
from napari_phase4d.simulation import multiplexed_video, swimming_euglena


def fringes(
    shape: tuple[int, int], carrier: tuple[float, float], phase: float = 0.0
) -> np.ndarray:
    y, x = np.indices(shape)
    turns = carrier[0] * y + carrier[1] * x
    return (100 + 40 * np.cos(2 * np.pi * turns + phase)).astype(np.float32)


@pytest.mark.parametrize("shape", [(64, 64), (63, 64), (64, 65), (51, 77)])
def test_power_spectrum_is_that_of_fft2(shape: tuple[int, int]) -> None:
    frames = np.random.default_rng(0).normal(size=(3, *shape)).astype(np.float32)
    spectrum = p4d.power_spectrum(p4d.open_recording(frames))
    window = np.outer(*(np.blackman(n + 2)[1:-1] for n in shape))
    centred = (frames - frames.mean((1, 2), keepdims=True)) * window
    expected = np.fft.fftshift((np.abs(np.fft.fft2(centred)) ** 2).mean(0))
    np.testing.assert_allclose(spectrum.values, expected, rtol=2e-3, atol=1e-4)
    assert spectrum.dims == ("ky", "kx")
    assert float(spectrum["ky"][shape[0] // 2]) == 0


def test_power_spectrum_tells_progress_and_can_be_cancelled() -> None:
    rec = p4d.open_recording(np.random.default_rng(0).normal(size=(6, 32, 32)))
    seen: list[int] = []
    p4d.power_spectrum(rec, progress=lambda done, total, _: seen.append(done))
    assert seen == [1, 2, 3, 4, 5, 6]
    with pytest.raises(p4d.Cancelled):
        p4d.power_spectrum(rec, cancelled=lambda: True)


@pytest.mark.slow
@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("shape", [(64, 64), (65, 64), (63, 77)])
@pytest.mark.parametrize(
    "carrier",
    [(0.2, 0.21), (-0.23, 0.19), (0.2503, 0.0), (0.0, 0.26), (0.2, 0.02), (-0.31, 0.013),
     (0.1, -0.25), (0.45, 0.1), (0.1, 0.46)],
)  # fmt: skip
def test_plane_wave_comes_back_with_its_phase(
    window: str, shape: tuple[int, int], carrier: tuple[float, float]
) -> None:
    """On the axes, at the edges of the spectrum, and with lobes between its pixels.

    The fringes fit into the frame, so that the result is exact: a constant phase, plus the ramp
    between the fringes' carrier and that of the lobe.
    """
    periodic = tuple(round(k * n) / n for k, n in zip(carrier, shape, strict=True))
    off = (0.3 / shape[0], -0.4 / shape[1])
    lobe = Lobe((periodic[0] + off[0], periodic[1] + off[1]), 0.09)
    demodulate = Demodulator(shape, [lobe], window)
    (field,) = demodulate(fringes(shape, periodic, phase=0.7))
    y, x = middles(shape, field.shape)
    expected = 0.7 - 2 * np.pi * (off[0] * y[:, None] + off[1] * x[None, :])
    assert np.abs(wrap(np.angle(field) - expected)).max() < 1e-4
    gain = WINDOWS[window](np.hypot(*off) / np.array(0.09))
    np.testing.assert_allclose(np.abs(field), 20 * gain, rtol=1e-4)


def test_field_equals_a_full_size_demodulation() -> None:
    """The small grid samples the same band-limited field as a transform at full size."""
    phase = swimming_euglena((128, 128), 1, pixel_um=0.35, peak_rad=5)["phase"]
    frame = multiplexed_video(phase, bits=12).frame(0)
    lobe = Lobe((0.19, 0.21), 0.11)
    (small,) = Demodulator(frame.shape, [lobe], "disk")(frame)
    ky, kx = np.fft.fftfreq(128)[:, None], np.fft.fftfreq(128)[None, :]
    inside = np.hypot(ky - lobe.carrier[0], kx - lobe.carrier[1]) <= lobe.radius
    band = np.fft.fftshift(np.fft.fft2(frame - frame.mean()) * inside)
    full = 4 * np.fft.ifft2(np.fft.ifftshift(np.pad(band, 64)))  # two samples a camera pixel
    y, x = np.indices((256, 256)) / 2
    full = full * np.exp(-2j * np.pi * (lobe.carrier[0] * y + lobe.carrier[1] * x))
    ratio = 128 / small.shape[0]
    assert ratio == 4  # 2 * 0.11 * 128 = 28.2 fits into 32
    # Four camera pixels, 0 to 3, have their middle at 1.5.
    np.testing.assert_allclose(small, full[3::8, 3::8], atol=2e-5 * np.abs(full).max())


@pytest.mark.parametrize("shape", [(160, 160), (158, 171)])
def test_edges_are_as_good_as_the_rest(shape: tuple[int, int]) -> None:
    """Fringes that don't fit into the frame: the first row and column were 0.8 rad off once."""
    true = (0.19, 0.2098)
    frame = fringes(shape, true, phase=0.7)
    (field,) = Demodulator(shape, [Lobe(true, 0.1)])(frame)
    error = np.abs(wrap(np.angle(field) - 0.7))
    sides = [error[0], error[-1], error[:, 0], error[:, -1]]
    assert max(np.sqrt(np.mean(side**2)) for side in sides) < 0.25
    assert error[2:-2, 2:-2].max() < 0.1


def test_mirrored_frame_gives_the_mirrored_field() -> None:
    """Neither side of a frame is treated better than the other one."""
    frame = np.random.default_rng(3).normal(100, 20, (96, 110)).astype(np.float32)
    (field,) = Demodulator(frame.shape, [Lobe((0.2, 0.21), 0.09)])(frame)
    (back,) = Demodulator(frame.shape, [Lobe((-0.2, 0.21), 0.09)])(frame[::-1].copy())
    turn = field * back[::-1].conj()
    turn = turn / np.abs(turn)
    assert np.abs(np.angle(turn / turn[0, 0])).max() < 1e-3
    np.testing.assert_allclose(np.abs(back[::-1]), np.abs(field), rtol=1e-3)


def test_flip_gives_the_conjugate() -> None:
    frame = fringes((64, 64), (0.2, 0.2), phase=0.4)
    plain, flipped = Demodulator(
        (64, 64), [Lobe((0.2, 0.2), 0.1), Lobe((0.2, 0.2), 0.1, flip=True)]
    )(frame)
    np.testing.assert_array_equal(flipped, plain.conj())


def test_background_fit_finds_tilt_and_curvature_round_an_object() -> None:
    y, x = np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-1, 1, 90), indexing="ij")
    aberration = 5 * x - 3 * y + 1.5 * x**2 + 0.8 * x * y - y**2
    cell = 6 * np.sqrt(np.maximum(1 - (x / 0.5) ** 2 - (y / 0.6) ** 2, 0))
    field = np.exp(1j * (aberration + cell + 0.4)).astype(np.complex64)
    surface, _ = fitted_surface(field[None], order=2)
    np.testing.assert_allclose(surface, aberration - aberration.mean(), atol=0.02)
    assert background_offset(field * np.exp(-1j * surface)) == pytest.approx(
        wrap(0.4 + aberration.mean()), abs=0.02
    )


@pytest.mark.thorough
def test_reconstruction_is_within_a_tenth_of_a_radian_of_truth(
    reconstruction, truth, sample, lobes
) -> None:
    """The whole way through optics, camera and finder: wrapped phase against exact truth."""
    for lobe, carrier in zip(lobes, sample.recording.holograms.attrs["carriers"], strict=True):
        np.testing.assert_allclose(lobe.carrier, carrier, atol=2e-4)
    amplitude = reconstruction["amplitude"].values
    bright = amplitude > 0.5 * np.median(amplitude)
    error = wrap(reconstruction["phase"].values - truth.values)[bright]
    assert bright.mean() > 0.97
    assert np.sqrt(np.mean(error**2)) < 0.1


@pytest.mark.slow
def test_pixel_of_the_reconstruction_is_recorded(reconstruction, sample) -> None:
    ratio = reconstruction.attrs["pixel_ratio"]
    pixel = sample.recording.optics.pixel_um
    assert ratio[0] == pytest.approx(512 / reconstruction.sizes["y"])
    assert np.diff(reconstruction["y"]) == pytest.approx(ratio[0] * pixel)
    first, last = float(reconstruction["y"][0]), float(reconstruction["y"][-1])
    # Both grids cover the same area, from half a camera pixel before the first one's middle on.
    assert first - ratio[0] * pixel / 2 == pytest.approx(-pixel / 2)
    assert last + ratio[0] * pixel / 2 == pytest.approx(511.5 * pixel)
    assert reconstruction["phase"].dtype == np.float32
    assert reconstruction["phase"].dims == ("time", "angle", "y", "x")
    np.testing.assert_allclose(reconstruction["angle"], [-7, 21])


@pytest.mark.slow
def test_drift_is_removed_or_kept() -> None:
    exact = swimming_euglena((128, 128), 8, pixel_um=0.35, peak_rad=4)
    video = multiplexed_video(exact["phase"], drift_rad=0.5, seed=3)
    drift = np.array(video.holograms.attrs["drift_rad"])
    lobes = p4d.find_lobes(video, 2)
    still = p4d.reconstruct(video, lobes, drift=True)["phase"].values
    moving = p4d.reconstruct(video, lobes, drift=False)["phase"].values
    corner = (slice(None), 0, slice(4, 8), slice(4, 8))
    assert np.abs(still[corner]).max() < 0.15
    track = np.angle(np.exp(1j * moving[corner]).mean((1, 2)))
    np.testing.assert_allclose(wrap(track - track[0]), wrap(drift - drift[0]), atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["recording", "array", "frame", "median"])
def test_reference_takes_off_static_errors(how: str) -> None:
    exact = swimming_euglena((128, 128), 9, pixel_um=0.35, peak_rad=4)
    empty = multiplexed_video(exact["phase"][:1] * 0, curvature_rad=6.0, seed=9)
    phase = exact["phase"]
    if how in ("frame", "median"):  # the object shows up in few frames
        phase = phase.copy()
        phase[:7] = 0
    video = multiplexed_video(phase, curvature_rad=6.0)
    lobes = [Lobe((0.19, 0.21), 0.1), Lobe((-0.21, 0.19), 0.1, 1.0)]
    reference = {
        "recording": empty, "array": empty.holograms.values[0], "frame": 0, "median": "median",
    }[how]  # fmt: skip
    found = p4d.reconstruct(video, lobes, reference, background="none")["phase"].values
    lies = [(0.35 * ratio, 0.35 * (ratio - 1) / 2) for ratio in np.divide(128, found.shape[2:])]
    pixel, first = zip(*lies, strict=True)
    expected = swimming_euglena(found.shape[2:], 9, pixel_um=pixel, first_um=first, peak_rad=4)[
        "phase"
    ].values
    error = wrap(found[8] - expected[8])[:, 4:-4, 4:-4]
    assert np.sqrt(np.mean(error**2)) < 0.15
    plain = p4d.reconstruct(video, lobes, background="none")["phase"].values
    assert np.sqrt(np.mean(wrap(plain[8] - expected[8]) ** 2)) > 0.5


@pytest.mark.slow
def test_views_come_in_the_order_of_their_angles(small_video) -> None:
    first, second = p4d.find_lobes(small_video, 2, angles_deg=(21, -7))
    data = p4d.reconstruct(small_video, [first, second])
    swapped = p4d.reconstruct(small_video, [second, first])
    np.testing.assert_allclose(data["angle"], [-7, 21])
    np.testing.assert_array_equal(data["phase"].values, swapped["phase"].values)
    alike = [Lobe(first.carrier, 0.1), Lobe(second.carrier, 0.1)]
    np.testing.assert_allclose(p4d.reconstruct(small_video, alike)["angle"], [0, 1])


def test_reconstruction_tells_progress_and_can_be_cancelled(small_video) -> None:
    lobes = p4d.find_lobes(small_video, 2)
    seen: list[tuple[int, int]] = []
    p4d.reconstruct(small_video, lobes, progress=lambda d, t, _: seen.append((d, t)))
    assert seen == [(i, 6) for i in range(1, 7)]
    with pytest.raises(p4d.Cancelled, match="cancelled after 2 of 6"):
        p4d.reconstruct(
            small_video, lobes, background="none",
            progress=lambda d, t, _: seen.append((d, t)), cancelled=lambda: len(seen) >= 8,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"window": "square"}, "window must be one of disk"),
        ({"background": "plane"}, "background must be one of none"),
        ({"lobes": []}, "there is no lobe"),
        ({"reference": 99}, "reference frame 99 does not exist"),
        ({"reference": np.zeros((32, 32))}, "the reference is .* but the frames are"),
        ({"reference": np.full((128, 128), 7.0)}, "the reference shows no fringes"),
    ],
)
def test_bad_settings_give_one_sentence(small_video, arguments: dict, sentence: str) -> None:
    settings = {"lobes": [Lobe((0.19, 0.21), 0.1)], **arguments}
    with pytest.raises(ValueError, match=sentence):
        p4d.reconstruct(small_video, **settings)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (((0.6, 0.1), 0.1), "lies outside the spectrum"),
        (((0.2, 0.1), 0.0), "lobe radius must lie between"),
        (((0.2, 0.1), 0.7), "lobe radius must lie between"),
        (((np.nan, 0.1), 0.1), "lies outside the spectrum"),
        (((0.2, 0.1), 0.1, np.inf), "viewing angle must be a number"),
    ],
)
def test_lobes_outside_the_spectrum_are_refused(arguments: tuple, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Lobe(*arguments)


NEAR, FAR = "make it smaller or move it away.", "make them smaller or move them apart."
ZERO_ORDER = "Circle 1 overlaps the zero order: make it smaller or move it outwards."
EDGE = "Circle 1 reaches beyond the edge of the spectrum: make it smaller or move it inwards."
OWN = "Circle 1 overlaps its own conjugate (dashed): make it smaller or move it inwards."


@pytest.mark.parametrize(
    ("circles", "sentences"),
    [
        ([(0.19, 0.21, 0.0943), (-0.21, 0.19, 0.0943)], []),  # side by side without a gap
        ([(0.2, 0.1, 0.42 * np.hypot(0.2, 0.1))], []),  # as near as the finder goes
        ([(0.25, 0.0, 0.249)], [ZERO_ORDER]),
        ([(0.2, 0.1, 0.45 * np.hypot(0.2, 0.1))], [ZERO_ORDER]),
        ([(0.45, 0.2, 0.06)], [EDGE]),
        ([(0.1, -0.44, 0.06)], []),  # up to the edge
        ([(0.48, 0.0, 0.019)], []),
        ([(0.49, 0.0, 0.015)], [EDGE, OWN]),
        ([(0.3, 0.1, 0.05), (0.3, 0.19, 0.05)], [f"Circle 1 overlaps circle 2: {FAR}"]),
        ([(0.3, 0.1, 0.05), (-0.3, -0.19, 0.05)],
         [f"Circle 1 overlaps the conjugate (dashed) of circle 2: {FAR}"]),
        ([(0.3, 0.1, 0.05), (0.3, 0.19, 0.05), (0.22, 0.15, 0.05), (0.36, 0.16, 0.05)],
         [f"Circle 1 overlaps circles 2, 3 and 4: {FAR}",
          f"Circle 2 overlaps circles 3 and 4: {FAR}"]),
        ([(0.19, 0.21, 0.09), (-0.21, 0.19, 0.09), (0.4, 0.02, 0.05)],
         ["Circle 2 lies on the beat of circles 1 and 3: it may be no view of its own; "
          "move or remove it.",
          "Circle 3 lies on the beat of circles 1 and 2: it may be no view of its own; "
          "move or remove it."]),
        # Where one is nearly the difference of two, so is one of these of the others.
        ([(0.3, 0.0, 0.05), (0.13, 0.3, 0.05), (0.26, -0.26, 0.05)],
         [f"Circle 2 overlaps the beat of circles 1 and 3: {NEAR}",
          f"Circle 3 overlaps the beat of circles 1 and 2: {NEAR}"]),
        # The beat, at (0.77, -0.15), is folded back to (-0.23, -0.15).
        ([(0.42, 0.05, 0.03), (-0.35, 0.2, 0.03), (0.23, 0.21, 0.03)],
         [f"Circle 1 overlaps the beat of circles 2 and 3: {NEAR}",
          f"Circle 3 overlaps the beat of circles 1 and 2: {NEAR}"]),
    ],
)  # fmt: skip
def test_overlaps_are_said_in_words(circles: list, sentences: list[str]) -> None:
    lobes = [Lobe((ky, kx), r, float(i)) for i, (ky, kx, r) in enumerate(circles)]
    assert lobe_warnings(lobes) == sentences


def test_angles_that_are_the_same_are_said_in_words() -> None:
    places = [(0.3, 0.0), (0.0, 0.3), (0.3, 0.3), (-0.3, 0.3), (0.15, 0.4), (-0.15, 0.4)]
    alike = [Lobe(k, 0.01, angle) for k, angle in zip(places, (5, 5, 0, 5, -2, 0), strict=True)]
    assert [w for w in lobe_warnings(alike) if "angle" in w] == [
        "Circles 1, 2 and 4 have the same angle (5°): type in their angles, or all views will be "
        "numbered.",
        "Circles 3 and 6 have the same angle (0°): type in their angles, or all views will be "
        "numbered.",
    ]
    assert lobe_warnings([]) == []


def test_six_views_have_one_sentence_a_circle_and_trouble() -> None:
    six = [Lobe((0.02 * i, 0.3), 0.12, float(i)) for i in range(6)]
    found = lobe_warnings(six)
    assert len(found) == len(set(found))
    for i in range(1, 6):
        assert sum(w.startswith(f"Circle {i} overlaps circle") for w in found) == 1
    assert len(found) <= 4 * 6


def test_stray_terms_are_where_two_disks_correlate() -> None:
    """Their place and reach, against the correlation of two disks of pixels."""
    n = 200
    ky, kx = np.fft.fftfreq(n)[:, None], np.fft.fftfreq(n)[None, :]
    lobes = [Lobe((0.15, 0.2), 0.05), Lobe((-0.2, 0.25), 0.08), Lobe((0.35, -0.25), 0.03)]
    disks = [np.hypot(ky - lobe.carrier[0], kx - lobe.carrier[1]) <= lobe.radius for lobe in lobes]
    zero_order, *beats = stray_terms(lobes)
    assert zero_order.pair is None
    assert [beat.pair for beat in beats] == [(0, 1), (0, 2), (1, 2)]
    for term, i, j in [(zero_order, 1, 1), *((beat, *beat.pair) for beat in beats)]:
        product = np.fft.ifft2(disks[i]) * np.fft.ifft2(disks[j]).conj()
        correlation = np.fft.fft2(product).real * n**2
        y, x = np.nonzero(correlation > 0.5)
        offsets = [ky[y, 0] - term.centre[0], kx[0, x] - term.centre[1]]
        distance = np.hypot(*(d - np.round(d) for d in offsets))
        assert distance.max() == pytest.approx(term.radius, abs=1.5 / n)


@pytest.mark.slow
def test_what_a_finder_accepts_is_without_warning(lobes, small_video) -> None:
    assert lobe_warnings(lobes) == []
    assert lobe_warnings(p4d.find_lobes(small_video, 2)) == []


def test_a_single_frame_is_no_trouble(small_video) -> None:
    one = p4d.open_recording(small_video.holograms.values[:1])
    data = p4d.reconstruct(one, p4d.find_lobes(one, 2))
    assert np.isfinite(data["phase"].values).all()
    assert np.isfinite(p4d.power_spectrum(one).values).all()


def middles(shape: tuple[int, ...], size: tuple[int, ...]) -> list[np.ndarray]:
    """Where the pixels of a field have their middles, along y and x in camera pixels."""
    return [(np.arange(m) + 0.5) * n / m - 0.5 for n, m in zip(shape, size, strict=True)]


def plainly_demodulated(frame: np.ndarray, lobe: Lobe, window: str) -> np.ndarray:
    """One lobe by a full transform in float64, cut out and moved pixel by pixel."""
    spectrum = np.fft.fft2(frame.astype(np.float64) - frame.mean(dtype=np.float64))
    demodulate = Demodulator(frame.shape, [lobe], window)
    size = demodulate.output_shape
    rows, columns = (
        round(k * n) + np.round(np.fft.fftfreq(m, 1 / m)).astype(int)
        for k, n, m in zip(lobe.carrier, frame.shape, size, strict=True)
    )
    off_y = rows / frame.shape[0] - lobe.carrier[0]
    off_x = columns / frame.shape[1] - lobe.carrier[1]
    rho = np.hypot(off_y[:, None], off_x[None, :]) / lobe.radius
    block = spectrum[np.ix_(rows % frame.shape[0], columns % frame.shape[1])]
    y, x = middles(frame.shape, size)
    waves_y, waves_x = (np.exp(2j * np.pi * np.outer(p, k)) for p, k in ((y, off_y), (x, off_x)))
    field = waves_y @ (block * WINDOWS[window](rho)) @ waves_x.T / frame.size
    return field.conj() if lobe.flip else field


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2", np.float32])
@pytest.mark.parametrize("shape", [(96, 128), (97, 128), (300, 131), (133, 101)])
@pytest.mark.parametrize(
    "carriers",
    [
        [(0.2, 0.21), (-0.21, 0.19)],  # shared columns, one wrapping to ky < 0
        [(0.19, -0.23), (-0.2, -0.21)],  # read from the conjugate side
        [(0.3, 0.1), (-0.1, 0.35), (0.02, -0.28)],  # three, side by side and on both sides
        [(0.31, 0.01), (-0.3, -0.02)],  # across kx = 0
        [(0.2, 0.47), (-0.2, -0.46), (0.48, 0.2)],  # across the edges of the spectrum
        [(0.03, 0.02)],  # over the zero frequency
    ],
)
def test_fields_are_those_of_a_plain_transform(
    carriers: list[tuple[float, float]], shape: tuple[int, int], dtype: str
) -> None:
    """Pruned transforms in float32 give what a full one in float64 gives."""
    rng = np.random.default_rng(1)
    speckle = rng.normal(128, 30, shape) + sum(fringes(shape, k) - 100 for k in carriers)
    peak = 60000 if np.dtype(dtype).itemsize == 2 else 255
    frame = np.clip(speckle / 255 * peak, 0, peak).astype(dtype)
    lobes = [Lobe(k, 0.09, flip=bool(i % 2)) for i, k in enumerate(carriers)]
    for window in ("disk", "smooth-disk"):
        for field, lobe in zip(Demodulator(shape, lobes, window)(frame), lobes, strict=True):
            expected = plainly_demodulated(frame, lobe, window)
            assert field.dtype == np.complex64
            largest = np.abs(expected).max()
            np.testing.assert_allclose(field, expected, atol=2e-6 * largest)
            bright = np.abs(expected) > 0.05 * largest
            assert np.abs(np.angle(field * expected.conj())[bright]).max() < 1e-4


def test_widest_lobes_are_those_of_a_plain_transform() -> None:
    frame = np.random.default_rng(2).normal(size=(65, 78)).astype(np.float32)
    for carrier in [(0.5, 0.5), (-0.4, -0.3), (0.0, 0.0)]:
        lobe = Lobe(carrier, 0.5)
        (field,) = Demodulator(frame.shape, [lobe], "gaussian")(frame)
        np.testing.assert_allclose(field, plainly_demodulated(frame, lobe, "gaussian"), atol=1e-6)


def test_frame_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the frame is \(64, 65\) pixels, but the lobes"):
        Demodulator((64, 64), [Lobe((0.2, 0.2), 0.1)])(np.zeros((64, 65), np.uint8))


@pytest.mark.parametrize("offset", [0.0, 1.3, 3.1, -3.1])
def test_background_offset_is_found_across_the_jump_at_pi(offset: float) -> None:
    """The mode, then the mean within narrower and narrower limits, as plain numbers give it."""
    rng = np.random.default_rng(4)
    noise = rng.normal(0, 0.3, (90, 120))
    noise[30:60, 30:60] += np.linspace(0, 9, 30)
    field = (np.exp(1j * (noise + offset)) * rng.uniform(0.5, 1, noise.shape)).astype(np.complex64)
    expected = offset
    for limit in (1.0, 0.6, 0.5, 0.5, 0.5):
        near = np.abs(wrap(np.angle(field) - expected)) < limit
        expected = np.angle(field[near].sum())
    found = background_offset(field)
    assert -np.pi <= found <= np.pi
    assert abs(wrap(found - expected)) < 5e-3
    share = np.mean(np.abs(wrap(np.angle(field) - found)) < 0.8)
    phase, amplitude = np.empty((2, *field.shape), np.float32)
    assert write_levelled(parts_of(field), amplitude, phase, True) == pytest.approx(
        share, abs=1e-4
    )
    assert np.abs(wrap(phase - (np.angle(field) - found))).max() < 2e-6
    assert np.abs(amplitude - np.abs(field)).max() < 1e-6
    assert write_levelled(parts_of(field), amplitude, phase, False) == 1
    assert np.abs(wrap(phase - np.angle(field))).max() < 1e-6


def test_each_view_has_its_share_of_empty_field() -> None:
    phase = np.random.default_rng(2).uniform(-np.pi, np.pi, (2, 50, 60)).astype(np.float32)
    phase[0] *= 0.01
    each = FrameReconstructor(
        lambda _: np.exp(1j * phase).astype(np.complex64),
        np.ones((1, 1, 1), np.complex64),
        True,
        [0.0, 1.0],
        {},
    )
    room = np.empty((2, *phase.shape), np.float32)
    shares = each(np.zeros((9, 9)), *room)
    # All of the one; of the other what lies within 0.8 rad to either side.
    assert shares == pytest.approx((1, 0.8 / np.pi), abs=0.05)


def test_reconstruction_equals_its_plain_formula(small_video) -> None:
    """Written into the result by threads, without changing what a frame alone gives."""
    lobes = p4d.find_lobes(small_video, 2, angles_deg=(-7, 21))
    data = p4d.reconstruct(small_video, lobes, reference=0, background="none")
    frames = small_video.holograms.values
    for t, v in np.ndindex(len(frames), 2):
        lobe = sorted(lobes, key=lambda lobe: lobe.angle_deg)[v]
        field, empty = (plainly_demodulated(frames[i], lobe, "smooth-disk") for i in (t, 0))
        floor = 0.05 * np.median(np.abs(empty))
        field = field * empty.conj() / np.maximum(np.abs(empty), floor) ** 2
        field *= np.exp(-1j * background_offset(field.astype(np.complex64)))
        found = data["phase"].values[t, v]
        assert np.abs(found).max() <= np.float32(np.pi)
        bright = np.abs(field) > 0.1
        assert np.abs(wrap(found - np.angle(field))[bright]).max() < 1e-4
        np.testing.assert_allclose(data["amplitude"].values[t, v], np.abs(field), atol=1e-4)


def test_raw_frames_are_the_camera_numbers() -> None:
    grey = np.arange(3 * 16 * 16).reshape(3, 16, 16)
    raw = p4d.open_recording(grey.astype(">u2")).raw_frame(2)
    assert raw.dtype == np.dtype(">u2")
    np.testing.assert_array_equal(raw, grey[2])
    assert p4d.open_recording(grey.astype(np.float64)).raw_frame(1).dtype == np.float32


@pytest.mark.parametrize("level", [100, 2000, 60000])
def test_frames_without_fringes_are_refused(level: int) -> None:
    frames = np.full((3, 200, 240), level, np.uint16)
    lobes = [Lobe((0.19, 0.21), 0.08), Lobe((-0.21, 0.19), 0.08)]
    rec = p4d.open_recording(frames)
    with pytest.raises(ValueError, match="no frame of .* shows fringes: frame 0 is blank"):
        p4d.reconstruct(rec, lobes)


def test_a_reference_without_fringes_is_refused(small_video) -> None:
    blank = np.full(small_video.frame_shape, 100, np.uint16)
    with pytest.raises(ValueError, match="the reference shows no fringes"):
        p4d.reconstruct(small_video, p4d.find_lobes(small_video, 2), reference=blank)


def test_weak_fringes_on_a_bright_field_keep_their_phase() -> None:
    y, x = np.mgrid[:512, :640]
    fringes = 5 * np.cos(2 * np.pi * (0.2 * y + 0.02 * x) + np.exp(-((x - 300) ** 2) / 5000))
    demodulate = Demodulator((512, 640), [Lobe((0.2, 0.02), 0.015)])
    weak = demodulate((fringes + 50000).astype(np.float32))
    alone = demodulate((fringes + 50000).astype(np.float32) - np.float32(50000))
    assert np.abs(np.angle(weak * alone.conj()))[0, 5:-5, 5:-5].max() < 1e-5
