"""Results of this program that describe themselves as they are not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import xarray as xr

from faulty import LONGEST
from napari_phase4d.io import read_results, write_phase


def result(path: Path) -> Path:
    values = np.ones((2, 1, 4, 5), np.float32)
    coords = {d: np.arange(n) * 1.0 for d, n in zip(("time", "angle", "y", "x"), values.shape)}  # noqa: B905
    return write_phase(path, xr.DataArray(values, dims=tuple(coords), coords=coords))


TOLD = {
    "huge coordinates": {
        "coords": {"time": [1e308, -1e308], "angle": [0], "y": [0] * 4, "x": [0] * 5}
    },
    "too few": {"coords": {"time": [0], "angle": [0], "y": [0], "x": [0]}},
    "too many": {"coords": {"time": [0] * 10**5, "angle": [0], "y": [0], "x": [0]}},
    "other axes": {"coords": {"q": [0] * 40}},
    "no numbers": {"coords": {"time": ["a", {}], "angle": [0], "y": [0] * 4, "x": [0] * 5}},
    "whole numbers without end": {
        "coords": {"time": [10**400, 0], "angle": [0], "y": [0] * 4, "x": [0] * 5}
    },
    "coords no mapping": {"coords": [1, 2]},
    "attrs no mapping": {"attrs": "x"},
    "name no word": {"name": ["a"]},
    "units no mapping": {"units": 3},
    "no coords": {"coords": None},
    "unit no word": {"units": {"x": {"deep": []}}},
}  # fmt: skip


@pytest.mark.parametrize("case", TOLD)
@pytest.mark.parametrize("ending", ["ome.tif", "ome.zarr"])
def test_results_that_describe_themselves_wrongly(tmp_path: Path, ending: str, case: str) -> None:
    """Either it is refused, or nothing but the number that was wrong is another one."""
    path = result(tmp_path / f"result.{ending}")
    describe_otherwise(path, TOLD[case])
    sentence = ""
    try:
        found = read_results(path).load()
    except OSError as error:
        sentence = str(error)
    if sentence:
        assert "\n" not in sentence
        assert path.name in sentence
        assert len(sentence) < LONGEST
    else:
        assert case in ("huge coordinates", "unit no word")
        assert found.shape == (2, 1, 4, 5)
        assert (found.values == 1).all()


def describe_otherwise(path: Path, changes: dict[str, object]) -> None:
    """Change what a result notes of itself."""
    if path.is_dir():
        place = path / "zarr.json"
        told = json.loads(place.read_text())
        note = told["attributes"]["napari-phase4d"]
        note.update(changes)
        place.write_text(json.dumps(told))
        return
    with tifffile.TiffFile(path) as tif:
        xml = tif.ome_metadata
        assert xml is not None
        image = tifffile.xml2dict(xml)["OME"]["Image"]
    before = json.loads(image["Description"])
    start = xml.index("<Description>") + len("<Description>")
    end = xml.index("</Description>")
    text = json.dumps({**before, **changes}).replace("&", "&amp;").replace("<", "&lt;")
    tifffile.tiffcomment(path, (xml[:start] + text + xml[end:]).encode())
