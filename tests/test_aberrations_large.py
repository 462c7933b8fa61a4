"""Fits to large fields: exact, in little memory, and stopped when asked to."""

from __future__ import annotations

import tracemalloc
import weakref
from typing import Literal

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe, corrections
from napari_phase4d.holography.aberrations import surface_of, surface_terms
from napari_phase4d.holography.background import Surface
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.lost import usual_fringes
from napari_phase4d.task import UNWATCHED, Cancelled


@pytest.mark.parametrize(
    ("kind", "order"), [("powers", 1), ("powers", 2), ("polynomial", 8), ("zernike", 8)]
)
def test_surface_is_the_sum_of_its_terms(kind: str, order: int) -> None:
    shape = (45, 64)
    terms = surface_terms(kind, order, shape)
    coefficients = np.random.default_rng(0).normal(size=len(terms))
    summed = np.tensordot(coefficients, terms, 1)
    np.testing.assert_allclose(surface_of(coefficients, kind, order, shape), summed, atol=1e-10)


@pytest.mark.slow
def test_large_field_is_fitted_in_little_memory() -> None:
    """1024 x 1024, degree 8: all terms on all pixels would take 380 MB."""
    shape = (1024, 1024)
    coefficients = np.zeros(45)
    coefficients[[3, 4, 6, 10, 20]] = 5, 2, -1, 0.5, 0.2
    known = surface_of(coefficients, "zernike", 8, shape)
    rng = np.random.default_rng(1)
    noise = 0.1 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    field = (np.exp(1j * known) + noise).astype(np.complex64)
    del noise
    tracemalloc.start()
    found, _ = Surface("zernike", 8, shape).fitted_to(field)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 200 * 2**20
    assert np.abs(found - (known - known.mean())).max() < 0.02


def test_fit_is_stopped_between_its_rounds() -> None:
    calls = []

    def stop_at_the_third() -> None:
        calls.append(1)
        if len(calls) == 3:
            raise Cancelled

    field = np.ones((64, 64), np.complex64)
    with pytest.raises(Cancelled):
        Surface("zernike", 4, field.shape).fitted_to(field, stop_at_the_third)
    assert len(calls) == 3


@pytest.mark.slow
def test_frames_are_summed_as_they_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the median no frame that was looked at is kept, however many there are."""
    frames = np.random.default_rng(2).integers(0, 200, (32, 64, 64)).astype(np.uint8)
    rec = p4d.open_recording(frames)
    lobes = [Lobe((0.2, 0.2), 0.2)]
    lost, _ = usual_fringes(rec, Demodulator(rec.frame_shape, lobes))
    alive, most = 0, 0

    def ended() -> None:
        nonlocal alive
        alive -= 1

    class Counted(Demodulator):
        def __call__(self, frame: np.ndarray) -> np.ndarray:
            nonlocal alive, most
            fields = super().__call__(frame)
            weakref.finalize(fields, ended)
            alive += 1
            most = max(most, alive)
            return fields

    # One after the other: how many the threads have in hand depends on how quick they are.
    monkeypatch.setattr(corrections, "in_threads", lambda work, items, watch: map(work, items))

    counted = Counted(rec.frame_shape, lobes)

    def correct(reference: Literal["median"] | None) -> None:
        corrections.corrections(
            rec, counted, reference, "tilt", 4, lost, {}, UNWATCHED, tilt_per_frame=False
        )

    correct(None)
    assert most <= 3  # the first, to which the others are turned, the last, and the next
    correct("median")
    assert most == 32
