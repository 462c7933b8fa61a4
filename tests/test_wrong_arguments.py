"""Arguments, attributes and files that look right and are not: refused, or warned of, in words."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import xarray as xr
from napari.components import ViewerModel
from PIL import Image

import napari_phase4d as p4d
from napari_phase4d.analysis import difference
from napari_phase4d.pipeline import run_batch, write_outcome
from napari_phase4d.simulation import multiplexed_video, swimming_cells, swimming_euglena

OPTICS = p4d.Optics()
CELLS = swimming_cells((96, 96), 3, 2, divisions=0, leaving=0, entering=0)
P = CELLS["phase"]
L = CELLS["cells"].astype(np.int32)
V = L.values
EUGLENA = swimming_euglena((40, 56), 3, peak_rad=9)
W, E = EUGLENA["wrapped"], EUGLENA["phase"]


@pytest.fixture(scope="module")
def rec() -> p4d.Recording:
    exact = swimming_euglena((128, 128), 3, pixel_um=0.35, peak_rad=6)
    return multiplexed_video(exact["phase"])


@pytest.fixture(scope="module")
def npy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("phase") / "ok.npy"
    np.save(path, W.values)
    return path


REFUSED = {
    "oblique in words": (lambda: p4d.measure(P, L, OPTICS, oblique="no"), "True or False"),
    "border in words": (lambda: p4d.find_cells(P, at_border="no"), "True or False"),
    "split as a number": (lambda: p4d.find_cells(P, split=0), "True or False"),
    "smallest above largest": (
        lambda: p4d.find_cells(P, smallest_um2=50, largest_um2=5),
        "is larger than largest_um2",
    ),
    "endless threshold": (lambda: p4d.find_cells(P, threshold_rad=np.inf), "above 0, at most"),
    "labels as phase": (lambda: p4d.find_cells(L.assign_attrs(kind="cells")), "labels of cells"),
    "labels measured": (
        lambda: p4d.measure(L.assign_attrs(kind="cells"), L, OPTICS),
        "labels of cells",
    ),
    "a mask followed": (lambda: p4d.follow_cells(L > 0), "number its pieces"),
    "negative labels": (lambda: p4d.measure(P, -L, OPTICS), "some are negative"),
    "huge labels": (lambda: p4d.follow_cells(L.astype(np.int64) * 10**9), "go up to"),
    "huge labels measured": (
        lambda: p4d.measure(P, L.astype(np.int64) * 10**15, OPTICS),
        "go up to",
    ),
    "huge labels without sign": (
        lambda: p4d.follow_cells(L.values.astype(np.uint64) * np.uint64(2**62)),
        "go up to",
    ),
    "an image as labels": (
        lambda: p4d.follow_cells(np.arange(96 * 96).reshape(1, 96, 96)),
        "as an image has",
    ),
    "half a frame of gap": (lambda: p4d.follow_cells(L, gap=1.5), "gap must be"),
    "a gap of True": (lambda: p4d.follow_cells(L, gap=True), "gap must be"),
    "no reach": (lambda: p4d.follow_cells(L, reach_um=1e300), "reach_um must be"),
    "confidence in percent": (
        lambda: p4d.measure(P, L, OPTICS, confidence=P * 0 + 90),
        "between 0 and 1",
    ),
    "confidence below 0": (
        lambda: p4d.measure(P, L, OPTICS, confidence=P * 0 - 1),
        "between 0 and 1",
    ),
    "confidence unknown": (
        lambda: p4d.measure(P, L, OPTICS, confidence=P * np.nan),
        "between 0 and 1",
    ),
    "complex confidence": (
        lambda: p4d.measure(P, L, OPTICS, confidence=P.astype(np.complex64)),
        "real numbers from 0 to 1",
    ),
    "index of a word": (lambda: p4d.measure(P, L, OPTICS, object_index="a"), "must be a number"),
    "index of 138": (lambda: p4d.measure(P, L, OPTICS, object_index=138), "between 1 and 5"),
    "wavelength of a word": (
        lambda: p4d.measure(P.assign_attrs(wavelength_um="green"), L, OPTICS),
        "wavelength_um",
    ),
    "parents of a word": (
        lambda: p4d.measure(P, L.assign_attrs(parents="x"), OPTICS),
        "note parents as",
    ),
    "units of a list": (
        lambda: p4d.unwrap(W.assign_attrs(units=np.array(["rad", "rad"])), "temporal"),
        "must be a word",
    ),
    "one absurd column": (lambda: p4d.measure(with_column(P, 1e30), L, OPTICS), "beyond"),
    "absurd truth": (lambda: p4d.compare(W, ["temporal"], truth=E * 0 + 1e30), "beyond"),
    "no methods": (lambda: p4d.compare(W, []), "at least one of"),
    "methods of a number": (lambda: p4d.compare(W, 3), "list of method ids"),
    "options of a list": (lambda: p4d.compare(W, ["temporal"], options=[1]), "options must map"),
    "no options": (
        lambda: p4d.compare(W, ["temporal"], options={"temporal": None}),
        "options must map",
    ),
    "progress of a number": (lambda: p4d.unwrap(W, "temporal", progress=3), "must be a function"),
    "cancelled of True": (
        lambda: p4d.unwrap(W, "temporal", cancelled=True),
        "must be a function",
    ),
    "a Dataset as mask": (lambda: p4d.unwrap(W, "temporal", mask=EUGLENA), "is a Dataset"),
    "negative amplitude": (
        lambda: p4d.unwrap(W, "directional-l1", amplitude=abs(E) * 0 - 1),
        "negative in many pixels",
    ),
    "a number of 400 digits": (lambda: p4d.Optics(wavelength_um=10**400), "too large"),
    "recipe twice": (
        lambda: from_text('{"n_views": 1, "n_views": 3}'),
        "sets n_views twice",
    ),
    "refocus of True": (lambda: p4d.Recipe(refocus_um=True), "refocus_um: it must not be True"),
    "reference of True": (lambda: p4d.Recipe(reference=True), "reference: it must not be True"),
    "views of True": (lambda: p4d.Recipe(n_views=True), "n_views: it must not be True"),
    "drift in words": (lambda: p4d.Recipe(drift="no"), "drift: it must be True or False"),
    "boundary of bool": (lambda: p4d.Recipe(boundary=((True, False),)), "whole numbers"),
    "boundary of words": (lambda: p4d.Recipe(boundary="first"), 'it must be "auto" or frames'),
}


def with_column(stack: xr.DataArray, value: float) -> xr.DataArray:
    values = stack.values.copy()
    values[..., 5] = value
    return stack.copy(data=values)


def from_text(text: str) -> p4d.Recipe:
    path = Path("recipe_twice.json")
    path.write_text(text)
    return p4d.Recipe.from_file(path)


@pytest.mark.parametrize("name", REFUSED)
def test_what_can_not_be_is_refused(name: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, sentence = REFUSED[name]
    with pytest.raises((TypeError, ValueError), match=sentence) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"pixel_um": 0}, "pixel_um must be"),
        ({"pixel_um": np.nan}, "pixel_um must be"),
        ({"pixel_um": True}, "pixel_um must be"),
        ({"pixel_um": "1"}, "pixel_um must be"),
        ({"frame_rate_hz": -1}, "frame_rate_hz must be"),
        ({"frame_rate_hz": np.inf}, "frame_rate_hz must be"),
        ({"angles_deg": (7, 7)}, "different from each other"),
        ({"angles_deg": (np.nan, 1)}, "finite"),
        ({"angles_deg": 3}, "list of degrees"),
        ({"angles_deg": "ab"}, "angles_deg must be"),
    ],
)
def test_keywords_of_open_phase(npy: Path, keywords: dict, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        p4d.open_phase(npy, **keywords)


DOUBTED = {
    "amplitude of nothing": (
        lambda: p4d.unwrap(W, "directional-l1", amplitude=abs(E) * np.nan),
        "0 or not known everywhere, and counts as not given",
    ),
    "a mask as one cell": (
        lambda: p4d.measure(P, (V > 0).astype(np.uint8), OPTICS),
        "one number for several pieces",
    ),
    "increment in another unit": (
        lambda: p4d.measure(P, L, OPTICS, refraction_increment_ml_per_g=180),
        "increment of 180 mL/g is unusual",
    ),
    "index below the medium": (
        lambda: p4d.measure(P, L, OPTICS, object_index=1.2),
        "below that of the medium",
    ),
    "oblique regions": (
        lambda: p4d.measure(P, {"all": np.ones((96, 96), bool)}, OPTICS, oblique=True),
        "for cells only",
    ),
    "phase of something else": (
        lambda: p4d.confidence(E + 1, W),
        "of the same recording",
    ),
}


@pytest.mark.parametrize("name", DOUBTED)
def test_what_is_probably_wrong_is_warned_of(name: str) -> None:
    call, sentence = DOUBTED[name]
    with pytest.warns(UserWarning, match=sentence):
        call()


def test_what_is_right_in_other_words_is_right() -> None:
    assert p4d.Recipe(boundary=(0, 1)).boundary == ((0, 1),)
    assert p4d.Recipe(boundary=[[np.int64(2), 1]]).boundary == ((2, 1),)
    assert p4d.Recipe(recording=Path("a.tif")).recording == "a.tif"
    assert p4d.Recipe(methods="temporal").methods == ("temporal",)
    assert list(p4d.compare(W, "temporal").results) == ["temporal"]


@pytest.mark.slow
def test_cells_of_three_axes_are_measured() -> None:
    for stack in (P.isel(angle=0), P.isel(time=0), P.isel(time=1, angle=1)):
        cells = p4d.find_cells(stack)
        table = p4d.measure(stack, cells, OPTICS)
        assert set(table["cell"]) == {1, 2}
        plain = p4d.measure(stack, cells.values, OPTICS) if "time" in stack.dims else table
        np.testing.assert_array_equal(plain["dry mass (pg)"], table["dry mass (pg)"])


def test_a_single_time_and_angle_keep_their_units() -> None:
    everything = {"all": np.ones((40, 56), bool)}
    times = {"time": ("time", E["time"].values * 1000, {"units": "ms"})}
    angles = {"angle": ("angle", np.deg2rad(E["angle"].values), {"units": "rad"})}
    table = p4d.measure(E.assign_coords(times).isel(time=2), everything, OPTICS)
    np.testing.assert_allclose(table["time (s)"], float(E["time"][2]))
    table = p4d.measure(E.assign_coords(angles).isel(angle=1), everything, OPTICS)
    np.testing.assert_allclose(table["angle (deg)"], float(E["angle"][1]))


def test_units_are_looked_up_and_not_computed() -> None:
    with pytest.raises(ValueError, match="which is no phase"):
        p4d.unwrap(W.assign_attrs(units="9**9**9 rad"), "spatial-2d")


def test_recipes_with_numbers_of_numpy_are_written(tmp_path: Path) -> None:
    lobe = p4d.Lobe((0.2, 0.25), np.float32(0.08), np.int64(7), np.bool_(True))
    recipe = p4d.Recipe(lobes=(lobe,))
    assert p4d.Recipe.from_file(recipe.to_file(tmp_path / "r.json")) == recipe


def test_masked_labels_are_none() -> None:
    masked = np.ma.masked_array(V, mask=V == 1)
    assert set(p4d.measure(P, masked, OPTICS)["cell"]) == {2}
    assert len(np.unique(p4d.follow_cells(masked))) == 2


def test_labels_of_8_bits_are_measured() -> None:
    small = np.where(V == 2, 255, V).astype(np.uint8)
    table = p4d.measure(P, small, OPTICS)
    assert set(table["cell"]) == {1, 255}
    wanted = p4d.measure(P, L, OPTICS)
    np.testing.assert_allclose(table["dry mass (pg)"], wanted["dry mass (pg)"])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda r: p4d.find_lobes(r, 2, orient="no"), "True or False"),
        (lambda r: p4d.find_lobes(r, 2, radius=0), "radius must be"),
        (lambda r: p4d.find_lobes(r, 2, radius=1e-9), "radius must lie"),
        (lambda r: p4d.reconstruct(r, twins(r)), "are the same view"),
        (lambda r: p4d.reconstruct(r, p4d.find_lobes(r, 2), reference=True), "frame number"),
        (lambda r: p4d.reconstruct(r, p4d.find_lobes(r, 2), refocus_um=1e9), "must lie within"),
    ],
)
def test_holograms_with_wrong_arguments(rec: p4d.Recording, call, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        call(rec)


def test_a_lobe_without_a_carrier_is_warned_of(rec: p4d.Recording) -> None:
    with pytest.warns(UserWarning, match="next to nothing in view 1"):
        p4d.reconstruct(rec, [p4d.Lobe((0.02, 0.45), 0.03)])


def test_the_sign_of_cells_is_minded() -> None:
    with pytest.warns(UserWarning, match="negative dry mass"):
        p4d.measure(-P, L, OPTICS)
    turned = P.assign_coords(angle=[0.0, 120.0])
    with pytest.raises(ValueError, match="less than 85 degrees"):
        p4d.measure(turned, L.assign_coords(angle=[0.0, 120.0]), OPTICS, oblique=True)


def twins(rec: p4d.Recording) -> list[p4d.Lobe]:
    lobe = p4d.find_lobes(rec, 2)[0]
    ky, kx = lobe.carrier
    return [lobe, p4d.Lobe((ky + 1e-6, kx), lobe.radius, 40.0)]


@pytest.mark.slow
def test_a_table_that_no_batch_has_made_is_kept(npy: Path, tmp_path: Path) -> None:
    recipe = p4d.Recipe(methods=("temporal",), mask=None)
    for name in ("summary.csv", "cells.csv"):
        out = tmp_path / name.split(".")[0]
        out.mkdir()
        (out / name).write_text("my own table")
        with pytest.raises(OSError, match="is of no batch"):
            run_batch(recipe, [npy], out)
        assert (out / name).read_text() == "my own table"
        assert sorted(p.name for p in out.iterdir()) == [name]
    table = run_batch(recipe, str(npy), tmp_path / "one")  # a single file will do
    assert table["status"].tolist() == ["done"]
    assert run_batch(recipe, [npy], tmp_path / "one")["status"].tolist() == ["done"]


@pytest.mark.skipif(os.name != "posix", reason="needs pipes and devices")
def test_a_recipe_is_read_from_files_only(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for path in (Path("/dev/zero"), pipe, tmp_path):
        with pytest.raises(ValueError, match="is no recipe: it is no file"):
            p4d.Recipe.from_file(path)


@pytest.mark.parametrize("first", [1, 2])
def test_frames_that_were_added_to_a_file_belong_to_it(
    rec: p4d.Recording, tmp_path: Path, first: int
) -> None:
    frames = np.asarray(rec.holograms.data)
    path = tmp_path / "added.tif"
    tifffile.imwrite(path, frames[:first])
    tifffile.imwrite(path, frames[first:], append=True)
    found = p4d.open_recording(path)
    np.testing.assert_array_equal(found.holograms.values, frames)
    assert not any("pages" in note for note in found.notes)


def test_pages_that_are_left_out_are_said(rec: p4d.Recording, tmp_path: Path) -> None:
    frames = np.asarray(rec.holograms.data)
    path = tmp_path / "added.tif"
    tifffile.imwrite(path, frames[:2])
    tifffile.imwrite(path, frames[2:, :40, :40], append=True)
    found = p4d.open_recording(path)
    assert found.n_frames == 2
    assert any("Of 3 pages 2 are read" in note for note in found.notes)


def test_masks_are_probably_no_holograms(tmp_path: Path) -> None:
    mask = np.indices((2, 40, 48)).sum(0) % 3 == 0
    np.save(tmp_path / "mask.npy", mask)
    for given in (mask, tmp_path / "mask.npy"):
        with pytest.warns(UserWarning, match="holds True and False, as masks do"):
            p4d.open_recording(given)


def test_an_empty_name_is_not_the_folder_the_program_runs_in(
    rec: p4d.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("video.npy", np.asarray(rec.holograms.data))
    recipe = p4d.Recipe(methods=("spatial-2d",), boundary=((0, 0),))
    outcome = p4d.run(recipe, p4d.open_recording("video.npy"))
    for call in (
        lambda: p4d.open_recording(""),
        lambda: p4d.open_phase(""),
        lambda: p4d.write_phase("", W),
        lambda: p4d.read_results(""),
        lambda: write_outcome(outcome, ""),
        lambda: run_batch(p4d.Recipe(), ["video.npy"], ""),
        lambda: run_batch(p4d.Recipe(), [""], "out"),
        lambda: p4d.Recipe().to_file(""),
        lambda: p4d.Recipe.from_file(""),
    ):
        with pytest.raises(ValueError, match="the name of a file or folder is empty"):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["video.npy"]


def test_noise_is_no_reference(rec: p4d.Recording) -> None:
    noise = np.random.default_rng(0).integers(0, 255, rec.frame_shape).astype(np.uint8)
    with pytest.raises(ValueError, match="the reference shows no fringes in at least one lobe"):
        p4d.reconstruct(rec, p4d.find_lobes(rec), reference=noise)


@pytest.mark.filterwarnings("ignore:.*a dense object is bright or dark here is a guess")
def test_a_recipe_for_another_microscope_is_said() -> None:
    exact = p4d.simulation.swimming_euglena((96, 96), 2, pixel_um=0.5)
    rec = p4d.simulation.multiplexed_video(exact["phase"])
    recipe = p4d.Recipe(
        methods=("spatial-2d",), boundary=((0, 0),), optics=p4d.Optics(0.5, 3.45, 20, 1.33)
    )
    with pytest.warns(UserWarning, match="the optics of the recording count"):
        outcome = p4d.run(recipe, rec)
    assert outcome.recipe.optics == rec.optics


@pytest.fixture(scope="module")
def video() -> tuple[p4d.Recording, list[p4d.Lobe]]:
    """A small multiplexed video and its views."""
    exact = p4d.simulation.swimming_euglena((96, 96), 2, pixel_um=0.5)
    rec = p4d.simulation.multiplexed_video(exact["phase"])
    return rec, list(p4d.find_lobes(rec, n_views=2))


def test_a_reference_goes_by_the_names_of_its_axes(video: Any) -> None:
    rec, lobes = video
    frame = np.asarray(rec.raw_frame(0))
    by_name = p4d.reconstruct(rec, lobes, xr.DataArray(frame.T, dims=("x", "y")))
    plain = p4d.reconstruct(rec, lobes, frame)
    np.testing.assert_array_equal(by_name["phase"].values, plain["phase"].values)
    with pytest.raises(ValueError, match="it must have y and x"):
        p4d.reconstruct(rec, lobes, xr.DataArray(frame, dims=("row", "column")))


def test_a_list_is_no_window(video: Any) -> None:
    with pytest.raises(ValueError, match="window must be one of"):
        p4d.reconstruct(*video, window=["disk"])


@pytest.mark.parametrize("units", ["rad", "radian", "radians"])
def test_phase_is_no_hologram_however_its_unit_is_written(units: str) -> None:
    phase = xr.DataArray(np.zeros((2, 8, 8)), dims=("time", "y", "x"), attrs={"units": units})
    with pytest.raises(ValueError, match="phase in radians"):
        p4d.open_recording(phase)


def test_masked_pixels_have_no_dry_mass() -> None:
    inside = np.ones((4, 4))
    masked = np.ma.masked_array(inside, np.eye(4))
    whole, part = (p4d.Optics().dry_mass_pg(phase, 0.25) for phase in (inside, masked))
    assert part == pytest.approx(whole * 12 / 16)


def test_arrays_that_refuse_to_be_read_are_one_sentence() -> None:
    class Stubborn:
        ndim, shape, dtype = 2, (3, 3), np.dtype("float32")

        def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
            msg = "it requires a gradient"
            raise RuntimeError(msg)

    with pytest.raises(ValueError, match="can't be read as an array: it requires a gradient"):
        p4d.unwrap(Stubborn(), "spatial-2d")


def test_what_is_written_is_in_the_usual_units(tmp_path: Path) -> None:
    phase = p4d.simulation.swimming_euglena((24, 32), 2)["phase"]
    in_nm = phase.assign_coords(
        {axis: (axis, 1000 * phase[axis].values, {"units": "nm"}) for axis in ("y", "x")}
    )
    for ending in (".ome.tif", ".ome.zarr"):
        read = p4d.read_results(p4d.write_phase(tmp_path / f"cell{ending}", in_nm))
        np.testing.assert_allclose(read["x"].values, phase["x"].values)
        assert read["x"].attrs["units"] == "um"


def test_colours_of_a_palette_are_no_grey_values(tmp_path: Path) -> None:
    picture = Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).convert("P")
    picture.putpalette(list(range(256)) * 3)
    picture.save(tmp_path / "palette.tif")
    with pytest.raises(ValueError, match="numbers of colours in a palette"):
        p4d.open_recording(tmp_path / "palette.tif")


def test_an_array_is_no_path() -> None:
    with pytest.raises(TypeError, match="goes to unwrap"):
        p4d.open_phase(W.values)


def test_dates_are_compared_by_the_clock() -> None:
    dates = np.datetime64("2026-03-01T10:00:00", "ns") + np.arange(3) * np.timedelta64(1, "s")
    one = E.assign_coords(time=dates)
    later = E.assign_coords(time=dates + np.timedelta64(1, "h"))
    assert float(np.abs(difference(one, one.copy())).max()) == 0
    with pytest.raises(ValueError, match="other time coordinates"):
        difference(one, later)
    # By dates, frames find each other, wherever the counting begins.
    with pytest.raises(ValueError, match="time"):
        difference(one.isel(time=slice(1, 3)), later.isel(time=slice(0, 2)))


def test_which_of_several_arrays_is_read_is_said(tmp_path: Path) -> None:
    frames = (100 * np.random.default_rng(0).random((2, 32, 32))).astype(np.uint8)
    np.savez(tmp_path / "two.npz", first=frames, second=frames)
    notes = p4d.open_recording(tmp_path / "two.npz").notes
    assert any("holds first, second; first is read" in note for note in notes)
    assert not any(
        "is read" in note
        for note in p4d.open_recording(tmp_path / "two.npz", dataset="second").notes
    )


@pytest.mark.slow
def test_pixels_of_a_layer_are_square_and_in_any_unit() -> None:
    frames = (100 * np.random.default_rng(0).random((2, 32, 32))).astype(np.uint8)
    viewer = ViewerModel()
    uneven = viewer.add_image(frames, scale=(1, 2, 1), units=("s", "um", "um"))
    with pytest.raises(ValueError, match="must be square; correct the layer's scale"):
        p4d.open_recording(uneven)
    in_nm = viewer.add_image(frames, scale=(500, 200, 200), units=("ms", "nm", "nm"))
    recording = p4d.open_recording(in_nm)
    assert recording.optics.pixel_um == pytest.approx(0.2)
    assert recording.frame_rate_hz == pytest.approx(2)
