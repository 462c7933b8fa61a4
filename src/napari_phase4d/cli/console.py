"""Where the command line writes to."""

from __future__ import annotations

from rich.console import Console

__all__ = ["console", "errors"]

console = Console(highlight=False, soft_wrap=True)
errors = Console(stderr=True, highlight=False, soft_wrap=True)
