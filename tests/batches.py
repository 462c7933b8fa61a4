"""What the tests of batches share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import napari_phase4d as p4d
from napari_phase4d.pipeline import run_batch

RECIPE = p4d.Recipe(methods=("spatial-2d", "temporal-angular"), mask=None)
#: What differs from run to run: how long it took.
OF_THE_RUN = {"table.csv", "run.json", "recipe.json"}


def write_phases(folder: Path) -> Path:
    """Write three small files of wrapped phase, and one that is none."""
    for i, name in enumerate("abc"):
        data = p4d.simulation.budding_yeast((16, 16), n_times=3, angles_deg=(0.0, 5.0 + i))
        np.save(folder / f"{name}.npy", data["wrapped"].values)
    (folder / "bad.npy").write_bytes((folder / "a.npy").read_bytes()[:300])
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all results, but for what notes how long it took."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files if p.name not in OF_THE_RUN}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def batch(out: Path, *files: Path, **options: Any) -> tuple[pd.DataFrame, list[str]]:
    said: list[str] = []
    table = run_batch(RECIPE, files, out, told=said.append, **options)
    assert (out / "batch.log").read_text().splitlines()[-len(said) :] == said
    pd.testing.assert_frame_equal(
        pd.read_csv(out / "summary.csv", index_col="number"), table, check_dtype=False
    )
    return table, said


def statuses(out: Path, *files: Path, recipe: p4d.Recipe = RECIPE, **options: Any) -> list[str]:
    return list(run_batch(recipe, files, out, resume=True, **options)["status"])
