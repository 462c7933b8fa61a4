"""The command line, from the program itself."""

from __future__ import annotations

import re
from typing import Any

import typer
from md import code, table

from napari_phase4d.cli.app import app

__all__ = ["markdown"]

NAME = "napari-phase4d"


def markdown() -> str:
    """Return a section for every command."""
    group: Any = typer.main.get_command(app)
    context = group.context_class(group, info_name=NAME)
    parts = ["## Of all commands", parameters(group, context)]
    for name, command in group.commands.items():
        own = command.context_class(command, info_name=name, parent=context)
        parts += [f"## {name}", command.help, usage(command, own), parameters(command, own)]
    return "\n\n".join(parts)


def usage(command: Any, context: Any) -> str:
    """Return how a command is typed."""
    return f"```text\n{command.get_usage(context).removeprefix('Usage: ')}\n```"


def parameters(command: Any, context: Any) -> str:
    """Return a table of the arguments and options of a command."""
    records = [p.get_help_record(context) for p in command.get_params(context)]
    return table(("argument or option", "meaning"), [in_words(*r) for r in records if r])


def in_words(names: str, meaning: str) -> tuple[str, str]:
    """Return the two cells for one of them; what it is without being given stands last."""
    meaning = meaning.replace("[required]", "Required.")
    meaning = re.sub(r"\[default: (.+?)\]", lambda m: f"Default: {code(m[1])}.", meaning)
    return code(names), meaning
