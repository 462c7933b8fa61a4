"""What is noted with the results of a file, and whether they are still all there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.io import PROGRAM
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.pipeline.fingerprint import Fingerprint, Hashing, fingerprint
from napari_phase4d.pipeline.provenance import asked_recipe, program_version
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.progress import CancelledCall

__all__ = ["NOTE", "asked_for", "complete", "digest_of", "noted", "write_note"]

#: Name of the file that says what a folder holds.
NOTE = "run.json"
#: Facts of a run that the summary shows.
Facts = dict[str, Any]


def asked_for(
    recipe: Recipe,
    form: str | None,
    truth: str | None = None,
    reference: Fingerprint | None = None,
) -> dict[str, Any]:
    """Return all that results depend on but the input: recipe, form, exact phase and version.

    ``truth`` is the digest of the exact phase, ``reference`` the fingerprint of the file that the
    recipe divides by.
    """
    return {
        "version": program_version(),
        "recipe": asked_recipe(recipe, reference),
        "form": form,
        "truth": truth,
    }


def digest_of(truth: xr.DataArray) -> str:
    """Return the SHA-256 of an array's numbers."""
    return hashlib.sha256(np.ascontiguousarray(truth.values).tobytes()).hexdigest()


def write_note(
    folder: Path,
    asked: Mapping[str, Any],
    source: Mapping[str, Any],
    facts: Facts,
    cancelled: CancelledCall | None = None,
) -> None:
    """Note in a folder what was asked for, of which input, and each file that it holds."""
    files = [fingerprint(path, cancelled).as_dict() for path in sorted(folder.iterdir())]
    note = {"program": PROGRAM, "input": source, "asked": asked, "facts": facts, "files": files}
    with written_whole(folder / NOTE) as temporary:
        temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")


def noted(folder: Path) -> dict[str, Any] | None:
    """Return what `write_note` noted in a folder, None if it did not or it is damaged."""
    try:
        note = json.loads((folder / NOTE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(note, dict) or note.get("program") != PROGRAM:
        return None
    kinds = {"input": dict, "asked": dict, "facts": dict, "files": list}
    if not all(isinstance(note.get(name), kind) for name, kind in kinds.items()):
        return None
    return note if all(is_file_note(file) for file in note["files"]) else None


def is_file_note(file: Any) -> bool:
    """Say whether this notes a file of the folder itself."""
    return (
        isinstance(file, dict)
        and isinstance(file.get("name"), str)
        and file["name"] not in ("", ".", "..")
        and Path(file["name"]).name == file["name"]
    )


def complete(
    folder: Path,
    asked: Mapping[str, Any],
    source: Hashing,
    cancelled: CancelledCall | None = None,
) -> dict[str, Any] | None:
    """Return what is noted in a folder if it holds just what is asked for, undamaged, else None.

    What is quick to find out comes first: the recipe, the sizes, and only then what the input and
    the results hold.
    """
    note = noted(folder)
    if note is None or note["asked"] != json.loads(json.dumps(asked)):
        return None
    if note["input"].get("bytes", 0) != source.bytes:
        return None
    if not all(undamaged(folder, file, cancelled, look_inside=False) for file in note["files"]):
        return None
    if note["input"] != source.result(cancelled).as_dict():
        return None
    whole = all(undamaged(folder, file, cancelled, look_inside=True) for file in note["files"])
    return note if whole else None


def undamaged(
    folder: Path,
    file: Mapping[str, Any],
    cancelled: CancelledCall | None,
    *,
    look_inside: bool,
) -> bool:
    """Say whether a result is there with the size, or also the content, that is noted."""
    path = folder / file["name"]
    try:
        if look_inside:
            return fingerprint(path, cancelled).as_dict() == file
        # Of a folder, only that it is there: to list it is most of the work of reading it.
        return path.is_dir() or bool(path.stat().st_size == file.get("bytes"))
    except OSError:
        return False
