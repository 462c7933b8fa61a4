"""Methods that make no sense for the phase that there is can't be ticked, and are not run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from driving import open_by_click, saved

import napari_phase4d as p4d
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import METHODS, methods_for, why_unsuited

DEFAULT = p4d.Recipe().methods


@pytest.mark.parametrize(
    ("shape", "left_out"),
    [
        ((1, 1), {"angular", "temporal", "temporal-angular", "angular-temporal", "spatial-3d"}),
        ((5, 1), {"angular", "temporal-angular", "angular-temporal"}),
        ((1, 2), {"temporal", "temporal-angular", "angular-temporal", "spatial-3d"}),
        ((5, 2), set()),
    ],
)
def test_what_goes_along_one_frame_gives_what_another_method_gives(shape, left_out) -> None:
    every, suiting = methods_for(None), methods_for(None, shape)
    assert set(every) - set(suiting) == left_out
    # Thick and noisy, so that methods differ where they can.
    exact = p4d.simulation.swimming_euglena((60, 72), shape[0], peak_rad=25)
    phase = exact["phase"].isel(angle=slice(shape[1]))
    noise = np.random.default_rng(0).normal(0, 0.9, phase.shape)
    wrapped = np.angle(np.exp(1j * (phase.values + noise))).astype("f4")
    for method in left_out:
        why = why_unsuited(method, None, shape)
        same = next(m for m in suiting if f": {METHODS[m].label} gives the same." in why)
        found, other = (p4d.unwrap(wrapped, m, mask="auto") for m in (method, same))
        np.testing.assert_allclose(found, other, atol=1e-4)


def test_views_of_another_wavelength_are_no_other_angle() -> None:
    assert "angular" not in methods_for([0.532, 0.6328], (5, 2))
    assert "angular" in methods_for([0.532, 0.6328, 0.532, 0.6328], (5, 4))


@pytest.mark.gui
@pytest.mark.thorough
def test_one_frame_is_unwrapped_by_what_suits_it(
    dock, click, qtbot, tmp_path: Path, small_video: Recording
) -> None:
    exact = p4d.simulation.swimming_euglena((96, 112), 1, pixel_um=0.35, peak_rad=6)
    single = p4d.simulation.multiplexed_video(
        exact["phase"].isel(angle=[0]), carriers=[(0.19, 0.21)]
    )
    open_by_click(click, dock, saved(tmp_path, "one", single.holograms.values))
    click("find_lobes")
    click("reconstruct")
    assert dock.session.reconstruction["phase"].shape[:2] == (1, 1)
    ticks = {method: row.tick for method, row in dock.unwrap.methods.items()}
    suiting = ["spatial-2d", "directional-l1"]
    assert [m for m, tick in ticks.items() if tick.isChecked()] == suiting
    assert all(ticks[method].isEnabled() for method in suiting)
    assert not ticks["temporal-angular"].isEnabled()
    assert "only one time and one view: 2-D" in ticks["temporal-angular"].toolTip()
    click("method_temporal-angular")  # does nothing
    assert dock.unwrap.list.lacking.isVisible()
    assert "Only one time and one view" in dock.unwrap.list.lacking.text()
    click("run")
    assert list(dock.session.results) == suiting
    assert "done" in dock.sections[3].badge.text()
    # Who names a method gets it all the same.
    assert list(dock.session.unwrap(["temporal-angular"]).index) == ["temporal-angular"]
    dock.session.update(methods=DEFAULT)

    # What is ticked is as it was for a recording that has times and views.
    click("method_directional-l1")
    open_by_click(click, dock, saved(tmp_path, "video", small_video.holograms.values))
    click("find_lobes")
    click("reconstruct")
    ticked = [m for m in DEFAULT if m != "directional-l1"]
    assert [m for m, tick in ticks.items() if tick.isChecked()] == ticked
    assert ticks["temporal-angular"].isEnabled()
    assert not dock.unwrap.list.lacking.isVisible()
    assert "only" not in ticks["temporal-angular"].toolTip()
