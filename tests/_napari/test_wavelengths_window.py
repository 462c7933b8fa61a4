"""Two angles at two wavelengths in one hologram, from the file to the right result by clicks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr
from driving import answer_dialog
from scipy import ndimage

import napari_phase4d as p4d
from napari_phase4d._napari.menus import nanometres
from napari_phase4d._napari.steps.cells import of_view_number, over_time
from napari_phase4d._napari.viewing.layers import METADATA_KEY, stack_of_layer
from napari_phase4d.holography.lobes import pair_distance
from napari_phase4d.io import write_phase
from napari_phase4d.simulation import at_wavelengths, multiplexed_video, step_phantom
from test_wavelengths import ANGLES, CARRIERS, PUPIL, TWO, lobes_of
from test_wavelengths_trust import METHOD, cell_at_two, shifted_views

pytestmark = [pytest.mark.gui, pytest.mark.story]


@pytest.mark.thorough
def test_from_a_hologram_of_two_wavelengths_to_sheer_steps(
    viewer: Any, dock: Any, click: Any, qtbot: Any, tmp_path: Path
) -> None:
    plates = at_wavelengths(step_phantom((512, 512), (0.4, 0.9, 1.4), 2, angles_deg=ANGLES), TWO)
    video = multiplexed_video(
        plates["phase"], carriers=CARRIERS, pupil_radius=PUPIL, bits=12, drift_rad=0.3
    )
    path = tmp_path / "plates.tif"
    tifffile.imwrite(path, np.asarray(video.holograms.values), photometric="minisblack")
    answered = answer_dialog(path)
    click("open_file")
    assert answered()
    click("find_lobes")
    table = dock.lobes.table
    assert table.rowCount() == 4
    for row, lobe in enumerate(dock.session.lobes):
        known = min(lobes_of(), key=lambda k: pair_distance(k.carrier, lobe.carrier))
        table.item(row, 3).setText(f"{known.angle_deg:g}")
        table.item(row, 4).setText(f"{1000 * known.wavelength_um:g}")
    assert {(view.angle_deg, view.wavelength_um) for view in dock.session.lobes} == {
        (angle, light) for angle in ANGLES for light in TWO
    }
    # Found again, they keep what was typed; a cell that is emptied gives it back to step 1.
    click("find_lobes")
    assert {view.wavelength_um for view in dock.session.lobes} == set(TWO)
    table.item(0, 4).setText("")
    assert dock.session.lobes[0].wavelength_um is None
    table.item(0, 4).setText("532")
    table.item(0, 4).setText("blue")
    assert "takes a number" in dock.status.text()
    assert dock.session.lobes[0].wavelength_um == 0.532

    # A method of several wavelengths can be ticked once there are some.
    row = dock.unwrap.methods["synthetic-wavelength"]
    assert not row.tick.isEnabled()
    click("reconstruct")
    assert row.tick.isEnabled()
    layer = next(la for la in viewer.layers if la.name.startswith("wrapped"))
    stack = stack_of_layer(layer)
    np.testing.assert_allclose(stack["wavelength"], [TWO[0], TWO[1]] * 2)
    np.testing.assert_allclose(stack["angle"], np.repeat(ANGLES, 2))
    # Views of one angle have each a place on the slider.
    assert layer.scale[1] == 1
    for view in range(4):
        dock.presenter.go_to(1, view)
        assert dock.presenter.current_frame() == (1, view)
    assert layer.metadata[METADATA_KEY]["angles_deg"] == list(np.repeat(ANGLES, 2))

    dock.session.update(methods=("temporal-angular", "directional-l1", "synthetic-wavelength"))
    click("run")
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    assert dock.session.verdict.startswith("Use Synthetic")
    phase = dock.session.reconstruction["phase"]
    exact = plates["phase"].sel(y=phase["y"], x=phase["x"], method="nearest").values
    sign = -1 if dock.session.lobes[0].flip else 1
    results = dock.session.results
    # Beside the edges, where the optics smooth and a pixel more or less counts.
    plates_alone = ndimage.binary_erosion(exact > 1, np.ones((1, 1, 5, 5)))
    off = {m: np.abs(r.values - sign * exact)[plates_alone] > np.pi for m, r in results.items()}
    assert off["synthetic-wavelength"].mean() < 0.01
    assert off["directional-l1"].mean() > 0.5

    click("measure")
    measured = dock.session.measured
    assert set(measured["wavelength (um)"]) == set(TWO)
    (line,) = dock.compare.measuring.plot.figure.axes[0].get_lines()[:1]
    assert len(line.get_xdata()) == 2  # two times of the view on screen

    # Other optics leave the wavelengths that were typed; the path is that of each view.
    dock.session.recalibrate(
        dock.session.recording.calibrated(p4d.Optics(wavelength_um=0.7, magnification=40))
    )
    np.testing.assert_allclose(dock.session.reconstruction["wavelength"], [*TWO, *TWO])
    newest = dock.presenter.results()[-1]
    stack = stack_of_layer(newest)
    path_nm = nanometres(stack)
    for view, light in enumerate([*TWO, *TWO]):
        expected = stack.values[:, view] * 1000 * light / (2 * np.pi)
        np.testing.assert_allclose(path_nm[:, view], expected, rtol=1e-5)


def test_curves_of_cells_are_those_of_the_wavelength_on_screen() -> None:
    axes = {"time": [0.0, 1.0], "angle": [7.0, 7.0], "wavelength": ("angle", [0.532, 0.6328])}
    labels = xr.DataArray(
        np.zeros((2, 2, 3, 3), np.int32), dims=("time", "angle", "y", "x"), coords=axes
    )
    table = pd.DataFrame(
        {
            "time (s)": [0.0, 0.0, 1.0, 1.0],
            "angle (deg)": 7.0,
            "wavelength (um)": [0.532, 0.6328, 0.532, 0.6328],
            "mean phase (rad)": [1.0, 2.0, 3.0, 4.0],
        }
    )
    for view, expected in enumerate(([1.0, 3.0], [2.0, 4.0])):
        here = of_view_number(table, labels, view)
        found = over_time(here, "mean phase (rad)", labels["time"].values)
        assert found.tolist() == expected


@pytest.mark.thorough
def test_views_that_lie_off_each_other_are_said_beside_the_results(
    dock: Any, click: Any, qtbot: Any, tick_only: Any, tmp_path: Path
) -> None:
    """A warning of the work is not seen in the window, and the result was called safe."""
    data = shifted_views(cell_at_two(), 2, 1, 0.15)
    path = write_phase(tmp_path / "apart.ome.tif", data["wrapped"])
    dock.recording.open_path(path)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    tick_only("directional-l1", METHOD)
    click("run")
    click("show_confidence")
    said = " ".join(dock.compare.doubts())
    assert said.startswith("Use WL1")
    assert "-7°, 632.8 nm lies +2 px down and +1 px right of -7°, 532 nm" in said
