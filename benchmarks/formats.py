"""The table of formats: what the tests in tests/test_formats.py found of each.

``python benchmarks/formats.py`` runs them and writes docs/tables/formats.md; every cell is a test.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "tables" / "formats.md"
#: Test -> head of its column.
COLUMNS = {
    "test_frames_right": "frames right",
    "test_metadata_right": "metadata right",
    "test_lazy": "lazy",
    "test_bad_file_gives_one_sentence": "cut short: one sentence",
    "test_noise_in_a_file_does_no_harm": "changed bytes: no harm",
}
WORDS = {"passed": "yes", "failed": "**no**", "skipped": "not run"}


class Outcomes:
    """Notes how each test of each format ended."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, str]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when != "call" and report.outcome == "passed":
            return
        test, _, name = report.nodeid.rpartition("::")[2].partition("[")
        if test in COLUMNS:
            self.found.setdefault(name.removesuffix("]"), {})[test] = WORDS[report.outcome]


def main() -> int:
    """Run the tests and write the table."""
    outcomes = Outcomes()
    code = pytest.main(["-q", str(ROOT / "tests" / "test_formats.py")], plugins=[outcomes])
    lines = [f"| format | {' | '.join(COLUMNS.values())} |", "|---" * (len(COLUMNS) + 1) + "|"]
    for name, found in outcomes.found.items():
        # A format without a test of laziness is read whole: an .npz file, a single image.
        cells = [found.get(test, "read whole") for test in COLUMNS]
        lines.append(f"| {name.replace('*', chr(92) + '*')} | {' | '.join(cells)} |")
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(TABLE)
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
