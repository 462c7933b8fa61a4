"""Tables as the documents hold them, printed line by line."""

from __future__ import annotations


def heading(words: str, columns: str) -> None:
    """Print what a table is about, and the names of its columns, parted by spaces."""
    names = columns.split()
    print(f"\n{words}\n\n| {' | '.join(names)} |\n|{'---|' * len(names)}", flush=True)


def line(*cells: object) -> None:
    """Print a line of a table."""
    shown = (f"{c:.4f}" if isinstance(c, float) else str(c) for c in cells)
    print(f"| {' | '.join(shown)} |", flush=True)
