"""The microscope that is typed in, given or noted, beside the pixel that a file names."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.cli.running import with_optics
from napari_phase4d.pipeline import light_for, open_by, watch
from napari_phase4d.recording import Recording


def with_pixel(path: Path, frames: Any, pixel_um: float = 0.1) -> Path:
    """Write a TIFF that names its pixel."""
    resolution = (1 / pixel_um, 1 / pixel_um)
    metadata = {"unit": "um", "axes": "TYX"}
    tifffile.imwrite(path, frames, imagej=True, resolution=resolution, metadata=metadata)
    return path


@pytest.fixture
def holograms(tmp_path: Path) -> Path:
    """Holograms whose pixel is 0.1 um wide."""
    return with_pixel(tmp_path / "holograms.tif", np.ones((2, 16, 16), np.uint8))


@pytest.fixture
def phase_values() -> Any:
    return np.random.default_rng(0).uniform(-3, 3, (2, 16, 16)).astype(np.float32)


@pytest.fixture
def phase_file(tmp_path: Path, phase_values: Any) -> Path:
    """Wrapped phase whose pixel is 0.1 um wide."""
    return with_pixel(tmp_path / "phase.tif", phase_values)


#: What is said where one of two numbers follows from the pixel that a file names.
STAYS = r"the pixel in the file, 0.1 um, stays: the camera's is taken for .* the magnification for"


def opened_with(path: Path, numbers: dict[str, float], *, stays: bool = False, **settings: Any):
    """Open a file by a recipe with numbers that were typed in."""
    recipe = p4d.Recipe(recording=str(path), **settings)
    with pytest.warns(UserWarning, match=STAYS) if stays else nullcontext():
        recipe = with_optics(recipe, numbers)
    return open_by(recipe)


# ---- typed in ---------------------------------------------------------------------------------

#: What is typed in, and the camera pixel and magnification that follow at 0.1 um.
TYPED = {
    "wavelength": ({"wavelength_um": 0.532}, 5.2, 52),
    "camera pixel": ({"camera_pixel_um": 3.45}, 3.45, 34.5),
    "magnification": ({"magnification": 40}, 4.0, 40),
    "both": ({"camera_pixel_um": 3.45, "magnification": 10}, 3.45, 10),
}


@pytest.mark.parametrize("case", TYPED)
def test_the_pixel_of_a_file_stays(holograms: Path, phase_file: Path, case: str) -> None:
    numbers, camera_pixel_um, magnification = TYPED[case]
    stays = case in ("camera pixel", "magnification")
    optics = opened_with(holograms, numbers, stays=stays).optics
    assert optics.camera_pixel_um == pytest.approx(camera_pixel_um)
    assert optics.magnification == pytest.approx(magnification)
    assert optics.wavelength_um == numbers.get("wavelength_um", 0.6328)
    stack = opened_with(phase_file, numbers, stays=stays)
    assert float(stack.x[1]) == pytest.approx(camera_pixel_um / magnification, rel=1e-4)


def test_numbers_go_into_the_recipes_own_microscope(holograms: Path) -> None:
    same, other = p4d.Optics(magnification=52), p4d.Optics(magnification=20)
    typed = {"camera_pixel_um": 3.45}
    mended = opened_with(holograms, typed, stays=True, optics=same).optics
    assert mended.pixel_um == pytest.approx(0.1)
    assert opened_with(holograms, typed, optics=other).optics == p4d.Optics(0.6328, 3.45, 20)


def test_a_file_without_a_pixel_gets_the_papers_microscope(
    tmp_path: Path, phase_values: Any
) -> None:
    np.save(tmp_path / "holograms.npy", np.ones((2, 16, 16), np.uint8))
    np.save(tmp_path / "phase.npy", phase_values)
    optics = opened_with(tmp_path / "holograms.npy", {"magnification": 40}).optics
    assert optics == p4d.Optics(magnification=40)
    stack = opened_with(tmp_path / "phase.npy", {"magnification": 40})
    assert float(stack.x[1]) == pytest.approx(5.2 / 40)
    counted = opened_with(tmp_path / "phase.npy", {"wavelength_um": 0.532})
    assert float(counted.x[1]) == 1
    assert counted.attrs["notes"] == open_by(
        p4d.Recipe(recording=str(tmp_path / "phase.npy"))
    ).attrs["notes"]  # fmt: skip


@pytest.mark.slow
def test_the_pixel_stays_while_one_records(tmp_path: Path, small_video: Recording) -> None:
    frames = small_video.holograms.values[:4].astype(np.uint8)
    for number, frame in enumerate(frames):
        with_pixel(tmp_path / f"frame_{number}.tif", frame[None])
    recipe = p4d.Recipe(n_views=2, methods=("spatial-2d",), first_frames=2)
    numbers = {"camera_pixel_um": 3.45}
    with pytest.warns(UserWarning, match=STAYS):
        found = watch(
            tmp_path, recipe, tmp_path / "out", frames=4, patience_s=2, optics_numbers=numbers
        )
    assert found.recipe.optics.camera_pixel_um == 3.45
    assert found.recipe.optics.pixel_um == pytest.approx(0.1)
    with pytest.raises(ValueError, match="magnification must be a number above 0"):
        watch(tmp_path / "none", recipe, tmp_path / "o", optics_numbers={"magnification": -1})


# ---- given ------------------------------------------------------------------------------------


def test_another_pixel_than_the_file_names_is_noted(holograms: Path, phase_file: Path) -> None:
    said = "The pixel is 0.15 um wide as given; the file says 0.1 um."
    optics, near = p4d.Optics(magnification=5.2 / 0.15), p4d.Optics(magnification=52.1)
    found = p4d.open_recording(holograms, optics)
    assert found.optics == optics
    assert said in found.notes
    assert said in open_by(p4d.Recipe(recording=str(phase_file), optics=optics)).attrs["notes"]
    assert said not in found.calibrated(near).notes
    assert said in p4d.open_recording(holograms).calibrated(optics).notes
    for path in (holograms, phase_file):
        opened = open_by(p4d.Recipe(recording=str(path), optics=near))
        notes = opened.notes if isinstance(opened, Recording) else opened.attrs["notes"]
        assert not any("as given" in note for note in notes)


def test_another_pixel_than_an_array_or_layer_names_is_noted() -> None:
    said = "The pixel is 0.15 um wide as given; the data say 0.1 um."
    optics, frames = p4d.Optics(magnification=5.2 / 0.15), np.ones((2, 16, 16), np.uint8)
    places = np.arange(16) * 0.1
    array = xr.DataArray(frames, dims=("time", "y", "x"), coords={"y": places, "x": places})
    assert said in p4d.open_recording(array, optics).notes
    layer = SimpleNamespace(
        data=frames, name="layer", axis_labels=("t", "y", "x"), scale=(1, 0.1, 0.1),
        units=("s", "um", "um"),
    )  # fmt: skip
    assert said in p4d.open_recording(layer, optics).notes
    numbers = array.assign_coords(y=np.arange(16), x=np.arange(16))
    assert p4d.open_recording(numbers, optics, 1).notes == ()


@pytest.mark.slow
def test_another_pixel_than_results_note_is_warned_of(tmp_path: Path) -> None:
    yeast = p4d.simulation.budding_yeast(n_times=2)["wrapped"]
    path = p4d.write_phase(tmp_path / "yeast.ome.tif", yeast)
    recipe = p4d.Recipe(recording=str(path), methods=("spatial-2d",), optics=p4d.Optics())
    pixel_um = float(yeast.x[1] - yeast.x[0])
    with pytest.warns(UserWarning, match=rf"optics \(the pixel in the file: {pixel_um:.4g} um\)"):
        p4d.run(recipe)


# ---- noted by phase -----------------------------------------------------------------------------


def test_wavelength_and_medium_that_phase_notes_count() -> None:
    phase = p4d.simulation.budding_yeast(n_times=1)["wrapped"]
    noted = phase.assign_attrs(wavelength_um=0.5, medium_index=1.5)
    given, own = p4d.Optics(0.4), p4d.Optics(0.7, magnification=20)
    assert light_for(None, noted) == p4d.Optics(0.5, medium_index=1.5)
    assert light_for(None, noted, own) == p4d.Optics(0.5, magnification=20, medium_index=1.5)
    assert light_for(given, noted, own) == given


def test_a_wavelength_that_is_nowhere_said_is_warned_of() -> None:
    phase = p4d.simulation.budding_yeast(n_times=1)["wrapped"]
    bare = phase.assign_attrs(wavelength_um=None, medium_index=None)
    with pytest.warns(UserWarning, match="the wavelength is not in the file; 632.8 nm are taken"):
        assert light_for(None, bare) == p4d.Optics()
    assert light_for(None, bare, p4d.Optics(0.7)) == p4d.Optics(0.7)
    views = np.full(phase.sizes["angle"], 0.5)
    assert light_for(None, bare.assign_coords(wavelength=("angle", views))) == p4d.Optics()


@pytest.mark.slow
def test_volumes_of_cells_go_by_the_medium_that_phase_notes(tmp_path: Path) -> None:
    volumes = []
    for index in (1.333, 1.36):
        yeast = p4d.simulation.budding_yeast(n_times=2)["wrapped"].assign_attrs(medium_index=index)
        path = p4d.write_phase(tmp_path / f"{index}.ome.tif", yeast)
        cells = p4d.CellSettings(object_index=1.38)
        found = p4d.run(
            p4d.Recipe(recording=str(path), methods=("temporal-angular",), cells=cells)
        )
        volumes.append(found.cells.table["volume (um^3)"].sum())
    assert volumes[1] / volumes[0] == pytest.approx((1.38 - 1.333) / (1.38 - 1.36))


def test_what_phase_notes_of_light_stays_where_other_numbers_are_typed(tmp_path: Path) -> None:
    """With a magnification typed in, the light of the paper took the place of what is noted."""
    light = p4d.Optics(wavelength_um=0.532)
    yeast = p4d.simulation.budding_yeast(n_times=2, optics=light)["wrapped"]
    path = p4d.write_phase(tmp_path / "green.ome.tif", yeast)
    recipe = p4d.Recipe(recording=str(path), methods=("temporal",), boundary=((0, 0),))
    with pytest.warns(UserWarning, match=r"the pixel in the file, 0.2 um, stays: .* 20$"):
        typed = with_optics(recipe, {"magnification": 20})
    assert typed.optics.wavelength_um == 0.532
    p4d.run(typed)
    with pytest.warns(UserWarning, match=r"measured at 532 nm, but the recipe says 500 nm"):
        p4d.run(with_optics(recipe, {"wavelength_um": 0.5}))
