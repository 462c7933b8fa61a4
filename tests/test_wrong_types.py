"""Everything that is no argument at all, given to what is public: one sentence of this program."""

from __future__ import annotations

import datetime as dt
import decimal
import inspect
import os
import re
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

import napari_phase4d as p4d
from napari_phase4d import analysis, holography, pipeline, plotting, simulation
from napari_phase4d import io as files
from napari_phase4d.words import checked_call, in_words, parts_of
from test_wrong_input import EXACT, FRAMES, LOBE, OPTICS, RECORDING, WRAPPED

DATA = xr.Dataset({"phase": EXACT, "wrapped": WRAPPED})
UNWRAPPED = p4d.unwrap(WRAPPED, "spatial-2d")
CELL = np.ones(WRAPPED.shape[-2:], bool)
FOUND = {"a": UNWRAPPED}

#: A call that is right, of which one argument at a time is made wrong.
RIGHT: dict[Callable[..., Any], dict[str, Any]] = {
    p4d.unwrap: {"phase": WRAPPED, "method": "temporal"},
    p4d.compare: {"phase": WRAPPED, "methods": ["temporal"]},
    p4d.confidence: {"unwrapped": UNWRAPPED, "phase": WRAPPED},
    p4d.measure: {"unwrapped": EXACT, "regions": {"a": CELL}, "optics": OPTICS},
    p4d.score_boundaries: {"phase": WRAPPED},
    p4d.find_cells: {"unwrapped": EXACT},
    p4d.follow_cells: {"labels": np.ones((2, 8, 8), int)},
    p4d.power_spectrum: {"rec": RECORDING},
    p4d.find_lobes: {"rec": RECORDING, "n_views": 1},
    p4d.reconstruct: {"rec": RECORDING, "lobes": [LOBE]},
    p4d.open_recording: {"path_or_array": FRAMES},
    p4d.open_phase: {"path": "phase.npy"},
    p4d.read_results: {"path": "result.ome.tif"},
    p4d.write_phase: {"path": "written.ome.tif", "stack": UNWRAPPED},
    p4d.Optics: {},
    p4d.Lobe: {"carrier": (0.2, 0.25), "radius": 0.08},
    p4d.RawLayout: {"height": 8, "width": 8},
    p4d.CellSettings: {},
    p4d.Recipe: {},
    p4d.run: {"recipe": p4d.Recipe(recording="phase.npy", content="phase")},
    analysis.difference: {"result": EXACT, "reference": EXACT},
    analysis.mean_squared_error: {"unwrapped": EXACT, "truth": EXACT},
    analysis.wrong_cycle_share: {"unwrapped": EXACT, "truth": EXACT},
    analysis.itoh_margin: {"phase": EXACT},
    analysis.residues: {"wrapped": WRAPPED},
    analysis.traces: {"results": FOUND, "frame": (0, 0), "where": (1, 1)},
    analysis.most_trusted: {"results": FOUND},
    analysis.best_known: {"results": FOUND},
    analysis.polygon_mask: {"vertices_yx": [(0, 0), (0, 5), (5, 5)], "shape": (8, 8)},
    analysis.region_masks: {"labels": np.ones((8, 8), int)},
    analysis.with_wavelength: {"wavelength_um": 0.6},
    analysis.summary_of_cells: {},
    analysis.cells_in: {"unwrapped": EXACT, "optics": OPTICS},
    analysis.with_empty_field: {"unwrapped": UNWRAPPED, "wrapped": WRAPPED},
    simulation.with_noise: {"data": DATA},
    simulation.at_wavelengths: {"data": DATA, "wavelengths_um": [0.5, 0.6]},
    files.write_table: {"path": "table.csv", "table": pd.DataFrame({"a": [1]})},
    files.write_figure: {"path": "figure.png", "figure": Figure()},
    pipeline.fingerprint: {"source": "phase.npy"},
    pipeline.result_folders: {"files": ["a.npy"], "out": "out"},
    pipeline.make_folder: {"out": Path("out")},
    pipeline.read_outcome: {},
    pipeline.open_by: {"recipe": p4d.Recipe(recording="phase.npy", content="phase")},
    pipeline.write_outcome: {"folder": "out"},
    plotting.named_results: {"comparison": p4d.compare(WRAPPED, ["spatial-2d"])},
    plotting.colour_of: {"cell": 1},
    holography.lobe_warnings: {"lobes": [LOBE]},
}  # fmt: skip
#: What else belongs to it, made when it is asked for, in the folder of the test.
MADE: dict[Callable[..., Any], Callable[[], dict[str, Any]]] = {
    analysis.with_wavelength: lambda: {
        "table": analysis.noise_figures(p4d.reconstruct(RECORDING, [LOBE]))
    },
    analysis.summary_of_cells: lambda: {"table": analysis.cells_in(EXACT, OPTICS).table},
    pipeline.write_outcome: lambda: {"outcome": outcome()},
    pipeline.read_outcome: lambda: {
        "folder": pipeline.write_outcome(outcome(), "out")[0].parent
    },
}  # fmt: skip
WRONG: list[Any] = [
    None, True, -1, 2.5, np.nan, "x", "", b"x", [], ["a"], [1], (1, 2, 3), {}, {"a": 1}, {1: 2},
    set(), object(), int, 1j, 10**400, "\0", "\ud800", Path("nope/x.tif"), iter([1]),
    dt.datetime(2020, 1, 1, tzinfo=dt.UTC), decimal.Decimal(1), np.zeros(0), np.array("a"),
    np.array([None]), np.zeros((2, 2, 2, 2, 2)), np.ma.masked_all((4, 32, 40)),
    np.datetime64("2020"), xr.DataArray(3.0), xr.Dataset(), DATA, EXACT.rename(x="q"),
    pd.DataFrame(), pd.Series([1.0]), RECORDING, OPTICS,
]  # fmt: skip


def outcome() -> pipeline.Outcome:
    """Return what comes of the wrapped phase that lies in the folder of the test."""
    return p4d.run(p4d.Recipe(recording="phase.npy", content="phase", methods=("spatial-2d",)))


@pytest.mark.thorough
@pytest.mark.parametrize("call", RIGHT, ids=lambda call: call.__name__)
def test_no_error_of_another_package_comes_out(
    call: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("phase.npy", WRAPPED.values)
    p4d.write_phase("result.ome.tif", UNWRAPPED)
    right = RIGHT[call] | MADE.get(call, dict)()
    assert error_of(call, **right) is None
    ours = str(Path(p4d.__file__).parent)
    for name in inspect.signature(call).parameters:
        for wrong in WRONG:
            error = error_of(call, **{**right, name: wrong})
            if error is not None:
                raised = traceback.extract_tb(error.__traceback__)[-1].filename
                assert raised.startswith(ours + os.sep) or raised == "<string>", (name, wrong)
                assert str(error), (name, wrong)
                assert "\n" not in str(error), (name, wrong)


def error_of(call: Callable[..., Any], **given: Any) -> Exception | None:
    """Return what a call raises of the kinds that are for the user."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call(**given)
    except (TypeError, ValueError, OSError) as error:
        return error
    return None


def example(
    a: int, b: tuple[int, int], c: str | Path | None = None, d: Any = 0, **e: p4d.Optics
) -> int:
    return a


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"a": True, "b": (1, 2)}, "a must be a whole number, but is True"),
        ({"a": 1, "b": (1, 2, 3)}, "b must be 2 values, each a whole number, but is (1, 2, 3)"),
        ({"a": 1, "b": np.ones(3)}, "b must be 2 values, each a whole number, but is ndarray"),
        ({"a": 1, "b": (1, 2), "c": 3}, "c must be a text or a path or None, but is 3"),
    ],
)
def test_what_a_function_says_that_it_takes(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(TypeError) as caught:
        checked_call(example)(**given)
    assert str(caught.value).startswith(sentence)


class OneByOne:
    """What gives its parts one by one and can't tell how many they are."""

    def __init__(self, parts: Iterable[Any]) -> None:
        self.parts = parts

    def __iter__(self) -> Iterator[Any]:
        return iter(self.parts)


def test_what_is_right_goes_through() -> None:
    call = checked_call(example)
    for pair in ((1, 2), [1, 2], np.array([1, 2]), pd.Series([1, 2], index=[5, 6])):
        assert call(np.int64(3), pair, Path("x"), object()) == 3
    assert call(np.array(3), (1, 2)) == 3
    assert call.__name__ == "example"
    assert parts_of("Mapping[str, int | None] | None", "|") == ("Mapping[str, int | None]", "None")
    assert in_words("Sequence[str] | Optics", example) == "a list, each a text or an Optics"


#: What is of another kind -> how its refusal ends, which says where to get the right one.
ADVISED: dict[str, tuple[Callable[[], Any], str]] = {
    "noise": (lambda: simulation.with_noise(3), 'a Dataset, but is 3; give one with "phase", as'),
    "fault": (lambda: simulation.with_fault(3, "black frame"), 'is 3; give one with "phase", as'),
    "light": (lambda: simulation.at_wavelengths(3, [0.5]), 'is 3; give one with "phase", as step'),
    "video": (lambda: simulation.multiplexed_video(3), "is 3; give exact phase, as budding_yeast"),
    "optics": (lambda: simulation.multiplexed_video(EXACT, 3), "is 3; give Optics(wavelength_um="),
    "spectrum": (lambda: p4d.power_spectrum(3), "is 3; open_recording() makes one of a file or a"),
    "sinogram": (lambda: files.write_sinogram("a.h5", 3), "is 3; give what sinogram() returned"),
    "recipe": (lambda: p4d.run(3), "a Recipe, but is 3; give Recipe(...), or Recipe.from_file(pa"),
    "recording": (lambda: p4d.run(p4d.Recipe(), 3), "None, but is 3; open_recording() makes on"),
    "batch": (lambda: pipeline.run_batch(3, [], "out"), "is 3; give Recipe(...), or Recipe.from_"),
}  # fmt: skip


@pytest.mark.parametrize("case", ADVISED)
def test_a_refusal_says_where_to_get_the_right_one(case: str) -> None:
    call, sentence = ADVISED[case]
    with pytest.raises(TypeError, match=re.escape(sentence)):
        call()


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("resume", "True or False"), *((n, "a function") for n in ("told", "prepared", "finished"))],
)
def test_a_batch_refuses_what_is_no_switch_and_no_function(
    name: str, wanted: str, tmp_path: Path
) -> None:
    with pytest.raises(TypeError, match=f"{name} must be {wanted}.*, but is 3"):
        pipeline.run_batch(p4d.Recipe(), [], tmp_path, **{name: 3})  # type: ignore[arg-type]


#: A right call in its usual form, and others that say the same.
SAME: dict[str, tuple[Callable[[Any], Any], Any, list[Callable[[Any], Any]]]] = {
    "pictures": (plotting.phase_limits, [*EXACT.values[0]], [np.array, tuple]),
    "files": (
        lambda files: pipeline.result_folders(files, "out"),
        ["b/a.npy", "a.npy"],
        [iter, pd.Series, pd.Index, np.array, OneByOne],
    ),
    "wavelengths": (
        lambda light: simulation.at_wavelengths(DATA, light)["phase"].values.tolist(),
        [0.5, 0.6],
        [iter, pd.Series, np.array, xr.DataArray, OneByOne, lambda f: [*map(np.array, f)]],
    ),
    "noise": (
        lambda noise: simulation.with_noise(DATA, noise)["phase"].values.tolist(),
        0.3,
        [np.array, xr.DataArray, np.float64],
    ),
    "lobes": (
        lambda lobes: p4d.reconstruct(RECORDING, lobes, background="none").to_dict(),
        [LOBE],
        [iter, pd.Series, tuple, OneByOne],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SAME)
def test_what_says_the_same_gives_the_same(case: str) -> None:
    call, usual, others = SAME[case]
    expected = call(usual)
    for as_another in others:
        assert call(as_another(usual)) == expected


def test_a_movie_takes_what_gives_its_frames_one_by_one(tmp_path: Path) -> None:
    frames = [np.full((8, 8, 3), grey, np.uint8) for grey in (0, 90, 180)]
    usual = files.write_movie(tmp_path / "usual.gif", frames).read_bytes()
    for number, as_another in enumerate((iter, np.array, OneByOne)):
        path = files.write_movie(tmp_path / f"{number}.gif", as_another(frames))
        assert path.read_bytes() == usual


@pytest.mark.slow
def test_a_batch_takes_files_that_are_found_one_by_one(tmp_path: Path) -> None:
    for name in ("a.npy", "b.npy"):
        np.save(tmp_path / name, WRAPPED.values)
    recipe = p4d.Recipe(content="phase", methods=("spatial-2d",))
    table = pipeline.run_batch(recipe, tmp_path.glob("*.npy"), tmp_path / "out")
    assert table["status"].tolist() == ["done", "done"]
    again = pipeline.run_batch(recipe, table["file"], tmp_path / "out", resume=True)
    assert again["status"].tolist() == ["complete already"] * 2


@pytest.mark.parametrize("wrong", [np.ones(3), np.ones((2, 2)), ["a"], "a", pd.Series([1.0])])
def test_numbers_and_words_are_no_lobes(wrong: Any) -> None:
    with pytest.raises(TypeError, match="lobes must be a list, each a Lobe"):
        holography.lobe_warnings(wrong)


@pytest.mark.parametrize("wrong", ["a.npy", {"a.npy": 1}, pd.DataFrame({"a": ["b"]}), [3], 3])
def test_words_tables_and_numbers_are_no_files(wrong: Any) -> None:
    with pytest.raises(TypeError, match="files must be a list, each a text or a path"):
        pipeline.result_folders(wrong, "out")
