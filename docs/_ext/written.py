"""Pages that are written from the program: a line ``<!-- written: commands -->`` becomes text.

So they can't say anything else than the program does.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import commands
import constants
import methods_list
import others
import recipe_fields
import sentences
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

#: What can be written, by the words after "written:"; the text is Markdown.
WRITERS: dict[str, Callable[..., str]] = {
    "commands": commands.markdown,
    "constants": constants.markdown,
    "methods": methods_list.markdown,
    "others": others.markdown,
    "recipe": recipe_fields.markdown,
    "sentences": sentences.markdown,
}
#: Tables that benchmarks write, without a heading -> title, and the command that made them.
TABLES = {
    "tables/speed": ("Speed", "python3 dev.py bench"),
    "tables/streaming": ("Recordings larger than memory", "python3 dev.py bench streaming"),
    "tables/cells": (
        "Cells, found, followed and weighed",
        "python3 dev.py accuracy cells cells_long",
    ),
    "tables/live": ("Phase while one records", "python3 dev.py bench live"),
    "tables/window": ("How quickly the window reacts", "python3 dev.py bench window"),
    "tables/formats": ("File formats, as tested", "python benchmarks/formats.py"),
}
MARK = re.compile(r"^<!-- written: (?P<what>[a-z]+)(?P<arguments>( [\w.]+)*) -->$", re.MULTILINE)


def fill(text: str) -> str:
    """Return the text of a page with every mark replaced by what it stands for."""
    return MARK.sub(lambda mark: WRITERS[mark["what"]](*mark["arguments"].split()), text)


def titled(docname: str, text: str) -> str:
    """Return a page of tables with a title, the command that made it, and headings below."""
    title, command = TABLES[docname]
    tables = re.sub(r"^#+ ", "## ", text, flags=re.MULTILINE)
    return f"# {title}\n\nMade by `{command}`.\n\n{tables}"


def on_source_read(app: Sphinx, docname: str, source: list[str]) -> None:
    """Fill in a page, or give it its title."""
    source[0] = titled(docname, source[0]) if docname in TABLES else fill(source[0])


def on_outdated(
    app: Sphinx, env: BuildEnvironment, added: set[str], changed: set[str], removed: set[str]
) -> list[str]:
    """Return the pages with a mark: the program may have changed though they have not."""
    pages = ((name, Path(env.doc2path(name))) for name in env.found_docs)
    return [
        name
        for name, path in pages
        if path.suffix == ".md" and MARK.search(path.read_text(encoding="utf-8"))
    ]


def setup(app: Sphinx) -> dict[str, bool]:
    """Fill in the pages as they are read."""
    app.connect("source-read", on_source_read)
    app.connect("env-get-outdated", on_outdated)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
