"""Every script of the gallery runs, and shows what its page says."""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import napari_phase4d as p4d
from napari_phase4d.analysis import wrong_cycle_share

pytestmark = pytest.mark.slow

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "gallery"
Names = dict[str, Any]


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Names]]:
    """Run a script in an empty folder, without a window, and return its names."""
    monkeypatch.chdir(tmp_path)
    before = plt.get_backend()
    plt.switch_backend("agg")

    def run(name: str) -> Names:
        names = runpy.run_path(str(GALLERY / name))
        assert plt.get_fignums(), "a page of the gallery has a figure"
        for number in plt.get_fignums():
            shows_something(plt.figure(number))
        return names

    yield run
    plt.close("all")
    plt.switch_backend(before)


def shows_something(figure: Figure) -> None:
    """Check that no picture of a figure has one colour only, and that all its axes are in it."""
    figure.canvas.draw()
    pictures = [image for axis in figure.axes for image in axis.get_images()]
    lines = [line for axis in figure.axes for line in axis.get_lines()]
    assert pictures or lines
    for image in pictures:
        colours = image.to_rgba(image.get_array()).reshape(-1, 4)
        assert len(np.unique(colours, axis=0)) > 1, image.axes.get_title()


def test_every_script_is_tested() -> None:
    here = Path(__file__).read_text(encoding="utf-8")
    assert [
        p.name for p in sorted(GALLERY.glob("*.py")) if f'script("{p.name}")' not in here
    ] == []


def test_video_to_phase(script: Callable[[str], Names]) -> None:
    names = script("01_video_to_phase.py")
    phase: xr.DataArray = names["phase"]
    pixels = p4d.simulation.pixels_of(phase)
    exact = p4d.simulation.swimming_euglena(phase.shape[2:], 24, peak_rad=9, **pixels)["phase"]
    assert wrong_cycle_share(phase, exact.assign_coords(phase.coords)) < 0.001


@pytest.mark.thorough
def test_methods_against_truth(script: Callable[[str], Names]) -> None:
    names = script("02_methods_against_truth.py")
    table = names["comparison"].table
    one_wavelength = [m for m, own in p4d.unwrapping.BUILT_IN.items() if own.wavelengths == 1]
    assert list(table.index) == one_wavelength
    assert table["mse_rad2"].idxmin() == "directional-l1"
    for method, result in names["comparison"].results.items():
        label = table.loc[method, "method"]
        share = 100 * wrong_cycle_share(result, names["yeast"]["phase"])
        assert names["wrong"][label] * 100 == pytest.approx(share, abs=0.05)


def test_boundary_frame(script: Callable[[str], Names]) -> None:
    names = script("03_boundary_frame.py")
    assert names["best"] == names["cell"].attrs["boundary"]
    assert names["errors"]["best"] < 0.01
    assert names["errors"]["worst"] > 1


def test_dry_mass(script: Callable[[str], Names]) -> None:
    tables = script("04_dry_mass.py")["tables"]
    masses = {name: table["dry mass (pg)"].to_numpy() for name, table in tables.items()}
    assert masses["T/A"] == pytest.approx(masses["exact"], rel=0.02)
    assert masses["2-D"].min() >= 0
    assert masses["2-D"][-1] < 0.8 * masses["exact"][-1]


@pytest.mark.filterwarnings("ignore:.*curvature is left:UserWarning")  # what it shows
def test_focus_and_aberrations(script: Callable[[str], Names]) -> None:
    names = script("05_focus_and_aberrations.py")
    assert names["found_um"] == pytest.approx(-25, abs=0.5)
    assert names["focus"].distance_um == pytest.approx(-25, abs=1)
    steps = names["steps"]
    contrast = {k: float(d["amplitude"].std() / d["amplitude"].mean()) for k, d in steps.items()}
    assert contrast["and in focus"] < contrast["without the bend"] / 4
    corner = {k: float(np.abs(d["phase"][..., :8, :8]).mean()) for k, d in steps.items()}
    assert corner["without the bend"] < 0.1 < corner["as recorded"]


@pytest.mark.thorough
def test_trust(script: Callable[[str], Names]) -> None:
    names = script("06_trust.py")
    trust, wrong = names["trust"].values, names["wrong"].values.astype(bool)
    assert wrong[trust < 0.5].mean() > 0.9
    assert wrong[trust > 0.9].mean() < 0.002
    assert wrong[names["time"], names["angle"]].sum() == wrong.sum(axis=(2, 3)).max()


@pytest.mark.thorough
def test_larger_than_memory(script: Callable[[str], Names]) -> None:
    names = script("07_larger_than_memory.py")
    assert names["same"]
    assert not isinstance(names["stack"].data, np.ndarray)
    # The object is drawn in other pixels than those of the microscope.
    ratio = 200 / names["stack"].sizes["y"]
    pixels = {"pixel_um": 0.24 * ratio, "first_um": 0.24 * (ratio - 1) / 2}
    exact = p4d.simulation.swimming_euglena(names["stack"].shape[2:], 32, peak_rad=7, **pixels)[
        "phase"
    ]
    assert wrong_cycle_share(names["stack"], exact.values) < 0.001


def test_own_unwrapper(script: Callable[[str], Names]) -> None:
    names = script("08_own_unwrapper.py")
    rows, usual = names["errors"][0.0]
    assert max(rows, usual) < 1e-6
    rows, usual = names["errors"][0.8]
    assert rows > 10 * usual


def test_every_picture_has_something_that_makes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(GALLERY.parent))
    makers = import_module("make_pictures").MAKERS
    for module, function in makers:
        assert callable(getattr(import_module(f"picture_making.{module}"), function))
    made = {name for names in makers.values() for name in names}
    made.add("speed_growth")  # by the benchmarks
    assert {path.stem for path in (GALLERY.parent / "pictures").iterdir()} == made


@pytest.mark.thorough
def test_each_cell_keeps_its_mass_until_it_divides_or_leaves(
    script: Callable[[str], Names],
) -> None:
    names = script("09_cells.py")
    table = names["table"]
    assert table["cell"].nunique() == 6
    for _, rows in table.groupby(["cell", "angle (deg)"]):
        first, error = rows["dry mass (pg)"].iloc[0], rows["dry mass error (pg)"].iloc[0]
        assert abs(rows["dry mass (pg)"].iloc[3] - first) < 6 * error


@pytest.mark.thorough
def test_phase_while_one_records(script: Callable[[str], Names]) -> None:
    names = script("11_live.py")
    assert sorted(names["late"]) == list(range(names["N"]))
    again = names["again"].comparison.results["temporal-angular"].values
    np.testing.assert_array_equal(names["outcome"].comparison.results["temporal-angular"], again)


def test_two_wavelengths_tell_the_steps(script: Callable[[str], Names]) -> None:
    names = script("10_wavelengths.py")
    wrong = {
        name: wrong_cycle_share(stack, names["exact"]["phase"])
        for name, stack in names["found"].results.items()
    }
    assert wrong["synthetic-wavelength"] == 0
    assert wrong["directional-l1"] > 0.05
