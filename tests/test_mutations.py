"""Lines that `python3 dev.py mutations` breaks are there, once each: else nothing is broken."""

from __future__ import annotations

import pytest
from benchmarks.mutations import MUTATIONS, PACKAGE, ROOT, Mutation


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_every_mutation_finds_its_line(mutation: Mutation) -> None:
    source = (ROOT / PACKAGE / mutation.file).read_text(encoding="utf-8")
    assert mutation.applied(source) != source
    for name in mutation.tests:
        assert (ROOT / "tests" / f"{name}.py").is_file()
