"""The settings of a recipe, from its model and docstring."""

from __future__ import annotations

import json
import re
from typing import Any

from md import code, table
from numpydoc.docscrape import ClassDoc

from napari_phase4d import Optics, RawLayout, Recipe
from napari_phase4d.holography import Lobe

__all__ = ["markdown"]

#: What a setting may hold that has parts of its own.
PARTS = {"optics": Optics, "raw": RawLayout, "lobes": Lobe}


def markdown() -> str:
    """Return the table of settings, those of their parts, and an example."""
    rows = [
        (code(name), kind, default_of(name), meaning)
        for name, (kind, meaning) in described(Recipe).items()
    ]
    parts = [table(("setting", "type", "default", "meaning"), rows)]
    for name, cls in PARTS.items():
        own = [(code(n), kind, text) for n, (kind, text) in described(cls).items()]
        parts += [f"## {name}: parts", table(("part", "type", "meaning"), own)]
    example = Recipe(
        recording="night/cell_01.tif",
        optics=Optics(magnification=60),
        frame_rate_hz=6,
        angles_deg=(-7, 21),
        lobes=(Lobe(carrier=(0.2, 0.1), radius=0.09, angle_deg=-7),),
        options={"temporal-angular": {"registration": False}},
    )
    text = in_few_lines(json.dumps(json.loads(example.model_dump_json()), indent=2))
    parts += ["## An example", f"```json\n{text}\n```"]
    return "\n\n".join(parts)


def described(cls: Any) -> dict[str, tuple[str, str]]:
    """Return type and meaning of every parameter of a class, in the words of its docstring.

    Raises
    ------
    ValueError
        If the docstring leaves one out, or names one that there is not.
    """
    found = {
        name: (p.type.removesuffix(", optional"), " ".join(p.desc))
        for p in ClassDoc(cls)["Parameters"]
        for name in p.name.split(", ")
    }
    fields = getattr(cls, "model_fields", None) or cls.__dataclass_fields__
    if list(found) != list(fields):
        msg = f"the docstring of {cls.__name__} describes {list(found)}, but it has {list(fields)}"
        raise ValueError(msg)
    return found


def default_of(name: str) -> str:
    """Return what a setting is if it is not given, as it stands in a file."""
    value = Recipe.model_fields[name].get_default(call_default_factory=True)
    return code(json.dumps(value))


def in_few_lines(text: str) -> str:
    """Write each list that holds no settings of its own on one line."""
    short = text
    for _ in range(2):  # lists, and lists of lists
        short = re.sub(
            r"\[\s+([^{}]*?)\s+\]", lambda m: f"[{' '.join(m[1].split())}]", short, flags=re.DOTALL
        )
    return short
