"""Each cell found, followed, looked at, corrected and saved by clicks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from driving import LEFT, PLAIN, answer_dialog, canvas_of, let_settle, place_of
from napari.layers import Labels, Points, Tracks
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from helpers import measured
from napari_phase4d._napari.viewing.pointing import frames_of_regions, regions_of_layer
from napari_phase4d.analysis import region_with_cell
from napari_phase4d.plotting import colour_of

pytestmark = pytest.mark.gui


@pytest.fixture
def unwrapped(dock):
    """Return the dock with an unwrapped recording of several cells."""
    sample = p4d.simulation.swimming_cells((112, 144), 10, 3, divisions=1, leaving=1, entering=0)
    dock.session.set_phase(sample["wrapped"])
    dock.session.unwrap(["directional-l1", "temporal"], mask=None)
    return dock


def shown(viewer, kind):
    """Return the only visible layer of a kind."""
    (layer,) = (la for la in viewer.layers if isinstance(la, kind) and la.visible)
    return layer


def curves_of(part) -> dict[str, np.ndarray]:
    (axes,) = part.plot.figure.axes
    return {li.get_label(): li.get_ydata() for li in axes.lines if len(li.get_xdata()) > 2}


@pytest.mark.thorough
def test_cells_are_found_shown_and_saved_by_clicks(viewer, unwrapped, click, tmp_path: Path):
    part = unwrapped.compare.cells
    click("find_cells")
    result = unwrapped.session.results["directional-l1"]
    cells = p4d.find_cells(result)
    trust = unwrapped.session.outcome.comparison.confidence("directional-l1")
    table = p4d.measure(result, cells, p4d.Optics(), confidence=trust)
    pd.testing.assert_frame_equal(unwrapped.session.cells.table, table)
    outlines, numbers, ways = (shown(viewer, kind) for kind in (Labels, Points, Tracks))
    np.testing.assert_array_equal(np.asarray(outlines.data), cells.values)
    phase = next(la for la in viewer.layers if la.name == "WL1")
    assert phase.visible
    assert not viewer.canvas.grid.enabled
    for layer in (outlines, numbers, ways):
        np.testing.assert_allclose(layer.scale, phase.scale)
        np.testing.assert_allclose(layer.translate, phase.translate)
        assert layer.units == phase.units
        assert layer.axis_labels == phase.axis_labels
    # The number of each cell stands in it, in every frame.
    places = np.rint(np.asarray(numbers.data)).astype(int)
    np.testing.assert_array_equal(cells.values[tuple(places.T)], numbers.features["cell"])
    # One colour for each cell, in picture, ways, curve and table.
    for row, cell in enumerate(np.unique(table["cell"])):
        colour = colour_of(int(cell))
        rgb = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        np.testing.assert_allclose(outlines.get_color(int(cell))[:3], rgb, atol=0.01)
        (line,) = (li for li in part.plot.figure.axes[0].lines if li.get_label() == f"cell {cell}")
        assert line.get_color() == colour
        assert part.table.item(row, 0).data(1).name() == colour
        vertices = np.asarray(ways.data)[:, 0] == cell
        if vertices.any():
            np.testing.assert_allclose(ways.track_colors[vertices][0, :3], rgb, atol=0.01)
    picture = viewer.screenshot(canvas_only=True, flash=False)[..., :3].astype(int)
    for cell in np.unique(outlines.data[unwrapped.presenter.current_frame()])[1:]:
        drawn = np.array([int(colour_of(int(cell))[i : i + 2], 16) for i in (1, 3, 5)])
        assert (abs(picture - drawn).max(axis=-1) <= 3).sum() > 200
    part.save_to(tmp_path / "cells.csv")
    saved = pd.read_csv(tmp_path / "cells.csv")
    pd.testing.assert_frame_equal(saved, table)
    assert len(pd.read_csv(tmp_path / "cells_summary.csv")) == table["cell"].nunique()
    part.save_to(tmp_path / "cells.svg")
    assert (tmp_path / "cells.svg").stat().st_size > 5000
    unwrapped.session.save(tmp_path / "everything")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "everything" / "cells.csv"), table)
    # Phase from memory was never a file: nothing that lies around is taken for its input.
    note = json.loads((tmp_path / "everything" / "run.json").read_text())
    assert set(note["input"]) == {"name"}
    assert unwrapped.session.outcome.recipe.cells == p4d.CellSettings()


@pytest.mark.thorough
def test_pixels_in_doubt_count_without_being_asked_for(dock):
    sample = p4d.simulation.swimming_cells((96, 112), 4, 2, peak_rad=12, divisions=0, leaving=0)
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.5, sample["wrapped"].shape)
    wrapped = np.angle(np.exp(1j * (sample["wrapped"].values + noise))).astype(np.float32)
    dock.session.set_phase(sample["wrapped"].copy(data=wrapped))
    dock.session.unwrap(["temporal"], mask=None)
    assert not dock.session.confidence
    cells = dock.session.find_cells()
    comparison = dock.session.outcome.comparison
    result, name = comparison.results["temporal"], "dry mass error (pg)"
    trust = comparison.confidence("temporal")
    wanted = p4d.measure(result, cells.labels, p4d.Optics(), confidence=trust)
    pd.testing.assert_frame_equal(cells.table, wanted)
    assert (wanted[name] > p4d.measure(result, cells.labels, p4d.Optics())[name]).any()


@pytest.mark.thorough
def test_ways_follow_the_angle_on_screen(viewer, unwrapped, qtbot):
    cells = unwrapped.session.find_cells()
    for angle in (1, 0):
        unwrapped.presenter.go_to(3, angle)
        let_settle(qtbot, unwrapped)
        ways = shown(viewer, Tracks)
        assert set(np.asarray(ways.data)[:, 2]) == {angle}
        here = cells.table["angle (deg)"] == float(cells.labels["angle"][angle])
        assert len(ways.data) == here.sum()
    viewer.layers.remove(shown(viewer, Tracks))
    unwrapped.presenter.go_to(3, 1)
    let_settle(qtbot, unwrapped)
    assert not [la for la in viewer.layers if isinstance(la, Tracks)]


@pytest.mark.thorough
def test_a_click_on_a_cell_shows_it_alone(viewer, unwrapped, click, qtbot):
    part = unwrapped.compare.cells
    click("find_cells")
    table = unwrapped.session.cells.table
    unwrapped.presenter.go_to(2, 0)
    at = table[(table["cell"] == 2) & (table["angle (deg)"] == -7.0)].iloc[2]
    click_on(viewer, at["y (um)"], at["x (um)"])
    assert part.chosen == [2]
    curves = curves_of(part)
    assert list(curves) == ["cell 2"]
    here = table[(table["cell"] == 2) & (table["angle (deg)"] == -7.0)]
    np.testing.assert_allclose(curves["cell 2"], here["dry mass (pg)"])
    (band,) = part.plot.figure.axes[0].collections
    upper = band.get_paths()[0].vertices[:, 1].max()
    highest = (here["dry mass (pg)"] + here["dry mass error (pg)"]).max()
    assert upper == pytest.approx(float(highest))
    click("cell_by_methods")
    assert set(curves_of(part)) == {"WL1", "Temporal"}
    np.testing.assert_allclose(curves_of(part)["WL1"], here["dry mass (pg)"])
    click_on(viewer, float(table["y (um)"].min()) - 3, float(table["x (um)"].min()) - 3)
    assert part.chosen == []
    assert len(curves_of(part)) == table["cell"].nunique()


def click_on(viewer, y: float, x: float) -> None:
    """Click with the mouse on a place of the sample."""
    QApplication.processEvents()
    canvas, place = canvas_of(viewer), place_of(viewer, y, x)
    QTest.mouseMove(canvas, place)
    QTest.mouseClick(canvas, LEFT, PLAIN, place)
    QApplication.processEvents()


@pytest.mark.thorough
def test_corrected_outlines_are_followed_again(viewer, unwrapped, click):
    part = unwrapped.compare.cells
    click("find_cells")
    before = unwrapped.session.cells
    outlines = shown(viewer, Labels)
    # Delete a cell of the first frame with napari's own tools.
    unwrapped.presenter.go_to(0, 0)
    y, x = np.argwhere(before.labels.values[0, 0] == 2)[0]
    outlines.fill((0, 0, int(y), int(x)), 0)
    assert part.go.text() == "Follow cells"
    assert part.source.value is outlines
    click("find_cells")
    after = unwrapped.session.cells
    assert not after.labels.values[0, 0][before.labels.values[0, 0] == 2].any()
    assert len(after.table) == len(before.table) - 1
    assert outlines in viewer.layers  # what was painted is kept
    assert not outlines.visible
    assert shown(viewer, Labels) is not outlines
    assert part.go.text() == "Find cells"
    # Outlines of one recording are not offered for the next.
    part.source.value = outlines
    unwrapped.session.set_phase(unwrapped.session.reconstruction["phase"] * 1)
    assert part.source.value == "find them"


@pytest.mark.thorough
def test_outlines_are_split_and_joined_with_the_brush(viewer, unwrapped, click):
    click("find_cells")
    before = unwrapped.session.cells.labels.values
    outlines = shown(viewer, Labels)
    t, cell = 0, int(before[0, 0].max())
    rows, columns = np.nonzero(before[t, 0] == cell)
    new = int(before.max()) + 1
    # Half of a cell gets a number of its own, a dab at a time.
    outlines.brush_size, middle = 1, int(columns.mean())
    unwrapped.presenter.go_to(t, 0)
    for y, x in zip(rows, columns, strict=True):
        if x > middle:
            outlines.paint((t, 0, int(y), int(x)), new)
    click("find_cells")
    after = unwrapped.session.cells
    parts = np.unique(after.labels.values[t, 0][before[t, 0] == cell])
    assert len(parts) == 2
    # And they are joined again, by filling one with the number of the other.
    painted = shown(viewer, Labels)
    now = after.labels.values[t, 0]
    keep, gone = (int(n) for n in parts)
    y, x = np.argwhere(now == gone)[0]
    painted.fill((t, 0, int(y), int(x)), keep)
    click("find_cells")
    joined = unwrapped.session.cells.labels.values[t, 0][before[t, 0] == cell]
    assert len(np.unique(joined)) == 1


@pytest.mark.thorough
def test_what_was_not_painted_in_is_replaced(viewer, unwrapped, click):
    click("find_cells")
    click("find_cells")
    for kind in (Labels, Points, Tracks):
        assert len([la for la in viewer.layers if isinstance(la, kind)]) == 1


@pytest.mark.thorough
def test_labels_of_another_layer_are_followed(viewer, unwrapped, click):
    part = unwrapped.compare.cells
    found = p4d.find_cells(unwrapped.session.results["directional-l1"]).values
    viewer.add_labels(found[:, 0] * 3, name="cellpose")
    part.source.value = viewer.layers["cellpose"]
    click("find_cells")
    labels = unwrapped.session.cells.labels.values
    np.testing.assert_array_equal(labels[:, 0] > 0, found[:, 0] > 0)
    np.testing.assert_array_equal(labels[:, 1], labels[:, 0])
    viewer.add_labels(np.ones((5, 5), int), name="too small")
    part.source.value = viewer.layers["too small"]
    click("find_cells")
    assert "the same pixels" in unwrapped.status.text()


@pytest.mark.thorough
def test_no_cells_are_said(unwrapped, click):
    unwrapped.compare.cells.smallest.value = 1e5
    click("find_cells")
    assert "No cells were found" in unwrapped.status.text()
    click("cell_by_methods")
    assert "choose one cell first" in unwrapped.status.text()


@pytest.mark.thorough
def test_other_results_have_no_cells_yet(viewer, unwrapped, click):
    click("find_cells")
    unwrapped.session.unwrap(["temporal"])
    assert unwrapped.session.cells is None
    assert unwrapped.compare.cells.table.rowCount() == 0


@pytest.mark.thorough
def test_each_region_notes_its_own_frame(viewer, unwrapped):
    layer = unwrapped.presenter.add_regions()
    for number, frame in enumerate([(0, 0), (7, 1), (3, 0)]):
        unwrapped.presenter.go_to(*frame)
        start = 5 * number
        layer.add([[1, start], [1, start + 4], [4, start + 4], [4, start]])
    assert list(frames_of_regions(layer).values()) == [(0, 0), (7, 1), (3, 0)]
    cells = p4d.find_cells(unwrapped.session.results["directional-l1"])
    with pytest.raises(ValueError, match="draw it again"):
        region_with_cell(np.ones(cells.shape[2:], bool), (50, 0), cells)


@pytest.mark.thorough
def test_a_drawn_region_goes_along_with_its_cell(viewer, unwrapped, click):
    part = unwrapped.compare.measuring
    result = unwrapped.session.results["directional-l1"]
    cells = p4d.find_cells(result)
    unwrapped.presenter.go_to(2, 1)
    layer = unwrapped.presenter.add_regions()
    y, x = (np.argwhere(cells.values[2, 1] == 2).mean(axis=0)).round()
    layer.add([[y - 3, x - 3], [y - 3, x + 3], [y + 3, x + 3], [y + 3, x - 3]])
    unwrapped.presenter.go_to(0, 0)
    layer.add([[1, 1], [1, 4], [4, 4], [4, 1]])  # in a corner, on no cell
    assert part.regions.value.name == layer.name
    click("measure")
    moved = regions_of_layer(layer, result)
    assert "no cell in region 2" in unwrapped.status.text()
    moved["region 1"] = region_with_cell(moved["region 1"], (2, 1), cells)
    wanted = p4d.measure(result, moved, p4d.Optics())
    pd.testing.assert_frame_equal(part.measured[list(wanted.columns)], wanted)
    part.follow.value = False
    click("measure")
    still = p4d.measure(result, regions_of_layer(layer, result), p4d.Optics())
    pd.testing.assert_frame_equal(part.measured[list(still.columns)], still)
    assert not np.allclose(still["dry mass (pg)"], wanted["dry mass (pg)"])


@pytest.mark.thorough
@pytest.mark.measured
def test_a_measured_multiplex_from_file_to_a_table_of_cells(
    viewer, dock, click, qtbot, tmp_path: Path
) -> None:
    """Two measured holograms of cells in one frame (HL60, and another), each with its carrier."""
    dock.recording.open_path(measured("multiplexed/mux2_cells.npz"))
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    assert dock.sections[0].badge.text() == "⚠ look"  # its microscope had to be assumed
    click("find_lobes")
    carriers = {tuple(abs(k) for k in lobe.carrier) for lobe in dock.session.lobes}
    assert len(carriers) == 2
    for wanted in ((0.2, 0.116), (0.116, 0.197)):
        assert min(np.hypot(*np.subtract(wanted, found)) for found in carriers) < 0.005
    dock.lobes.table.item(1, 3).setText("9")  # the angle of the second view, as typed
    click("reconstruct")
    click("run")
    click("find_cells")
    cells = dock.session.cells
    # Each view shows one whole cell in its middle.
    assert cells.table.groupby("angle (deg)")["cell"].nunique().tolist() == [1, 1]
    assert (cells.table["area (um^2)"] > 50).all()
    by_hand = dock.session.results["directional-l1"]
    for view, found in enumerate(cells.table["dry mass (pg)"]):
        inside = cells.labels.values[0, view] > 0
        area = float(by_hand["x"][1] - by_hand["x"][0]) ** 2
        mass = p4d.Optics().dry_mass_pg(by_hand.values[0, view][inside], area)
        # What lies just beyond the outline counts too, and adds some percent.
        assert found == pytest.approx(mass, rel=0.1)
    answered = answer_dialog(tmp_path / "cells.csv")
    click("save_cells")
    assert answered()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "cells.csv"), cells.table)


@pytest.mark.thorough
def test_views_are_taken_to_be_oblique_where_their_angles_were_typed_in(dock) -> None:
    exact = p4d.simulation.swimming_cells(
        (128, 128), 4, 2, divisions=0, leaving=0, entering=0, pixel_um=0.35, peak_rad=3
    )
    dock.session.set_recording(p4d.simulation.multiplexed_video(exact["phase"]))
    dock.session.find_lobes(2)
    dock.session.reconstruct()
    dock.session.unwrap(["spatial-2d"], boundary=(0, 0))
    part = dock.compare.cells
    assert not part.oblique.value
    first, second = dock.session.lobes
    dock.session.set_lobes([first, replace(second, angle_deg=21.0)])
    dock.session.reconstruct()
    dock.session.unwrap(["spatial-2d"], boundary=(0, 0))
    assert part.oblique.value
