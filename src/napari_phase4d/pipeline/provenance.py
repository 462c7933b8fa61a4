"""Where a result comes from: what it takes to make it again."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import xarray as xr

from napari_phase4d.io import PROGRAM
from napari_phase4d.pipeline.fingerprint import Fingerprint, fingerprint
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.pipeline.starting import FOUND_BY
from napari_phase4d.progress import CancelledCall
from napari_phase4d.sample import is_sample
from napari_phase4d.unwrapping import METHODS

__all__ = [
    "asked_recipe",
    "program_version",
    "provenance_of",
    "with_provenance",
]

#: Packages whose numbers go into the results.
PACKAGES = ("numpy", "scipy", "scikit-image", "numba")


def provenance_of(
    outcome: Outcome,
    source: Fingerprint | None = None,
    cancelled: CancelledCall | None = None,
    reference: Fingerprint | None = None,
) -> dict[str, Any]:
    """Return what made the results of a run, as JSON can hold it.

    There are no dates, no names of users or machines, and no places of files in it, so that the
    same run gives the same bytes.

    Parameters
    ----------
    outcome : Outcome
        What the run gave.
    source : Fingerprint, optional
        That of the input. Default: it is computed now, if the input is still there.
    cancelled : callable, optional
        ``cancelled()`` stops the work.
    reference : Fingerprint, optional
        That of the file it was divided by. Default: it is computed now, if there is such a file.

    Returns
    -------
    dict
        ``program`` and ``version``; ``versions`` of what computes; ``recipe``, with the lobes and
        the microscope that were used; ``boundary`` as (time, angle) numbers; ``input``: name,
        bytes and SHA-256; and, where there are any, ``boundary_found_by``, what told the boundary
        frame if it was found automatically, ``packages`` that brought methods, and
        ``reference``, the same as ``input`` of the file it was divided by.
    """
    recipe = outcome.recipe
    found = {
        "program": PROGRAM,
        "version": program_version(),
        "versions": versions(),
        "recipe": settings_of(recipe),
        "boundary": [list(frame) for frame in recipe.start_frames],
        "input": (source or source_of(outcome, cancelled)).as_dict(),
    }
    if outcome.scores is not None:
        found[FOUND_BY] = outcome.scores.attrs["basis"]
    if brought := packages_of(recipe):
        found["packages"] = brought
    if recipe.reference_file is not None:
        found["reference"] = (reference or known(recipe.reference_file, cancelled)).as_dict()
    return found


def with_provenance(stack: xr.DataArray, provenance: dict[str, Any]) -> xr.DataArray:
    """Return a stack that notes where it comes from, and no place on this machine."""
    source = stack.attrs.get("source")
    nowhere = {"source": nameless(source)} if isinstance(source, str) else {}
    return stack.assign_attrs({**nowhere, "provenance": provenance})


def asked_recipe(recipe: Recipe, reference: Fingerprint | None = None) -> dict[str, Any]:
    """Return a recipe but for its recording, with the fingerprint of its reference file."""
    noted: dict[str, Any] = {} if reference is None else {"reference": reference.as_dict()}
    if brought := packages_of(recipe):
        noted["packages"] = brought
    return settings_of(recipe) | {"recording": ""} | noted


def packages_of(recipe: Recipe) -> list[str]:
    """Return names and versions of the packages that brought methods of a recipe."""
    return sorted({METHODS[method].package for method in recipe.methods} - {""})


def settings_of(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as JSON can hold it, with the names of files but not their places."""
    settings: dict[str, Any] = recipe.model_dump(mode="json")
    settings["recording"] = nameless(recipe.recording)
    if recipe.reference_file is not None:
        settings["reference"] = nameless(recipe.reference_file)
    return settings


def nameless(source: str) -> str:
    """Return the name of a file or sample without the place where it lies."""
    return source if not source or is_sample(source) else Path(source).name


def source_of(outcome: Outcome, cancelled: CancelledCall | None) -> Fingerprint:
    """Return the fingerprint of what a run began with, as far as it is known."""
    if outcome.recording is not None:
        source, name = outcome.recording.source, outcome.recording.name
    else:
        attrs = outcome.reconstruction["phase"].attrs
        source, name = str(attrs.get("source", "")), str(attrs.get("object", "phase"))
    return known(source, cancelled) if source else Fingerprint(name)


def known(source: str, cancelled: CancelledCall | None) -> Fingerprint:
    """Return the fingerprint of a file, or its name if it is not there any more."""
    try:
        return fingerprint(source, cancelled)
    except OSError:
        return Fingerprint(nameless(source))


def program_version() -> str:
    """Return the version of this program."""
    return metadata.version(PROGRAM)


def versions() -> dict[str, str]:
    """Return the versions of what computes."""
    return {"python": platform.python_version()} | {p: metadata.version(p) for p in PACKAGES}
