"""Files made to harm: what they say is absurd, or would run code, or leads elsewhere.

Each is refused in one sentence, with little memory, and nothing in it is executed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tracemalloc
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import napari_phase4d as p4d
from faulty import FRAMES, LONGEST, opened, outcome_of
from hostile import FILES, Runs, circular_tiff
from napari_phase4d.io import open_input

#: Memory that refusing a file may take; the smallest of the bombs holds three times as much.
MOST_BYTES = 150 * 2**20
#: Time in which all of them must have been refused.
MOST_SECONDS = 60


@pytest.fixture(autouse=True)
def murmurs() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


#: Would end this process, or fill all memory, if they were not refused: see the last test.
DANGEROUS = ("itself.h5", "many.h5", "sizes.ome.tif")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in FILES if name not in DANGEROUS])
def test_absurd_files_are_refused_with_little_memory(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    FILES[name](path)
    outcome_of(tmp_path / f"nothing{path.suffix}")  # what has to be imported is no memory of it
    tracemalloc.start()
    try:
        outcome = outcome_of(path)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # What a description tells in vain does no harm where the frames themselves are sound.
    assert outcome == "sentence" or (name in ("frames.tif", "xml.ome.tif") and outcome == "fine")
    assert most < MOST_BYTES, f"{most / 2**20:.0f} MB"


def test_pages_that_go_round_in_a_circle_end(tmp_path: Path) -> None:
    path = tmp_path / "circle.tif"
    circular_tiff(path)
    outcome = outcome_of(path)
    assert outcome in ("fine", "sentence")
    assert outcome == "sentence" or opened(path).n_frames == len(FRAMES)


def array_of(item: object) -> np.ndarray:
    array = np.empty((1, 8, 8), dtype=object)
    array[:] = item
    return array


@pytest.mark.parametrize("name", ["pickle.npy", "pickle.npz", "bare.npy", "bare.npz", "bare.tif"])
def test_nothing_is_unpickled(tmp_path: Path, name: str) -> None:
    """The pickle would make a folder."""
    trace, path = tmp_path / "executed", tmp_path / name
    if name == "pickle.npy":
        np.save(path, array_of(Runs(trace)), allow_pickle=True)
    elif name == "pickle.npz":
        np.savez(path, holograms=array_of(Runs(trace)))
    else:
        path.write_bytes(pickle.dumps(Runs(trace)))
    for read in (p4d.open_recording, open_input, p4d.read_results):
        with pytest.raises(OSError, match=name):
            read(path)
    with pytest.raises(ValueError, match=name):
        p4d.Recipe.from_file(path)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Runs(trace)))  # so that the test could have failed
    assert trace.exists()


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A recording that a file may point to; it belongs to somebody else."""
    import h5py

    folder = tmp_path / "elsewhere"
    folder.mkdir()
    with h5py.File(folder / "secret.h5", "w") as file:
        file["holograms"] = FRAMES
    return folder / "secret.h5"


@pytest.mark.parametrize("way", ["external link", "virtual dataset", "external storage"])
def test_hdf5_that_points_to_other_files(tmp_path: Path, secret: Path, way: str) -> None:
    import h5py

    path = tmp_path / "own" / "points.h5"
    path.parent.mkdir()
    with h5py.File(path, "w") as file:
        if way == "external link":
            file["holograms"] = h5py.ExternalLink(str(secret), "holograms")
        elif way == "virtual dataset":
            layout = h5py.VirtualLayout(FRAMES.shape, "u1")
            layout[:] = h5py.VirtualSource(str(secret), "holograms", FRAMES.shape)
            file.create_virtual_dataset("holograms", layout)
        else:
            where = [(str(secret), 0, FRAMES.nbytes)]
            file.create_dataset("holograms", FRAMES.shape, "u1", external=where)
    assert outcome_of(path) == "sentence"


def test_hdf5_that_joins_files_beside_it(tmp_path: Path, secret: Path) -> None:
    """As detectors write them: one file that shows what lies in its own folder and below."""
    import h5py

    path = tmp_path / "joined.h5"
    layout = h5py.VirtualLayout(FRAMES.shape, "u1")
    layout[:] = h5py.VirtualSource("elsewhere/secret.h5", "holograms", FRAMES.shape)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("holograms", layout)
    np.testing.assert_array_equal(p4d.open_recording(path).frame(3), FRAMES[3])


def test_zip_member_names_lead_nowhere(tmp_path: Path) -> None:
    """Nothing is unpacked to disk, whatever the members are called."""
    path = tmp_path / "names.npz"
    np.savez(path, **{"../../escaped": FRAMES, "holograms": FRAMES})
    assert p4d.open_recording(path).n_frames == len(FRAMES)
    assert p4d.open_recording(path, dataset="../../escaped").n_frames == len(FRAMES)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["names.npz"]


DEEP = 3000
RECIPES = {
    "many lists": "[" * 100_000,
    "many dicts": '{"options": ' + '{"a": ' * DEEP + "1" + "}" * (DEEP + 1),
    "long number": '{"frame_rate_hz": ' + "9" * 5000 + "}",
    "infinite": '{"frame_rate_hz": Infinity}',
    "too large": '{"frame_rate_hz": 1e999}',
    "no number": '{"angles_deg": [NaN]}',
    "no option": '{"options": {"dilate-erode": {"erode_threshold": NaN}}}',
    "no optics": '{"optics": {"wavelength_um": NaN}}',
    "no pixel": '{"optics": {"camera_pixel_um": 1e308, "magnification": 1e-308}}',
    "half a letter": '{"recording": "\\ud800"}',
    "many views": '{"n_views": 100000}',
    "method": '{"methods": ["os.system"]}',
    "python": '{"recording": {"__reduce__": ["os.system", "true"]}}',
    "not text": "\x00\x01\x02",
}


@pytest.mark.parametrize("case", RECIPES)
def test_hostile_recipes_are_refused_in_one_sentence(tmp_path: Path, case: str) -> None:
    path = tmp_path / "recipe.json"
    path.write_text(RECIPES[case], encoding="utf-8")
    with pytest.raises(ValueError, match=r"recipe\.json is no") as caught:
        p4d.Recipe.from_file(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < LONGEST


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["/etc/passwd", "../../../../etc/passwd", "/dev/zero", "/dev/null", "/proc/self/mem"]
)
@pytest.mark.parametrize("field", ["recording", "reference"])
def test_what_a_recipe_names_is_only_ever_read_as_a_recording(
    small_video: p4d.Recording, name: str, field: str
) -> None:
    """It is refused by its kind; not a byte of it is in the sentence."""
    recipe = p4d.Recipe(**{field: name}, methods=("spatial-2d",))
    with pytest.raises((OSError, ValueError)) as caught:
        p4d.run(recipe, None if field == "recording" else small_video)
    said = str(caught.value)
    assert "\n" not in said
    assert "root:" not in said
    assert Path(name).name in said


BOUNDED = """
import resource, sys, warnings
warnings.simplefilter("ignore")
from pathlib import Path
from faulty import outcome_of, sound
from hostile import FILES
folder = Path(sys.argv[1])
for number, name in enumerate(("TIFF, compressed", "PNG", "NPZ", "HDF5", "Zarr 3")):
    place = folder / f"sound{number}"
    place.mkdir()
    outcome_of(sound(name, place))  # libraries take room of their own
paths = []
for name, write in FILES.items():
    paths.append(folder / name)
    write(paths[-1])
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**29, used + 2**29))
for path in paths:
    print(path.name, outcome_of(path), sep=": ", flush=True)
"""


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc and limits of Linux")
def test_bombs_where_memory_is_bounded(tmp_path: Path) -> None:
    """With 512 MB more than the libraries have: native memory counts here as well."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    line = [sys.executable, "-c", BOUNDED, str(tmp_path)]
    try:
        done = subprocess.run(
            line, capture_output=True, text=True, check=False, env=env, timeout=MOST_SECONDS
        )
    except subprocess.TimeoutExpired as error:
        pytest.fail(f"still at work after {str(error.stdout)[-300:]}")
    said = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert list(said) == list(FILES), f"ended with {done.returncode} after {said}"
    assert set(said.values()) <= {"sentence", "fine"}, said
    assert all(said[name] == "sentence" for name in DANGEROUS)
