"""The page on adding an unwrapper: what it says is run."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "own_unwrapper.md"


def blocks(language: str) -> list[str]:
    found = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return found


@pytest.mark.thorough
def test_the_page_holds_from_top_to_bottom(tmp_path: Path) -> None:
    package, look, whole_stack, compare = blocks("python")
    (tmp_path / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n'
        + blocks("toml")[0]
        + '\n[tool.hatch.build.targets.wheel]\ninclude = ["phase4d_itoh.py"]\n'
    )
    (tmp_path / "phase4d_itoh.py").write_text(package)
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(site), str(tmp_path)], check=True)
    own = whole_stack + (
        "problem = p4d.unwrapping.Problem(sample['wrapped'])\n"
        "assert along_time(problem, None, None).shape == exact.shape\n"
        "assert found.table.loc['itoh', 'mse_rad2'] >= 0\n"
        "flipped = p4d.unwrap(sample['wrapped'], 'itoh', columns_first=True)\n"
        "assert (abs(flipped - found.results['itoh']) > 1).any()\n"
    )
    script = f"import sys\nsys.path.insert(0, {str(site)!r})\nimport numpy as np\n"
    done = subprocess.run(
        [sys.executable, "-c", script + look + compare + own], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Along each row, then along each column.\n")
    assert "Itoh" in done.stdout
