"""What is released: sdist, wheel, plugin, samples, command line, and types for a user's mypy.

``python3 dev.py matrix`` runs these on the wheel, in environments where nothing else is.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import command

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGE = "src/napari_phase4d"
pytestmark = pytest.mark.release

USER_RIGHT = """
from pathlib import Path

import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe

recording = p4d.open_recording(Path("a.tif"), p4d.Optics(magnification=60), frame_rate_hz=6)
lobes: list[Lobe] = p4d.find_lobes(recording, n_views=2, angles_deg=(-7, 21))
data: xr.Dataset = p4d.reconstruct(recording, lobes)
phase: xr.DataArray = p4d.unwrap(data["phase"], "temporal-angular", boundary=(0, 0))
rows: int = len(p4d.compare(data["phase"], ["spatial-2d"]).table)
"""
#: Each line of it is wrong.
USER_WRONG = """
import napari_phase4d as p4d
p4d.Optics(magnification="sixty")
p4d.open_recording("a.tif", frame_rate_hz="six")
p4d.find_lobes(p4d.open_recording("a.tif"), n_views="two")
p4d.find_lobes(p4d.open_recording("a.tif"))[0].angel_deg
p4d.unwarp
p4d.unwrap([[0.0]], boundary="first")
"""
SAMPLES = """
import numpy as np
from npe2 import PluginManager

manager = PluginManager.instance()
manager.discover()
for sample in manager.get_manifest("napari-phase4d").contributions.sample_data:
    layers = sample.open()
    print(sample.key, len(layers), {np.ndim(data) for data, *_ in layers},
          all(np.isfinite(np.asarray(data)).all() for data, *_ in layers))
"""


def told(*command: str | Path) -> str:
    """Run a command in an environment without our sources, and return what it prints."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def script(name: str) -> Path:
    """Return a command of the environment that runs the tests."""
    return Path(sys.executable).parent / (f"{name}.exe" if os.name == "nt" else name)


def files_below(folder: Path) -> set[str]:
    return {
        path.relative_to(ROOT).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build both, as `python -m build` does."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", folder],
                   cwd=ROOT, check=True, capture_output=True)  # fmt: skip
    return folder


def test_one_version_everywhere() -> None:
    version = PROJECT["version"]
    assert metadata.version("napari-phase4d") == version
    assert p4d.__version__ == version
    assert command("--version", cwd=ROOT).stdout == f"{version}\n"
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (\S+)$", citation, re.MULTILINE) == [version]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (\S+)", changes, re.MULTILINE)
    assert headings[headings[0] == "Unreleased"] == version
    assert "Unreleased" not in headings[1:]


@pytest.mark.slow
def test_wheel_is_the_package_and_nothing_else(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (about,) = {name.split("/")[0] for name in names if ".dist-info/" in name}
        entries = archive.read(f"{about}/entry_points.txt").decode()
        facts = archive.read(f"{about}/METADATA").decode()
    ours = {name.removeprefix("src/") for name in files_below(ROOT / PACKAGE)}
    assert {name for name in names if not name.startswith(about)} == ours
    assert {"napari_phase4d/py.typed", "napari_phase4d/napari.yaml"} <= ours
    assert f"{about}/licenses/LICENSE" in names
    assert "napari-phase4d = napari_phase4d:napari.yaml" in entries
    assert "napari-phase4d = napari_phase4d.cli:main" in entries
    assert "Classifier: Framework :: napari" in facts
    needed = re.findall(r"^Requires-Dist: ([\w-]+)[^;\n]*$", facts, re.MULTILINE)
    assert "numba" in needed
    assert not {"napari", "magicgui", "qtpy", "pyqt6", "pyside6"} & {n.lower() for n in needed}


@pytest.mark.slow
def test_sdist_builds_and_tests_itself_and_holds_nothing_else(dist: Path) -> None:
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        members = {m.name.split("/", 1)[1]: m for m in archive.getmembers() if not m.isdir()}
    for folder in (PACKAGE, "tests", "examples"):
        assert files_below(ROOT / folder) <= set(members)
    assert {name.split("/")[0] for name in members} == {
        "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "PKG-INFO", "README.md",
        "benchmarks", "dev.py", "docs", "examples", "napari.yaml", "pyproject.toml", "src",
        "tests", "tools", ".gitignore",
    }  # fmt: skip
    assert members["napari.yaml"].linkname.replace("\\", "/") == f"{PACKAGE}/napari.yaml"
    assert not [name for name in members if "_build" in name or name.endswith(".pyc")]


@pytest.mark.thorough
def test_manifest_is_valid_and_everything_in_it_can_be_imported() -> None:
    assert "valid" in told(sys.executable, "-m", "npe2", "validate", "--imports", "napari-phase4d")


@pytest.mark.thorough
@pytest.mark.slow
def test_samples_open_through_the_plugin_engine() -> None:
    found = [line.split() for line in told(sys.executable, "-c", SAMPLES).splitlines()]
    assert [(key, dimensions, finite) for key, _, dimensions, finite in found] == [
        ("euglena", "{4}", "True"),
        ("cells", "{4}", "True"),
        ("euglena_phase", "{4}", "True"),
        ("yeast", "{4}", "True"),
    ]


@pytest.mark.thorough
@pytest.mark.slow
def test_command_line_tells_and_runs(tmp_path: Path) -> None:
    program = script("napari-phase4d")
    exact = p4d.simulation.swimming_euglena((96, 128), 5, peak_rad=6)["phase"]
    video = tmp_path / "video.npy"
    np.save(video, p4d.simulation.multiplexed_video(exact).holograms.values)
    assert "reproduce" in told(program, "--help")
    known = told(program, "info", video)
    assert "5 frames of 96 x 128 pixels" in known
    assert "0.2" in known  # of the lobes
    told(program, "run", video, "--method", "spatial-2d", "--out", tmp_path / "out")
    assert (tmp_path / "out" / "recipe.json").exists()
    found = p4d.read_results(tmp_path / "out" / "spatial-2d.ome.tif")
    assert dict(found.sizes)["time"] == 5


@pytest.mark.thorough
@pytest.mark.slow
def test_a_users_mypy_sees_the_types(tmp_path: Path) -> None:
    right, wrong = tmp_path / "right.py", tmp_path / "wrong.py"
    right.write_text(USER_RIGHT, encoding="utf-8")
    wrong.write_text(USER_WRONG, encoding="utf-8")
    line = [sys.executable, "-m", "mypy", "--strict", "--config-file", os.devnull,
            "--cache-dir", tmp_path / "cache", right, wrong]  # fmt: skip
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
    errors = re.findall(r"^(\S+?):(\d+): error: .*\[(\S+)\]$", done.stdout, re.MULTILINE)
    assert errors == [
        ("wrong.py", "3", "arg-type"),
        ("wrong.py", "4", "arg-type"),
        ("wrong.py", "5", "arg-type"),
        ("wrong.py", "6", "attr-defined"),
        ("wrong.py", "7", "attr-defined"),
        ("wrong.py", "8", "arg-type"),
    ], done.stdout


def test_one_line_sets_the_address(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "README.md", "LICENSE", "tools/metadata.py", "napari.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / PACKAGE).mkdir(parents=True)
    (tmp_path / PACKAGE / "__init__.py").write_text("")
    project = tmp_path / "pyproject.toml"
    text = project.read_text(encoding="utf-8")
    assert text.count('\naddress = ""\n') == 1
    address = "https://example.org/napari-phase4d"
    project.write_text(text.replace('\naddress = ""\n', f'\naddress = "{address}"\n'), "utf-8")
    line = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path]
    subprocess.run(line, cwd=tmp_path, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith("METADATA"))
        facts = archive.read(name).decode()
    assert f"Project-URL: Issues, {address}/issues" in facts
    links = re.findall(r"\]\(([^)]+)\)", facts)
    assert len(links) > 5
    assert all(link.startswith(("https://", "#")) for link in links)
    assert f"{address}/blob/main/docs/explanation/limits.md" in links
