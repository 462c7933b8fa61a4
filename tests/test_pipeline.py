"""From file to results: the recipe, the table, the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from helpers import command
from napari_phase4d.analysis import mean_squared_error, wrong_cycle_share
from napari_phase4d.holography import Lobe
from napari_phase4d.io import read_results, write_figure
from napari_phase4d.pipeline import PAPER_METHODS, lobes_of, write_outcome
from napari_phase4d.pipeline.running import opened_reference
from napari_phase4d.plotting import comparison_figure
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.unwrapping.causal import causal_methods

TURN = 2 * np.pi


def test_errors_are_counted_as_in_the_paper() -> None:
    truth = xr.DataArray(np.zeros((2, 2, 5, 5)), dims=("time", "angle", "y", "x"))
    off = truth.copy(deep=True)
    off[0, 0, 0, :2] = TURN
    off[1, 1, 0, 0] = 0.3
    assert mean_squared_error(off, truth) == pytest.approx((2 * TURN**2 + 0.09) / 100)
    assert wrong_cycle_share(off, truth) == pytest.approx(0.02)
    assert wrong_cycle_share(off, truth, where=off > 0.1) == pytest.approx(2 / 3)


@pytest.mark.thorough
def test_table_of_methods_against_truth(reconstruction, truth) -> None:
    """The whole chain on the hologram video, against exact truth."""
    comparison = p4d.compare(reconstruction["phase"], truth=truth, mask="auto")
    table = comparison.table
    assert list(table.index) == methods_for(None)
    assert (table["seconds"] > 0).all()
    for method, result in comparison.results.items():
        assert table.loc[method, "mse_rad2"] == pytest.approx(mean_squared_error(result, truth))
    # What Fig. 4 of the paper shows: 2-D fails on the thick cell, T/A and A/T are better.
    mse = table["mse_rad2"]
    assert mse["spatial-2d"] > 0.2
    assert mse["temporal-angular"] < 0.5 * mse["spatial-2d"]
    assert mse["angular-temporal"] < 0.5 * mse["spatial-2d"]
    assert mse["temporal"] < mse["angular"] < mse["spatial-2d"]


@pytest.mark.slow
def test_methods_may_be_called_by_the_names_on_screen(reconstruction) -> None:
    phase = reconstruction["phase"]
    by_id = p4d.unwrap(phase, "spatial-2d")
    xr.testing.assert_identical(p4d.unwrap(phase, "2-D"), by_id)
    options = {"T/A": {"registration": False}}
    assert list(p4d.compare(phase, ["2-D", "T/A"], options=options).results) == [
        "spatial-2d", "temporal-angular",
    ]  # fmt: skip
    assert list(p4d.compare(phase, ["2-D", "spatial-2d"]).table.index) == ["spatial-2d"]
    with pytest.raises(ValueError, match="options are given twice for temporal-angular"):
        p4d.compare(phase, ["T/A"], options={**options, "temporal-angular": {}})
    assert list(causal_methods(["T/A"], {})) == list(causal_methods(["temporal-angular"], {}))
    recipe = p4d.Recipe(methods=("2-D", "T/A"), options=options)
    assert recipe.methods == ("spatial-2d", "temporal-angular")
    assert recipe.options == {"temporal-angular": {"registration": False}}


@pytest.mark.slow
def test_compare_checks_before_it_works(reconstruction) -> None:
    phase = reconstruction["phase"]
    with pytest.raises(ValueError, match="method must be one of"):
        p4d.compare(phase, ["spatial-2d", "magic"])
    with pytest.raises(TypeError, match="has no option"):
        p4d.compare(phase, ["spatial-2d"], options={"spatial-2d": {"fast": True}})
    with pytest.raises(ValueError, match="truth is .* but the phase is"):
        p4d.compare(phase, truth=np.zeros((2, 2)))


@pytest.mark.slow
def test_compare_gives_what_unwrap_gives(small_video) -> None:
    phase = p4d.reconstruct(small_video, p4d.find_lobes(small_video, 2))["phase"]
    for method, result in p4d.compare(phase, boundary=(2, 1)).results.items():
        xr.testing.assert_identical(result, p4d.unwrap(phase, method, (2, 1)))


@pytest.mark.slow
def test_figure_has_a_picture_for_every_method_and_frame(tmp_path: Path, reconstruction) -> None:
    phase = reconstruction["phase"]
    path = tmp_path / "figure.png"
    figure = comparison_figure({"a": phase, "b": phase}, [(0, 0), (3, 1), (5, 0)])
    write_figure(path, figure)
    assert len([a for a in figure.axes if a.images]) == 6
    assert path.stat().st_size > 10_000


def test_recipe_comes_back_equal(tmp_path: Path) -> None:
    recipe = p4d.Recipe(
        recording="a.tif", optics=p4d.Optics(magnification=20), lobes=(p4d.Lobe((0.2, 0.1), 0.1),),
        angles_deg=(3.0,), boundary=((1, 0), (5, 0)), reference="median", mask=None,
        methods=("temporal",), options={"temporal": {"registration": False}},
    )  # fmt: skip
    assert p4d.Recipe.from_file(recipe.to_file(tmp_path / "r.json")) == recipe


BAD_RECIPES = {
    "not json": ("{", "line 1 is not JSON"),
    "unknown setting": ('{"colour": 3}', "colour: Extra inputs are not permitted"),
    "window": ('{"window": "square"}', "window must be one of"),
    "background": ('{"background": "plane"}', "background must be one of"),
    "method": ('{"methods": ["magic"]}', "method must be one of"),
    "views": ('{"n_views": 9}', "n_views: Input should be less than or equal to 6"),
    "lobe": ('{"lobes": [{"carrier": [0.9, 0], "radius": 0.1}]}', "lies outside the spectrum"),
    "list": ("[1]", "the file: Input should be a valid dictionary"),
}


def test_a_recipe_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    """Some editors write one."""
    recipe = p4d.Recipe(methods=("temporal",), frame_rate_hz=4)
    path = recipe.to_file(tmp_path / "recipe.json")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert p4d.Recipe.from_file(path) == recipe


@pytest.mark.parametrize("case", BAD_RECIPES)
def test_bad_recipe_gives_one_sentence(tmp_path: Path, case: str) -> None:
    text, sentence = BAD_RECIPES[case]
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence) as caught:
        p4d.Recipe.from_file(path)
    assert "\n" not in str(caught.value)
    assert "bad.json" in str(caught.value)


@pytest.mark.slow
def test_run_follows_the_recipe(small_video, tmp_path: Path) -> None:
    recipe = p4d.Recipe(methods=("spatial-2d", "temporal"), boundary=((1, 0),), mask=None)
    outcome = p4d.run(recipe, small_video)
    lobes = p4d.find_lobes(small_video, 2)
    data = p4d.reconstruct(small_video, lobes)
    xr.testing.assert_identical(outcome.reconstruction, data)
    expected = p4d.unwrap(data["phase"], "temporal", (1, 0), amplitude=data["amplitude"])
    xr.testing.assert_identical(outcome.comparison.results["temporal"], expected)
    written = write_outcome(outcome, tmp_path)
    assert {p.name for p in written} == {
        "wrapped.ome.tif", "amplitude.ome.tif", "spatial-2d.ome.tif", "temporal.ome.tif",
        "table.csv", "recipe.json",
    }  # fmt: skip
    again = read_results(tmp_path / "temporal.ome.tif")
    np.testing.assert_array_equal(again.values, expected.values)
    np.testing.assert_array_equal(again["x"], expected["x"])
    # The written recipe holds the lobes that were found, so it gives the same arrays.
    repeated = p4d.run(p4d.Recipe.from_file(tmp_path / "recipe.json"), small_video)
    xr.testing.assert_identical(repeated.comparison.results["temporal"], expected)


def test_run_can_be_cancelled_half_way(small_video) -> None:
    count: list[int] = []
    with pytest.raises(p4d.Cancelled):
        p4d.run(
            p4d.Recipe(), small_video, progress=lambda *_: count.append(1),
            cancelled=lambda: len(count) >= 8,
        )  # fmt: skip


def test_run_needs_a_recording() -> None:
    with pytest.raises(ValueError, match="the recipe names no recording"):
        p4d.run(p4d.Recipe())


@pytest.fixture(scope="module")
def video_file(tmp_path_factory, small_video) -> Path:
    path = tmp_path_factory.mktemp("cli") / "video.tif"
    tifffile.imwrite(
        path, small_video.holograms.values, imagej=True, resolution=(4, 4),
        metadata={"axes": "TYX", "unit": "um", "finterval": 0.25},
    )  # fmt: skip
    return path


@pytest.mark.slow
def test_info_says_what_a_file_holds(video_file: Path) -> None:
    found = command("info", video_file, cwd=video_file.parent)
    assert found.returncode == 0
    assert "6 frames of 128 x 128 pixels, uint8" in found.stdout
    assert "pixel in the sample 0.25 um" in found.stdout
    assert "4 frames a second" in found.stdout
    assert "-0.2" in found.stdout  # ky of the second view
    assert "What a run needs, about" in found.stdout


@pytest.mark.slow
def test_run_goes_from_file_to_results_and_again_from_its_recipe(video_file: Path) -> None:
    folder = video_file.parent
    first = command(
        "run", video_file, "--out", "one", "--angle", "-7", "--angle", "21", "--boundary", "1,0",
        "--method", "temporal-angular", cwd=folder,
    )  # fmt: skip
    assert first.returncode == 0, first.stderr
    assert "T/A" in first.stdout
    result = read_results(folder / "one" / "temporal-angular.ome.tif")
    np.testing.assert_allclose(result["angle"], [-7, 21])
    assert result.attrs["boundary"] == [[1, 0]]
    assert float(result["time"][1]) == pytest.approx(0.25)
    assert len(pd.read_csv(folder / "one" / "table.csv")) == 1
    second = command("run", folder / "one" / "recipe.json", "--out", "two", cwd=folder)
    assert second.returncode == 0, second.stderr
    again = read_results(folder / "two" / "temporal-angular.ome.tif")
    xr.testing.assert_identical(result, again)


@pytest.mark.slow
def test_batch_gives_every_file_a_folder(video_file: Path) -> None:
    folder = video_file.parent
    copy = folder / "second.tif"
    copy.write_bytes(video_file.read_bytes())
    done = command("run", video_file, copy, "--method", "spatial-2d", "--out", "batch", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "batch" / "video" / "table.csv").exists()
    assert (folder / "batch" / "second" / "table.csv").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:video.tif")  # what is in doubt about its lobes
def test_one_view_of_several_is_pointed_out(video_file: Path) -> None:
    line = ("run", video_file, "--angle", "-7", "--method", "T/A", "--out", "one_view")
    done = command(*line, cwd=video_file.parent)
    assert done.returncode == 0, done.stderr
    assert "video.tif shows 2 views, but 1 was asked for" in " ".join(done.stdout.split())
    assert (video_file.parent / "one_view" / "temporal-angular.ome.tif").exists()
    both = command(*line, "--angle", "21", cwd=video_file.parent)
    assert "was asked for" not in both.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("info", "missing.tif"), "there is no file or folder"),
        (("run", "video.tif", "--boundary", "x"), "takes two frame numbers TIME,ANGLE"),
        (("run", "video.tif", "--method", "magic"), "method must be one of"),
        (("run", "video.tif", "--views", "9"), "n_views"),
        (("run", "video.tif", "--boundary", "99,0"), "does not exist"),
        (("run", "video.tif", "--magnification", "-1"), "magnification must be a number above 0"),
    ],
)
@pytest.mark.slow
def test_wrong_commands_end_with_one_sentence(
    video_file: Path, arguments: tuple, sentence: str
) -> None:
    found = command(*arguments, "--out", "none", cwd=video_file.parent) if (
        arguments[0] == "run"
    ) else command(*arguments, cwd=video_file.parent)  # fmt: skip
    assert found.returncode == 1
    assert sentence in " ".join(found.stderr.split())
    assert not (video_file.parent / "none").exists()


def test_paper_methods_are_the_papers_five() -> None:
    assert tuple(p4d.METHODS)[:5] == PAPER_METHODS
    assert json.loads(p4d.Recipe().model_dump_json())["methods"] == [
        *PAPER_METHODS,
        "directional-l1",
    ]


@pytest.mark.slow
def test_times_come_back_from_the_frame_rate() -> None:
    frames = np.zeros((40, 16, 16), np.uint8)
    for rate in np.random.default_rng(0).uniform(0.1, 300, 200):
        rec = p4d.open_recording(frames, frame_rate_hz=float(rate))
        again = p4d.open_recording(frames, frame_rate_hz=rec.frame_rate_hz)
        np.testing.assert_array_equal(again.times_s, rec.times_s)


def test_what_a_file_of_phase_says_itself_counts_and_is_said(tmp_path: Path) -> None:
    wrapped = p4d.simulation.swimming_euglena((24, 32), 3, peak_rad=9)["wrapped"]
    path = str(p4d.write_phase(tmp_path / "wrapped.ome.tif", wrapped))
    recipe = p4d.Recipe(recording=path, methods=("temporal",), boundary=((0, 0),))
    other = recipe.changed(frame_rate_hz=100, angles_deg=(0, 60, 80), n_views=5)
    with pytest.warns(UserWarning, match=r"frame_rate_hz \(.*angles_deg \(.*n_views \(") as said:
        found = p4d.run(other)
    assert len(said) == 1
    np.testing.assert_array_equal(found.reconstruction["angle"], wrapped["angle"])
    step = float(wrapped["time"][1] - wrapped["time"][0])
    angles = tuple(wrapped["angle"].values.tolist())
    p4d.run(recipe.changed(frame_rate_hz=1 / step, angles_deg=angles, n_views=2))
    still = p4d.write_phase(tmp_path / "still.ome.tif", wrapped.assign_coords(time=[0.0, 0, 0]))
    with pytest.raises(ValueError, match="time coordinates"):
        p4d.run(recipe.changed(recording=str(still), frame_rate_hz=10))


def test_what_is_assumed_of_a_reference_file_is_warned_of(small_video, tmp_path: Path) -> None:
    frame = small_video.holograms.values[0]
    np.savez(tmp_path / "both.npz", dark=frame, light=frame)
    recipe = p4d.Recipe(reference=str(tmp_path / "both.npz"))
    said = r"the reference both\.npz: both\.npz holds dark, light; dark is read"
    with pytest.warns(UserWarning, match=said) as caught:
        found = opened_reference(recipe, small_video)
    assert [frame.shape] == [found.frame_shape]
    assert len(caught) == 1


def test_angles_of_a_recipe_go_to_its_lobes() -> None:
    lobes = (Lobe((0.2, 0.2), 0.08, -7), Lobe((-0.2, 0.2), 0.08, 21))
    recipe = p4d.Recipe(lobes=lobes, angles_deg=(-7, 21), n_views=2)
    assert lobes_of(recipe) == list(lobes)
    assert lobes_of(p4d.Recipe(n_views=2)) == []
    with pytest.warns(UserWarning, match="angles_deg of the recipe, -30, 40, count"):
        found = lobes_of(recipe.changed(angles_deg=(-30, 40)))
    assert found == [replace(lobes[0], angle_deg=-30), replace(lobes[1], angle_deg=40)]
    bare = tuple(replace(lobe, angle_deg=0) for lobe in lobes)
    assert lobes_of(recipe.changed(lobes=bare)) == list(lobes)
    with pytest.raises(ValueError, match="angles_deg has 3 angles, but the recipe has 2 lobes"):
        lobes_of(recipe.changed(angles_deg=(1, 2, 3)))
    turned = recipe.changed(angles_deg=(40, -30), boundary=((0, 1),))
    with (
        pytest.warns(UserWarning, match="angles_deg"),
        pytest.raises(ValueError, match="set boundary to"),
    ):
        lobes_of(turned)


def test_what_lobes_do_not_agree_with_is_warned_of() -> None:
    recipe = p4d.Recipe(lobes=(Lobe((0.2, 0.2), 0.08),))
    with pytest.warns(UserWarning, match="n_views is 2, but the recipe has 1 lobe, which count"):
        lobes_of(recipe.changed(n_views=2))
    with pytest.warns(UserWarning, match="wavelengths_um of the recipe do not count"):
        lobes_of(recipe.changed(wavelengths_um=(0.5,)))


@pytest.mark.slow
def test_a_run_takes_angles_that_were_changed_in_its_recipe(small_video) -> None:
    recipe = p4d.Recipe(angles_deg=(-7, 21), methods=("spatial-2d",))
    used = p4d.run(recipe, small_video).recipe
    with pytest.warns(UserWarning, match="angles_deg of the recipe, -30, 40, count"):
        again = p4d.run(used.changed(angles_deg=(-30, 40)), small_video)
    assert again.reconstruction.angle.values.tolist() == [-30, 40]
    assert [lobe.angle_deg for lobe in again.recipe.lobes] == [-30, 40]
