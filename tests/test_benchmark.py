"""The suite stays what it is, and its scores are what they say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import napari_phase4d as p4d
from napari_phase4d.benchmark import GROUPS, SUITE_VERSION, cases, run_benchmark, write_benchmark
from napari_phase4d.benchmark.scoring import scores_of, summary_of
from napari_phase4d.unwrapping import METHODS, Method
from test_commands import refused, told

#: Group -> how many recordings, pixels, pixels of objects, and the mean of the exact phase with
#: its noise, of suite 1.
SUITE_1 = {
    "moving cells": (10, 3416064, 475656, 1.08008),
    "hard shapes": (19, 6225920, 1613818, 1.19986),
    "much noise": (10, 3276800, 780830, 1.09668),
    "faults": (14, 4423680, 716489, 1.34510),
    "time lapse": (6, 393216, 69664, 1.47941),
    "one view": (4, 327680, 69512, 1.01597),
    "through the optics": (3, 345600, 34909, 0.42785),
}


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return run_benchmark(["spatial-2d", "directional-l1"], ["one view"])


@pytest.mark.thorough
@pytest.mark.parametrize("group", GROUPS)
def test_the_suite_is_the_same_everywhere(group: str) -> None:
    assert SUITE_VERSION == 1
    found = list(cases([group]))
    assert [case.name for case in found] == list(GROUPS[group])
    pixels = sum(case.voxels for case in found)
    objects = sum(int((~case.empty).sum()) for case in found)
    mean = float(np.mean([np.nanmean(case.truth.values) for case in found]))
    assert (len(found), pixels) == SUITE_1[group][:2]
    # Pixels on the rim of an object may be rounded differently on other machines.
    assert objects == pytest.approx(SUITE_1[group][2], rel=1e-4)
    assert mean == pytest.approx(SUITE_1[group][3], abs=2e-4)


@pytest.mark.slow
def test_truth_is_what_an_unwrapper_that_is_right_returns() -> None:
    for case in cases(["one view", "time lapse", "through the optics"]):
        turned = np.angle(np.exp(1j * (case.wrapped.values - case.truth.values)))
        assert np.abs(turned).max() < 1e-5
        assert abs(float(np.median(case.truth.values[case.empty]))) < 0.1


@pytest.mark.slow
def test_scores_by_hand() -> None:
    case = next(cases(["one view"]))
    found = p4d.compare(case.wrapped, ["spatial-2d"], case.boundary)
    exact = case.truth.copy()
    # All frames a turn up: nothing tells that from none.
    found.results["spatial-2d"] = exact + np.float32(2 * np.pi)
    scores = scores_of(found, "spatial-2d", case)
    assert scores["wrong_cycles_percent"] == 0
    assert scores["mse_rad2"] == pytest.approx(0, abs=1e-9)
    # Every pixel of the object of the first frame is a turn up, relative to its field.
    inside = ~case.empty
    off = np.zeros(exact.shape, np.float32)
    off[0] = inside[0] * 2 * np.pi
    found.results["spatial-2d"] = exact + off
    scores = scores_of(found, "spatial-2d", case)
    share = inside[0].sum() / inside.sum()
    assert scores["wrong_cycles_percent"] == pytest.approx(100 * share)
    assert scores["mse_rad2"] == pytest.approx(
        4 * np.pi**2 * inside[0].sum() / inside.size, rel=1e-5
    )
    # What is left out is wrong.
    found.results["spatial-2d"] = exact.where(exact["time"] > exact["time"][0])
    scores = scores_of(found, "spatial-2d", case)
    assert scores["wrong_cycles_percent"] == pytest.approx(100 * share)


@pytest.mark.slow
def test_what_has_no_truth_does_not_count() -> None:
    case = next(cases(["one view"]))
    unknown = replace(case, truth=case.truth.where(case.truth["time"] > case.truth["time"][0]))
    found = p4d.compare(case.wrapped, ["spatial-2d"], case.boundary)
    found.results["spatial-2d"] = case.truth.copy()
    found.results["spatial-2d"].values[0] = 100
    assert scores_of(found, "spatial-2d", unknown)["mse_rad2"] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_the_own_method_leads(table: pd.DataFrame) -> None:
    assert set(table["case"]) == set(GROUPS["one view"])
    assert (table["fault"] == "").all()
    summary = summary_of(table)
    assert list(summary.index) == ["directional-l1", "spatial-2d"]
    by_hand = table[table["id"] == "spatial-2d"]["wrong_cycles_percent"].mean()
    assert summary["all"]["spatial-2d"] == pytest.approx(by_hand)


@pytest.mark.slow
def test_a_method_that_fails_is_named_and_the_others_are_scored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(*_: object, **__: object) -> None:
        msg = "no licence found"
        raise RuntimeError(msg)

    monkeypatch.setitem(METHODS._own, "broken", Method("Broken", "nowhere", "Fails.", broken))
    found = run_benchmark(["broken", "spatial-2d"], ["one view"]).set_index("id")
    assert found.loc["broken", "fault"].str.contains("no licence found").all()
    assert (found.loc["spatial-2d", "fault"] == "").all()
    assert summary_of(found.reset_index()).loc["broken", "without_result"] == len(
        GROUPS["one view"]
    )


@pytest.mark.slow
def test_failing_where_it_is_hard_does_not_pay(table: pd.DataFrame) -> None:
    crashed = table[table["id"] == "directional-l1"].assign(id="crashes", method="Crashes")
    crashed.loc[crashed["case"] == "dividing", ["wrong_cycles_percent", "mse_rad2"]] = np.nan
    summary = summary_of(pd.concat([table, crashed]))
    assert summary["all"]["crashes"] >= 25
    assert np.isnan(summary["mse_rad2"]["crashes"])


def test_nothing_to_score_is_said() -> None:
    for wrong in (([], None), (None, [])):
        with pytest.raises(ValueError, match="no method or group to score"):
            run_benchmark(*wrong)
    # All that this one gets is said as well.
    found = run_benchmark(["synthetic-wavelength"], ["one view"])
    assert summary_of(found)["without_result"]["synthetic-wavelength"] == 4


@pytest.mark.slow
def test_the_page_says_it_all(table: pd.DataFrame, tmp_path: Path) -> None:
    written = write_benchmark(table, tmp_path)
    assert [path.name for path in written] == [
        "benchmark.csv", "summary.csv", "benchmark.png", "benchmark.html",
    ]  # fmt: skip
    rows = pd.read_csv(written[0])
    np.testing.assert_allclose(rows["wrong_cycles_percent"], table["wrong_cycles_percent"])
    page = written[3].read_text(encoding="utf-8")
    for words in ("suite 1", "4 recordings", "WL1", "How to cite", p4d.__version__):
        assert words in page
    write_benchmark(table, tmp_path)  # its own files are replaced
    with pytest.raises(OSError, match="can't be made or written to"):
        write_benchmark(table, tmp_path / "benchmark.csv")
    (tmp_path / "benchmark.csv").write_text("mine")
    with pytest.raises(OSError, match="was not made by a benchmark"):
        write_benchmark(table, tmp_path)
    assert (tmp_path / "benchmark.csv").read_text() == "mine"


@pytest.mark.thorough
def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("benchmark", "--method", "spatial-2d", "--group", "one view", "--out")
    printed = told(*words, tmp_path / "out")
    assert "2-D" in printed
    assert "4 files written" in printed
    for wrong in (("--method", "mine"), ("--group", "mine")):
        said = refused(monkeypatch, capsys, "benchmark", *wrong, "--out", tmp_path / "none")
        assert "must be one of" in said
    assert not (tmp_path / "none").exists()


def test_benchmarks_stop_when_told_to() -> None:
    with pytest.raises(p4d.Cancelled):
        run_benchmark(["spatial-2d"], ["one view"], cancelled=lambda: True)


@pytest.mark.parametrize("failed", [1, 3, 4])
def test_the_time_a_pixel_is_that_of_what_was_done(failed: int) -> None:
    rows = [
        {
            "suite": 1, "group": "g", "case": str(i), "id": "m", "method": "M", "voxels": 100,
            "fault": "oops" if i < failed else "", "wrong_cycles_percent": 1.0, "mse_rad2": 1.0,
            "confidence_auc": 0.9, "seconds": np.nan if i < failed else 1.0, "peak_mb": 1.0,
        }
        for i in range(4)
    ]  # fmt: skip
    found = summary_of(pd.DataFrame(rows))["ns_a_voxel"]["m"]
    assert found == pytest.approx(np.nan if failed == 4 else 1e7, nan_ok=True)
