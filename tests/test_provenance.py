"""What results note of how they were made, so that they can be made again."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.io import read_results
from napari_phase4d.pipeline import Outcome, fingerprint, fingerprinting, write_outcome
from napari_phase4d.task import Cancelled
from stacks import assert_equal, contents


@pytest.fixture(scope="module")
def video_file(tmp_path_factory: pytest.TempPathFactory, small_video: Any) -> Path:
    path = tmp_path_factory.mktemp("secret-place") / "video.npy"
    np.save(path, small_video.holograms.values)
    return path


RECIPE = p4d.Recipe(methods=("spatial-2d", "temporal"), boundary=((1, 0),), mask=None)


@pytest.fixture(scope="module")
def outcome(video_file: Path) -> Outcome:
    return p4d.run(RECIPE.changed(recording=str(video_file)))


@pytest.mark.slow
@pytest.mark.parametrize("form", ["tiff", "zarr"])
def test_every_result_notes_what_made_it(
    tmp_path: Path, outcome: Outcome, video_file: Path, form: str
) -> None:
    written = write_outcome(outcome, tmp_path, form=form)
    ending = {"tiff": ".ome.tif", "zarr": ".ome.zarr"}[form]
    names = {"wrapped", "amplitude", "spatial-2d", "temporal"}
    assert {p.name for p in written} == {
        *(f"{name}{ending}" for name in names), "table.csv", "recipe.json",
    }  # fmt: skip
    for name in names:
        found = read_results(tmp_path / f"{name}{ending}").attrs["provenance"]
        assert found["program"] == "napari-phase4d"
        assert set(found["versions"]) == {"python", "numpy", "scipy", "scikit-image", "numba"}
        assert found["versions"]["numpy"] == np.__version__
        assert found["boundary"] == [[1, 0]]
        content = video_file.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        assert found["input"] == {"name": "video.npy", "bytes": len(content), "sha256": digest}
        # The recipe in it gives the same settings again, lobes and microscope included.
        again = p4d.Recipe().changed(**found["recipe"])
        assert again == outcome.recipe.changed(recording="video.npy")
        assert len(again.lobes) == 2


@pytest.mark.slow
def test_the_same_run_elsewhere_gives_the_same_bytes(
    tmp_path: Path, outcome: Outcome, video_file: Path
) -> None:
    elsewhere = tmp_path / "other place" / "video.npy"
    elsewhere.parent.mkdir()
    shutil.copy(video_file, elsewhere)
    again = p4d.run(RECIPE.changed(recording=str(elsewhere)))
    for form in ("tiff", "zarr"):
        write_outcome(outcome, tmp_path / "one", form=form)
        write_outcome(again, tmp_path / "two", form=form)
    # Times and memory differ, and the recipe to be run again names the file.
    for file in ("table.csv", "recipe.json", "run.json"):
        for folder in ("one", "two"):
            (tmp_path / folder / file).unlink()
    found = contents(tmp_path / "one")
    assert len(found) > 10
    assert contents(tmp_path / "two") == found
    for place in (b"secret-place", b"other place", str(tmp_path).encode()):
        assert not [name for name, data in found.items() if place in data]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["tiff", "zarr"])
def test_results_are_inputs_again(tmp_path: Path, outcome: Outcome, form: str) -> None:
    (wrapped, *_) = write_outcome(outcome, tmp_path / "first", form=form)
    again = p4d.run(RECIPE.changed(recording=str(wrapped)))
    np.testing.assert_array_equal(
        again.comparison.results["temporal"], outcome.comparison.results["temporal"]
    )
    (unwrapped,) = (p for p in write_outcome(again, tmp_path / "second") if "temporal" in p.name)
    attrs = read_results(unwrapped).attrs
    assert attrs["provenance"]["input"] == fingerprint(wrapped).as_dict()
    assert attrs["source"] == wrapped.name
    with pytest.raises(ValueError, match="is unwrapped already, by temporal"):
        p4d.run(
            RECIPE.changed(
                recording=str(tmp_path / "first" / wrapped.name.replace("wrapped", "temporal"))
            )
        )


@pytest.mark.slow
def test_a_reference_file_is_noted_too(tmp_path: Path, outcome: Outcome, video_file: Path) -> None:
    np.save(tmp_path / "empty.npy", np.load(video_file)[:1])
    recipe = outcome.recipe.changed(reference=str(tmp_path / "empty.npy"))
    write_outcome(replace(outcome, recipe=recipe), tmp_path / "out")
    found = read_results(tmp_path / "out" / "temporal.ome.tif").attrs["provenance"]
    digest = hashlib.sha256((tmp_path / "empty.npy").read_bytes()).hexdigest()
    assert found["reference"]["sha256"] == digest
    assert found["recipe"]["reference"] == "empty.npy"


def test_input_that_is_gone_loses_no_results(tmp_path: Path, outcome: Outcome) -> None:
    recording = replace(outcome.recording, source=str(tmp_path / "gone.tif"))
    write_outcome(replace(outcome, recording=recording), tmp_path / "out")
    found = read_results(tmp_path / "out" / "temporal.ome.tif").attrs["provenance"]
    assert found["input"] == {"name": "gone.tif"}


def test_what_stops_confidence_loses_no_results(tmp_path: Path, outcome: Outcome) -> None:
    trusting = replace(outcome, recipe=outcome.recipe.changed(confidence=True))
    with pytest.raises(Cancelled):
        # The recipe is the last that is written before pixels are judged.
        write_outcome(trusting, tmp_path, cancelled=(tmp_path / "recipe.json").exists)
    assert {"temporal.ome.tif", "table.csv", "recipe.json"} <= {p.name for p in tmp_path.iterdir()}
    assert not list(tmp_path.glob("confidence*"))


def test_lazy_results_are_written_as_zarr(tmp_path: Path, outcome: Outcome) -> None:
    lazy = replace(outcome, reconstruction=outcome.reconstruction.chunk(time=2))
    assert [p.suffix for p in write_outcome(lazy, tmp_path)][:4] == [".zarr"] * 4
    assert_equal(
        read_results(tmp_path / "temporal.ome.zarr").drop_attrs(),
        outcome.comparison.results["temporal"].drop_attrs(),
    )
    with pytest.raises(ValueError, match="form must be tiff or zarr, but is 'png'"):
        write_outcome(lazy, tmp_path, form="png")


def test_fingerprints_tell_files_and_folders_apart(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    for folder in (one, two):
        (folder / "deep").mkdir(parents=True)
        (folder / "a.tif").write_bytes(b"12")
        (folder / "deep" / "b.tif").write_bytes(b"3" * 3_000_000)
    (two / "Thumbs.db").write_bytes(b"?")  # what systems leave in folders is none of ours
    assert fingerprint(one / "a.tif").sha256 == hashlib.sha256(b"12").hexdigest()
    assert fingerprint(one).sha256 == fingerprint(two).sha256
    assert fingerprint(one).bytes == 3_000_002
    (two / "a.tif").rename(two / "c.tif")  # another name
    assert fingerprint(one).sha256 != fingerprint(two).sha256
    (two / "c.tif").rename(two / "a.tif")
    (two / "a.tif").write_bytes(b"13")  # another content
    assert fingerprint(one).sha256 != fingerprint(two).sha256
    assert fingerprint(str(tmp_path / "*" / "a.tif").replace("*", "one")).bytes == 2
    assert fingerprint(str(one / "*.tif")).bytes == 2
    assert fingerprint("sample:yeast").as_dict() == {"name": "sample:yeast"}
    with pytest.raises(OSError, match="there is no file or folder"):
        fingerprint(tmp_path / "missing.tif")


def test_input_that_changes_meanwhile_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "video.tif"
    path.write_bytes(b"frames")
    with fingerprinting(path) as hashing:
        assert hashing.result().bytes == 6
        path.write_bytes(b"frames and more")
        with pytest.raises(OSError, match=r"^video\.tif was changed while it was read; "):
            hashing.result()
        path.unlink()
        with pytest.raises(OSError, match="there is no file or folder"):
            hashing.result()
