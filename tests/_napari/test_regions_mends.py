"""Regions, what is measured in them, and the two choices of views: each stays with its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from driving import let_settle

from napari_phase4d._napari.viewing.pointing import FRAME_COLUMNS, frames_of_regions
from napari_phase4d.holography import FoundLobes

pytestmark = pytest.mark.gui


def square(side: float) -> np.ndarray:
    return np.array([[2, 2], [2, side], [side, side], [side, 2]], float)


@pytest.fixture
def measured(compared: Any, click: Callable[[str], None]) -> tuple[Any, Any]:
    """Return the dock and a layer with a region that was drawn and measured."""
    regions = compared.presenter.add_regions()
    compared.presenter.go_to(0, 0)
    regions.add_polygons(square(8))
    compared.compare.measuring.follow.value = False
    click("measure")
    assert compared.compare.measuring.table.rowCount()
    return compared, regions


def corners_saved(dock: Any, folder: Path, qtbot: Any) -> pd.DataFrame:
    dock.compare.share.save_to(folder)
    let_settle(qtbot, dock)
    return pd.read_csv(folder / "regions.csv")


def test_what_was_measured_goes_when_its_region_changes(
    measured: tuple[Any, Any], tmp_path: Path, qtbot: Any
) -> None:
    dock, regions = measured
    corners_saved(dock, tmp_path / "same", qtbot)
    assert (tmp_path / "same" / "measured.csv").exists()
    regions.data = [square(20)]
    assert dock.session.measured is None
    assert not dock.compare.measuring.table.rowCount()
    corners = corners_saved(dock, tmp_path / "other", qtbot)
    assert corners["y (um)"].max() > 2 * corners["y (um)"].min()
    assert not (tmp_path / "other" / "measured.csv").exists()


@pytest.mark.parametrize("changed", ["result", "follow", "removed"])
def test_what_was_measured_goes_when_it_would_be_other(
    measured: tuple[Any, Any], viewer: Any, changed: str
) -> None:
    dock, regions = measured
    part = dock.compare.measuring
    if changed == "result":
        part.result.value = next(c for c in part.result.choices if c != part.result.value)
    elif changed == "follow":
        part.follow.value = True
    else:
        viewer.layers.remove(regions)
    assert dock.session.measured is None
    assert not part.table.rowCount()


def test_a_measurement_that_comes_late_is_not_that_of_the_new_region(
    measured: tuple[Any, Any], qtbot: Any
) -> None:
    dock, regions = measured
    dock.compare.measuring.measure()
    regions.data = [square(20)]
    let_settle(qtbot, dock)
    assert dock.session.measured is None
    assert "changed meanwhile" in dock.status.text()


def test_a_region_goes_with_the_frame_at_which_it_was_reshaped(measured: tuple[Any, Any]) -> None:
    dock, regions = measured
    regions.add_polygons(square(5))
    dock.presenter.go_to(4, 1)
    regions.data = [square(20), square(5)]
    assert frames_of_regions(regions) == {"region 1": (4, 1), "region 2": (0, 0)}


def test_a_line_of_the_user_gets_no_note(compared: Any, viewer: Any) -> None:
    mine = viewer.add_shapes(name="mine")
    mine.add_lines(np.array([[1, 1], [5, 5]], float))
    assert list(mine.features.columns) == []
    mine.add_polygons(square(5))
    assert mine.features[list(FRAME_COLUMNS)].isna().to_numpy().tolist() == [
        [True] * 2,
        [False] * 2,
    ]


def test_the_region_that_was_drawn_last_is_traced_whatever_lies_above(
    compared: Any, viewer: Any
) -> None:
    trace = compared.compare.trace
    lower = compared.presenter.add_regions()
    upper = compared.presenter.add_regions()
    upper.add_polygons(square(5))
    small = trace._mask.sum()
    lower.add_polygons(square(12))
    assert trace._mask.sum() > small
    upper.data = []
    upper.add_lines(np.array([[1, 1], [5, 5]], float))  # which is no region
    assert trace._mask.sum() > small


def test_curves_have_the_times_of_the_frame_rate_that_was_typed_in(
    compared: Any, click: Callable[[str], None], qtbot: Any
) -> None:
    compared.show_step(4)
    compared.compare.tabs.setCurrentWidget(compared.compare.trace)
    compared.presenter.add_regions().add_polygons(square(12))
    plot = compared.compare.trace.plot
    qtbot.waitUntil(lambda: plot.has_curves, timeout=60_000)

    def axis() -> np.ndarray:
        return np.array(plot.figure.axes[0].get_lines()[0].get_xdata())

    before = axis()
    rate = compared.recording.numbers["frame_rate_hz"]
    rate.value = 2 * rate.value
    qtbot.waitUntil(lambda: not np.allclose(axis(), before), timeout=5000)
    np.testing.assert_allclose(axis(), before / 2)


@pytest.fixture
def in_doubt(ready: Any) -> Any:
    """Return the dock with views of which one may be another."""
    found = list(ready.session.found)
    other = [replace(found[0], carrier=(0.1, 0.3)), found[1]]
    ready.session.found = FoundLobes(found, 0.6, ("Unsure.",), other)
    ready.session.set_lobes(found)
    return ready


def angles(dock: Any) -> list[float]:
    return [lobe.angle_deg for lobe in dock.session.lobes]


def test_angles_that_were_typed_in_stay_with_their_views(in_doubt: Any) -> None:
    step = in_doubt.lobes
    for row, angle in enumerate(("-7", "21")):
        step.table.item(row, 3).setText(angle)
    assert angles(in_doubt) == [-7, 21]
    step.take_other()
    assert angles(in_doubt)[1] == 21
    step.table.item(1, 3).setText("23")  # of the view that both choices have
    step.take_other()
    assert angles(in_doubt) == [-7, 23]


def test_with_the_circles_what_is_said_of_them_comes_back(in_doubt: Any) -> None:
    step, session = in_doubt.lobes, in_doubt.session
    before = list(step.doubts())
    step.take_other()
    assert "This is the other choice" in step.doubts()[0]
    session.undo_lobes()
    assert list(step.doubts()) == before
    assert not step.other.isHidden()
    step.take_other()
    assert "This is the other choice" in step.doubts()[0]
    step.take_other()
    assert list(step.doubts()) == before


def choose_labels(dock: Any, viewer: Any, click: Callable[[str], None]) -> Any:
    """Return a layer of labels that was painted in and then measured."""
    shape = dock.session.reconstruction["phase"].shape
    layer = viewer.add_labels(np.ones(shape[2:], int), name="mine")
    layer.paint((3, 3), 2)
    dock.compare.measuring.regions.value = layer
    click("measure")
    assert dock.session.measured is not None
    return layer


@pytest.mark.parametrize("how", ["paint", "undo", "data", "name"])
def test_what_was_measured_of_labels_goes_when_they_change(
    compared: Any, viewer: Any, click: Callable[[str], None], how: str
) -> None:
    layer = choose_labels(compared, viewer, click)
    compared.presenter.go_to(1, 1)
    layer.refresh()
    assert compared.session.measured is not None
    if how == "paint":
        layer.paint((9, 9), 3)
    elif how == "undo":
        layer.undo()
    elif how == "data":
        layer.data = layer.data * 2
    else:
        layer.name = "other"
    assert (compared.session.measured is None) == (how != "name")
    if how == "undo":  # measured again, it goes with what is done again
        click("measure")
        layer.redo()
        assert compared.session.measured is None


def test_the_table_of_the_object_stays_when_a_region_is_drawn(
    compared: Any, click: Callable[[str], None]
) -> None:
    part = compared.compare.measuring
    click("measure")
    compared.presenter.add_regions().add_polygons(square(8))
    assert compared.session.measured is not None
    assert part.table.rowCount()
    assert part.regions.value == "the object"


def test_a_region_that_is_drawn_while_the_object_is_measured_does_not_stop_it(
    compared: Any, qtbot: Any
) -> None:
    part = compared.compare.measuring
    part.measure()
    compared.presenter.add_regions().add_polygons(square(8))
    let_settle(qtbot, compared)
    assert compared.session.measured is not None
    assert part.regions.value == "the object"


def test_regions_that_are_renamed_stay_chosen_with_their_table(
    measured: tuple[Any, Any], viewer: Any
) -> None:
    dock, regions = measured
    part = dock.compare.measuring
    said: list[str] = []
    part.plot.message = said.append
    regions.name = "renamed"
    dock.reset_choices()
    assert part.regions.value == regions
    assert part.regions.current_choice == "renamed"
    assert dock.session.measured is not None
    assert not said
    viewer.layers.remove(regions)
    assert part.regions.value == "the object"
    assert "was removed" in said[-1]
