"""Finds what a module raises, and with which words, without running it."""

from __future__ import annotations

import ast
import builtins
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Raised", "raised_in"]

Function = ast.FunctionDef | ast.AsyncFunctionDef
Known = dict[str, Any]

#: What may stand between constants.
SUMS: dict[type[ast.operator], Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: operator.pow,
}


@dataclass(frozen=True)
class Raised:
    """A sentence that is raised.

    Parameters
    ----------
    sentence : str
        Its words, with ``{name}`` where the program puts something in.
    kind : str
        Class of the error, one of Python's own, or "Warning".
    function : str
        Who raises it, with the class that it belongs to.
    purpose : str
        First line of that function's docstring.
    """

    sentence: str
    kind: str
    function: str
    purpose: str


def raised_in(trees: Sequence[ast.Module]) -> Iterator[list[Raised]]:
    """Iterate over modules, and return the sentences of each.

    A class of error, or a function that returns a sentence, may stand in any of them.
    """
    everywhere = {f.name: f for tree in trees for f in functions_of(tree)}
    bases = {
        node.name: ast.unparse(node.bases[0])
        for tree in trees
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.bases
    }
    for tree in trees:
        own = {f.name: f for f in functions_of(tree)}
        yield list(raised_in_module(tree, everywhere | own, bases))


def raised_in_module(
    tree: ast.Module, helpers: dict[str, Function], bases: dict[str, str]
) -> Iterator[Raised]:
    """Iterate over the sentences of a module."""
    known = constants_of(tree)
    for name, function, owner in named_functions(tree):
        said = ast.get_docstring(function) or (ast.get_docstring(owner) if owner else "")
        purpose = (said or "").split("\n")[0]
        for kind, words in raises_of(function, helpers):
            for sentence in texts(words, function, helpers, known):
                yield Raised(sentence, builtin(kind, bases), name, purpose)


def named_functions(
    node: ast.AST, owner: ast.ClassDef | None = None
) -> Iterator[tuple[str, Function, ast.ClassDef | None]]:
    """Iterate over the functions of a module: name as ``Class.method``, function, class.

    Functions within functions count as part of the outer one.
    """
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Function):
            yield f"{owner.name}.{child.name}" if owner else child.name, child, owner
        else:
            yield from named_functions(child, child if isinstance(child, ast.ClassDef) else owner)


def functions_of(tree: ast.Module) -> Iterator[Function]:
    """Iterate over the functions of a module that belong to no class."""
    return (node for node in tree.body if isinstance(node, Function))


def raises_of(
    function: Function, helpers: dict[str, Function]
) -> Iterator[tuple[str, ast.expr | list[ast.expr]]]:
    """Iterate over the kind and the words of what a function raises or warns of."""
    waiting: list[ast.expr] = []
    for node in in_order(function):
        if isinstance(node, ast.Assign) and names_message(node.targets):
            waiting.append(node.value)
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
            kind, first = ast.unparse(node.exc.func), node.exc.args[0]
            if isinstance(first, ast.Name) and first.id == "msg":
                yield kind, waiting
                waiting = []
            elif kind in helpers:  # a function that makes the error
                yield from made_by(helpers[kind])
            else:
                yield kind, first
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "warnings.warn":
            yield "Warning", node.args[0]


def in_order(node: ast.AST) -> Iterator[ast.AST]:
    """Iterate over what is in a node, in the order of the text."""
    for child in ast.iter_child_nodes(node):
        yield child
        yield from in_order(child)


def names_message(targets: Sequence[ast.expr]) -> bool:
    """Say whether something is kept as ``msg``."""
    return any(isinstance(target, ast.Name) and target.id == "msg" for target in targets)


def made_by(function: Function) -> Iterator[tuple[str, ast.expr]]:
    """Iterate over the errors that a function makes for others to raise."""
    for node in in_order(function):
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in vars(builtins):
            kind = getattr(builtins, ast.unparse(node.func))
            if isinstance(kind, type) and issubclass(kind, Exception):
                yield kind.__name__, node.args[0]


def texts(
    words: ast.expr | list[ast.expr],
    function: Function,
    helpers: dict[str, Function],
    known: Known,
) -> list[str]:
    """Return the sentences that an expression can be; none if it only passes one on."""
    if isinstance(words, list):
        return [text for part in words for text in texts(part, function, helpers, known)]
    if isinstance(words, ast.IfExp):
        return texts([words.body, words.orelse], function, helpers, known)
    if isinstance(words, ast.Name) and isinstance(known.get(words.id), str):
        return [known[words.id]]
    if isinstance(words, ast.Call) and ast.unparse(words.func) in helpers:
        helper = helpers[ast.unparse(words.func)]
        returned = [n.value for n in in_order(helper) if isinstance(n, ast.Return) and n.value]
        spoken = [value for value in returned if isinstance(value, (ast.JoinedStr, ast.Constant))]
        return texts(list(spoken), helper, helpers, known)
    if isinstance(words, (ast.JoinedStr, ast.Constant)) and not is_number(words):
        return [spoken_text(words, known)]
    return []


def is_number(words: ast.expr) -> bool:
    """Say whether an expression is the code that a program ends with."""
    return isinstance(words, ast.Constant) and not isinstance(words.value, str)


def spoken_text(words: ast.expr, known: Known) -> str:
    """Return a string with placeholders."""
    if isinstance(words, ast.Constant):
        return str(words.value)
    if isinstance(words, ast.JoinedStr):
        return "".join(spoken_text(part, known) for part in words.values)
    if isinstance(words, ast.FormattedValue):
        value = constant(words.value, known)
        form = spoken_text(words.format_spec, known) if words.format_spec else ""
        return "{" + placeholder(words.value) + "}" if value is None else format(value, form)
    return "{" + placeholder(words) + "}"


def constant(node: ast.expr, known: Known) -> Any:
    """Return the value of a constant or of a sum with constants; None of anything else."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.BinOp) and type(node.op) in SUMS:
        left, right = constant(node.left, known), constant(node.right, known)
        if isinstance(left, (int, float)) and isinstance(right, (int, float)):
            return SUMS[type(node.op)](left, right)
    return None


def placeholder(node: ast.expr) -> str:
    """Return a short name for what is put in: its last name."""
    if isinstance(node, ast.Attribute):
        return placeholder(node.value) if node.attr in ("args", "value") else node.attr
    if isinstance(node, ast.Subscript):
        return placeholder(node.value)
    if isinstance(node, ast.IfExp):
        return f"{placeholder(node.body)} or {placeholder(node.orelse)}"
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.Call) and node.args:
        inner = node.args[0]
        if isinstance(inner, ast.GeneratorExp):
            inner = inner.generators[0].iter
        return ("number of " if ast.unparse(node.func) == "len" else "") + placeholder(inner)
    if isinstance(node, ast.Call):
        return placeholder(node.func)
    if isinstance(node, ast.Name):
        return node.id.lower() if node.id.isupper() else node.id
    return ast.unparse(node)


def constants_of(tree: ast.Module) -> Known:
    """Return the numbers and strings that a module gives names in capitals."""
    known: Known = {}
    for node in tree.body:
        if not isinstance(node, ast.Assign):
            continue
        target, value = node.targets[0], node.value
        both = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
        pairs = zip(target.elts, value.elts, strict=True) if both else [(target, value)]
        for name, one in pairs:
            if isinstance(name, ast.Name) and name.id.isupper():
                found = constant(one, known)
                if isinstance(found, (int, float, str)):
                    known[name.id] = found
    return known


def builtin(kind: str, bases: dict[str, str]) -> str:
    """Return the class of Python's own that a class of error is made of."""
    while kind in bases and not hasattr(builtins, kind):
        kind = bases[kind]
    return kind
