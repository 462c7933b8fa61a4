"""The unwrapping methods and their options, from the registry."""

from __future__ import annotations

from md import code, table

from napari_phase4d.unwrapping import BUILT_IN, Method

__all__ = ["markdown"]


def markdown() -> str:
    """Return a table of the program's methods, and one of options for each that has some."""
    rows = [
        (code(name), method.label, "yes" if method.streams else "no", method.summary)
        for name, method in BUILT_IN.items()
    ]
    head = ("id", "on screen", "larger than memory", "what it does")
    parts = [table(head, rows)]
    for name, method in BUILT_IN.items():
        parts += [f"## {name}", f"{method.label}: {method.summary}", f"Source: {method.source}."]
        parts += [options(method)] if method.options else []
    return "\n\n".join(parts)


def options(method: Method) -> str:
    """Return the table of a method's options."""
    rows = [(code(o.name), code(repr(o.default)), o.summary) for o in method.options]
    return table(("option", "default", "meaning"), rows)
