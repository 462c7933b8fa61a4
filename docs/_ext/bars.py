"""A bar in a docstring is a bar, as in |x|; reStructuredText would take it for something else."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx


def kept(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Mark every bar that stands in no code."""
    for number, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "".join(parts)


def setup(app: Sphinx) -> dict[str, bool]:
    """See every docstring."""
    app.connect("autodoc-process-docstring", kept, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
