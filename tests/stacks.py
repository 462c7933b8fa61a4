"""How the tests hold stacks, and the files of stacks, against each other."""

from __future__ import annotations

import json
from pathlib import Path

import xarray as xr

__all__ = ["assert_equal", "contents", "without_attrs"]


def assert_equal(found: xr.DataArray, expected: xr.DataArray) -> None:
    """Hold a stack against another, also where attributes are NaN."""
    assert found.values.tobytes() == expected.values.tobytes()
    assert found.dtype == expected.dtype
    assert json.dumps(found.attrs) == json.dumps(expected.attrs)
    xr.testing.assert_identical(without_attrs(found), without_attrs(expected))


def without_attrs(stack: xr.DataArray) -> xr.DataArray:
    """Return a stack that notes nothing; its coordinates do, as before.

    ``drop_attrs(deep=False)`` does not do that in early versions of xarray.
    """
    bare = stack.copy(deep=False)
    bare.attrs = {}
    return bare


def contents(path: Path) -> dict[str, bytes]:
    """Return the bytes of every file of a result."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return {str(p.relative_to(path)): p.read_bytes() for p in files}
