"""Speed as ratios to other programs, measured in the same run: ``python3 dev.py bench``.

Prints all tables and writes them to ``docs/tables/speed.md``. Name some of them to print only
those, without writing: ``python3 dev.py bench frames holograms``. How quickly the window reacts is
measured by ``python3 dev.py bench window``, which writes ``docs/tables/window.md``; recordings
larger than memory by ``python3 dev.py bench streaming``, into ``docs/tables/streaming.md``; those
that are worked on while they are written by ``python3 dev.py bench live``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import calls
import holography
import scaling
import unwrapping
from measuring import Row, machine, table, taken_by_host

TABLES = Path(__file__).parents[1] / "docs" / "tables"
#: Run by themselves: one opens windows, one fills disks and takes half an hour, one waits.
WINDOW, STREAMING, LIVE = "window", "streaming", "live"

#: Name -> heading, and what makes the rows or lines.
PARTS: dict[str, tuple[str, Callable[[], Iterator[Row] | Iterator[str]]]] = {
    "frames": ("Single frames, one thread", unwrapping.frame_rows),
    "stacks": ("Stacks of frames", unwrapping.stack_rows),
    "calls": ("One call of `unwrap()`", calls.lines),
    "volumes": ("Three dimensions", unwrapping.volume_rows),
    "growing": ("Four dimensions", unwrapping.growing_lines),
    "holograms": ("From hologram to phase", holography.rows),
    "own": ("This project's own method", unwrapping.own_method_rows),
    "reliability": ("What is joined first", unwrapping.reliability_lines),
    "growth": ("Longer and larger recordings", scaling.growth_lines),
    "first": ("First use", scaling.first_use_lines),
}


def printed(part: Iterator[Row] | Iterator[str]) -> str:
    """Print a part as it comes, and return it as Markdown."""
    items = iter(part)
    first = next(items)
    if isinstance(first, Row):
        return table(row for row in (first, *items) if isinstance(row, Row))
    lines = []
    for line in chain([first], items):
        print(line, flush=True)
        lines.append(str(line))
    return "\n".join(lines)


def main(names: list[str]) -> int:
    if names == [WINDOW]:
        import window

        print(machine())
        write("window.md", [machine(), printed(window.lines())])
        return 0
    if names == [STREAMING]:
        import streaming

        words = machine(streaming.ROUNDS)
        print(words)
        write("streaming.md", [words, printed(streaming.lines())])
        return 0
    if names == [LIVE]:
        import live

        print(machine())
        write("live.md", [machine(), printed(live.lines())])
        return 0
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        known = ", ".join([*PARTS, WINDOW, STREAMING, LIVE])
        print(f"There is no table {unknown[0]!r}; there are {known}.")
        return 2
    before = taken_by_host()
    print(machine())
    written = [machine()]
    for name in names or PARTS:
        heading, part = PARTS[name]
        print(f"\n### {heading}\n", flush=True)
        written.append(f"### {heading}\n\n{printed(part())}")
    steal, used = (after - was for after, was in zip(taken_by_host(), before, strict=True))
    written.append(
        f"Of the processor time wanted, the host of this (virtual) machine took "
        f"{100 * steal / max(used, 1):.0f} % for others meanwhile."
    )
    print(f"\n{written[-1]}")
    if not names:
        write("speed.md", written)
    return 0


def write(name: str, written: list[str]) -> None:
    """Write tables to a file of the documents."""
    TABLES.mkdir(exist_ok=True)
    (TABLES / name).write_text("\n\n".join(written) + "\n")
    print(f"\nWritten to {TABLES / name}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
