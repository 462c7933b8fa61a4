"""Lets a docstring name what it means by its last name, such as `unwrap` or `Recipe`.

Docstrings are also read in a terminal, where whole paths are in the way.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode


def resolved(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, text: nodes.TextElement
) -> nodes.Node | None:
    """Return a link to the one object of that name, or plain text for inner names."""
    if node.get("refdomain") != "py":
        return None
    target = str(node["reftarget"])
    domain = env.domains.python_domain
    here = owner_of(node)
    last = target.removeprefix("napari_phase4d").rpartition(".")[2]
    found = [name for name in domain.objects if name.endswith(f".{last}")]
    # Of several, a member of the class that the docstring belongs to.
    near = [name for name in found if here and name.startswith(f"{here}.")]
    wanted = near or sorted(found, key=lambda name: name.count("."))
    if wanted and (near or only_one(wanted)):
        obj = domain.objects[wanted[0]]
        return make_refnode(
            app.builder, node.get("refdoc", ""), obj.docname, obj.node_id, text, wanted[0]
        )
    return text if is_ours(target, here) else None


def owner_of(node: pending_xref) -> str:
    """Return the class, or else the module, in whose documentation a name stands."""
    module, owner = node.get("py:module"), node.get("py:class")
    return ".".join(part for part in (module, owner) if part)


def only_one(names: list[str]) -> bool:
    """Say whether the first name is shorter than all others: then it is the one meant."""
    depth = names[0].count(".")
    return len([name for name in names if name.count(".") == depth]) == 1


def is_ours(target: str, owner: str) -> bool:
    """Say whether a name is a field of a class, or a part of the program that is not public."""
    return target in fields_of(owner) or target in inner_names()


def fields_of(owner: str) -> set[str]:
    """Return the fields of a class, which docstrings call by name."""
    module, _, name = owner.rpartition(".")
    try:
        cls: Any = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError):
        return set()
    return set(inspect.signature(cls).parameters) if inspect.isclass(cls) else set()


@functools.cache
def inner_names() -> set[str]:
    """Return the names of all functions and classes of the program."""
    package = Path(str(importlib.import_module("napari_phase4d").__file__)).parent
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in package.rglob("*.py"))
    kinds = (ast.FunctionDef, ast.ClassDef)
    return {node.name for tree in trees for node in tree.body if isinstance(node, kinds)}


def setup(app: Sphinx) -> dict[str, bool]:
    """Ask here for every name that Sphinx does not find by itself."""
    app.connect("missing-reference", resolved)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
