"""Wrapped phase in the window: samples with truth, variants, the table, maps of the steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driving import let_settle

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.layers import METADATA_KEY
from napari_phase4d.analysis import itoh_margin, order_shares
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.sample import yeast_sample
from napari_phase4d.stacks import AXES

pytestmark = pytest.mark.gui
SHOWN = ["method", "s", "MSE rad²", "wrong %", "MB"]
PAPERS_EIGHT = ["2-D", "Angular", "Temporal", "T/A", "A/T", "LBE", "RG", "DE"]


def cells(dock: Any) -> list[list[str]]:
    table = dock.compare.figures.table
    columns = range(table.columnCount())
    return [[table.item(r, c).text() for c in columns] for r in range(table.rowCount())]


def headings(dock: Any) -> list[str]:
    table = dock.compare.figures.table
    return [table.horizontalHeaderItem(c).text() for c in range(table.columnCount())]


@pytest.mark.thorough
def test_yeast_by_clicks_with_the_papers_eight_methods(viewer, dock, click) -> None:
    click("try_yeast")
    assert dock.sections[3].is_open
    for method in ("laplacian", "region-growing", "dilate-erode", "directional-l1"):
        click(f"method_{method}")
    click("run")
    shown = [layer.name for layer in viewer.layers if layer.visible]
    assert shown == ["exact", *PAPERS_EIGHT]
    for layer in viewer.layers:
        assert layer.axis_labels == AXES
        assert [str(u) for u in layer.units] == ["second", "degree", "micrometer", "micrometer"]
        assert layer.data.shape == (19, 6, 48, 48)
        np.testing.assert_allclose(layer.scale, [60, 5, 0.2, 0.2])
    data = yeast_sample()
    methods = list(dock.session.outcome.comparison.results)
    expected = p4d.compare(data["wrapped"], methods, truth=data["phase"], mask="auto").table
    assert [h for h in headings(dock) if h != "doubt %"] == SHOWN
    assert not dock.compare.figures.table.horizontalScrollBar().isVisible()
    for row, (_, wanted) in zip(cells(dock), expected.iterrows(), strict=True):
        found = dict(zip(headings(dock), row, strict=True))
        assert found["method"] == wanted["method"]
        assert found["MSE rad²"] == f"{wanted['mse_rad2']:.3g}"
        assert found["wrong %"] == f"{wanted['wrong_cycles_percent']:.3g}"


@pytest.mark.thorough
def test_maps_of_the_steps(viewer, dock, click, tick_only) -> None:
    tick_only("spatial-2d", "temporal-angular")
    click("try_yeast")
    click("run")
    click("show_margin")
    truth = yeast_sample()["phase"]
    margin = itoh_margin(truth)
    shown = [layer for layer in viewer.layers if layer.visible]
    assert [la.name for la in shown] == [f"step along {d}" for d in ("time", "angle", "y", "x")]
    for layer, name in zip(shown, margin.data_vars, strict=True):
        np.testing.assert_array_equal(layer.data, margin[name].values)
        assert layer.contrast_limits == [0, 2]
    ways = order_shares(truth)
    fewer = {"temporal-angular": "T/A", "angular-temporal": "A/T"}[min(ways, key=ways.get)]
    assert dock.status.text().endswith(f"{fewer} meets fewer of them, by the exact phase.")
    click("side_by_side")
    assert not any(layer.visible for layer in shown)


def test_maps_need_something_to_measure(dock, click) -> None:
    click("show_margin")
    assert "there are no results yet" in dock.status.text()


@pytest.mark.thorough
def test_a_variant_is_named_wherever_its_result_is(viewer, dock, click, tick_only) -> None:
    tick_only("spatial-2d")
    click("try_yeast")
    row = dock.unwrap.methods["region-growing"]
    assert not row.panel.isVisible()
    click("options_region-growing")
    assert row.panel.isVisible()
    row.fields["variant"].value = "phasetools"
    assert row.tick.text() == "RG (PhaseTools)"
    click("method_region-growing")
    click("run")
    assert viewer.layers[-1].name == "RG (PhaseTools)"
    assert cells(dock)[-1][0] == "RG (PhaseTools)"
    data = yeast_sample()
    expected = p4d.unwrap(data["wrapped"], "region-growing", mask="auto", variant="phasetools")
    np.testing.assert_array_equal(viewer.layers[-1].data, expected.values)
    assert dock.session.outcome.recipe.options == {"region-growing": {"variant": "phasetools"}}


@pytest.mark.thorough
def test_sample_layers_are_taken_with_their_truth(viewer, dock, click, tick_only) -> None:
    tick_only("spatial-2d")
    viewer.open_sample("napari-phase4d", "yeast")
    wrapped = viewer.layers["wrapped phase, budding yeast"]
    n_layers = len(viewer.layers)
    dock.recording.layer.value = wrapped
    assert len(viewer.layers) == n_layers  # it is shown already
    assert wrapped.visible
    truth = yeast_sample()["phase"]
    np.testing.assert_array_equal(dock.session.truth.values, truth.values)
    np.testing.assert_allclose(dock.session.truth["time"], truth["time"])
    click("run")
    assert {"MSE rad²", "wrong %"} <= set(headings(dock))


@pytest.mark.thorough
def test_the_sample_video_from_the_menu_is_known_again(viewer, dock, click) -> None:
    viewer.open_sample("napari-phase4d", "euglena")
    dock.recording.layer.value = viewer.layers[0]
    click("find_lobes")
    assert [lobe.angle_deg for lobe in dock.session.lobes] == [-7, 21]
    click("reconstruct")
    assert dock.session.truth is not None
    # Seen from other angles, its phase is not known.
    dock.session.set_lobes([lobe for lobe in dock.session.lobes if lobe.angle_deg < 0])
    click("reconstruct")
    assert dock.session.truth is None


@pytest.mark.thorough
def test_saved_wrapped_phase_opens_in_dock_and_viewer(
    viewer, dock, click, qtbot, tmp_path: Path, tick_only
) -> None:
    tick_only("temporal-angular")
    data = yeast_sample()
    path = write_phase(tmp_path / "wrapped.ome.tif", data["wrapped"])
    dock.recording.open_path(path)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    click("run")
    layer = viewer.layers["T/A"]
    np.testing.assert_allclose(layer.scale, [60, 5, 0.2, 0.2])
    expected = p4d.unwrap(read_results(path), "temporal-angular", mask="auto")
    np.testing.assert_array_equal(layer.data, expected.values)
    plain = tmp_path / "plain.npy"
    np.save(plain, data["wrapped"].values)
    viewer.open(plain, plugin="napari-phase4d")
    assert viewer.layers[-1].metadata[METADATA_KEY]["kind"] == "wrapped"


@pytest.mark.thorough
@pytest.mark.parametrize("button", ["find_lobes", "add_lobe", "reconstruct"])
def test_steps_for_holograms_say_that_this_is_phase(dock, click, button: str, tick_only) -> None:
    tick_only("spatial-2d")
    click("try_yeast")
    click(button)
    assert "this is wrapped phase, not a hologram video" in dock.status.text()
    assert dock.recording.numbers["wavelength_nm"].native.isHidden()
    click("drift")  # settings of steps that are done without
    click("run")
    assert dock.session.outcome is not None


@pytest.mark.thorough
def test_a_video_after_phase_starts_afresh(viewer, dock, click, small_video, tick_only) -> None:
    tick_only("spatial-2d", "temporal")
    click("try_yeast")
    click("run")
    dock.session.set_recording(small_video)
    assert dock.session.truth is None
    assert not dock.recording.numbers["wavelength_nm"].native.isHidden()
    assert dock.compare.figures.table.rowCount() == 0
    assert [layer.name for layer in viewer.layers if layer.visible] == [small_video.name]


@pytest.mark.thorough
def test_back_to_the_video_by_its_layer(viewer, dock, click, qtbot) -> None:
    click("try_sample")
    video = viewer.layers[0]
    click("try_yeast")
    assert dock.recording.layer.value is None
    dock.recording.layer.value = video
    assert dock.session.recording is not None
    let_settle(qtbot, dock)
    assert video.visible
    assert dock.presenter.holograms == video
    assert dock.recording.layer.value == video


@pytest.mark.thorough
def test_truth_of_the_sample_does_not_depend_on_what_is_typed_in(viewer, dock, click) -> None:
    viewer.open_sample("napari-phase4d", "euglena")
    dock.recording.layer.value = viewer.layers[0]
    dock.recording.numbers["magnification"].value = 30
    click("try_yeast")
    dock.recording.layer.value = viewer.layers[0]
    click("find_lobes")
    click("reconstruct")
    assert 15 < float(dock.session.truth.max()) < 20


@pytest.mark.thorough
def test_what_was_measured_of_an_earlier_phase_is_forgotten(
    viewer, dock, click, tick_only
) -> None:
    tick_only("spatial-2d", "temporal")
    click("try_yeast")
    click("run")
    click("run")
    assert [layer.name for layer in viewer.layers].count("exact") == 1
    dock.session.set_phase(yeast_sample()["wrapped"])
    assert dock.session.outcome is None
    assert dock.compare.figures.table.rowCount() == 0
    click("show_margin")
    assert "there are no results yet" in dock.status.text()


@pytest.mark.thorough
def test_recipe_of_a_phase_file_runs_again(dock, click, qtbot, tmp_path: Path, tick_only) -> None:
    tick_only("temporal-angular")
    path = write_phase(tmp_path / "wrapped.ome.tif", yeast_sample()["wrapped"])
    dock.recording.open_path(path)
    qtbot.waitUntil(lambda: not dock.jobs.running, timeout=60_000)
    click("run")
    again = p4d.run(dock.session.outcome.recipe)
    expected = dock.session.outcome.comparison.results["temporal-angular"]
    np.testing.assert_array_equal(again.comparison.results["temporal-angular"], expected)


@pytest.mark.thorough
def test_trust_and_suggestion_by_clicks(viewer, dock, click) -> None:
    click("try_yeast")
    click("automatic")
    scores = p4d.score_boundaries(dock.session.reconstruction["phase"])
    assert dock.session.start_frames == (tuple(scores.attrs["best"]),)
    assert "agree on" in dock.status.text()
    click("show_confidence")
    assert "there are no results yet" in dock.status.text()
    for method in ("angular", "temporal", "angular-temporal"):
        click(f"method_{method}")
    click("run")
    click("show_confidence")
    shown = [layer for layer in viewer.layers if layer.visible]
    assert [layer.name for layer in shown] == [
        f"confidence in {name}" for name in ("2-D", "T/A", "WL1")
    ]
    for layer, method in zip(shown, dock.session.confidence, strict=True):
        expected = dock.session.outcome.comparison.confidence(method)
        np.testing.assert_array_equal(layer.data, expected.values)
        assert layer.contrast_limits == [0, 1]
        assert layer.axis_labels == AXES
    words = dock.status.text()
    assert "dark is more likely a cycle off" in words
    assert "may be off in 2-D" in words
    doubtful = cells(dock)[0][headings(dock).index("doubt %")]
    trust = dock.session.confidence["spatial-2d"]
    inside = dock.session.outcome.comparison.object_mask().values.astype(bool)
    assert doubtful == f"{100 * (trust.values < 0.5)[inside].mean():.3g}"
    assert dock.compare.verdict.isVisible()
    assert dock.compare.verdict.text() == dock.session.outcome.comparison.verdict
    assert dock.compare.verdict.text().startswith("Use WL1: ")
    assert "most of an object may be off" in dock.compare.figures.table.item(0, 0).toolTip()
    click("run")
    assert dock.session.confidence == {}
    assert dock.session.warnings == {}
    assert dock.session.verdict == ""
