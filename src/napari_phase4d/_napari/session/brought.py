"""Settings that a recipe or a watch brought in unseen, and those that hold again after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from napari_phase4d.analysis import CellSettings
from napari_phase4d.pipeline import Recipe

__all__ = ["Brought"]

#: Settings of a recipe that no widget shows.
HIDDEN = ("first_frames", "confidence", "storage")
#: How cells are found, as far as no widget shows it.
HIDDEN_OF_CELLS = ("threshold_rad", "largest_um2", "split")

#: A setting: the field of the recipe, and what in it.
Key = tuple[str, str]


class Brought:
    """What others have set where nobody sees it: it holds for their recording, and not the next.

    What was set after that, by a script or in a widget, stays.
    """

    def __init__(self) -> None:
        #: What they have set, and what had been set before.
        self._theirs: dict[Key, Any] = {}
        self._before: dict[Key, Any] = {}

    def take(self, before: Recipe, after: Recipe) -> None:
        """Note what a recipe changes that no widget shows."""
        self._note(before, after, hidden())

    def take_options(self, before: Recipe, after: Recipe) -> None:
        """Note which options of methods are not those that the user had chosen."""
        methods = {*before.options, *after.options}
        self._note(before, after, [("options", method) for method in methods])

    def without(self, recipe: Recipe) -> Recipe:
        """Return a recipe without what others have brought into it."""
        back = {
            key: self._before[key]
            for key, value in self._theirs.items()
            if value_of(recipe, key) == value
        }
        plain = {field: value for (field, name), value in back.items() if not name}
        options = {**recipe.options, **{m: v for (f, m), v in back.items() if f == "options"}}
        cells = {name: value for (field, name), value in back.items() if field == "cells"}
        if recipe.cells is not None and cells:
            plain["cells"] = replace(recipe.cells, **cells)
        return recipe.changed(**plain, options={m: own for m, own in options.items() if own})

    def begin(self, before: Recipe, given: Recipe | None) -> None:
        """Begin anew; note what a recipe that is given, if any, changes of the user's own."""
        own = self.without(before)
        self.forget()
        if given is not None:
            self.take(own, given)

    def forget(self) -> None:
        """Let all that is set now be the user's own."""
        self._theirs, self._before = {}, {}

    def _note(self, before: Recipe, after: Recipe, keys: Sequence[Key]) -> None:
        for key in keys:
            old, new = value_of(before, key), value_of(after, key)
            if old != new:
                self._theirs[key], self._before[key] = new, old


def hidden() -> list[Key]:
    """Return all settings that no widget shows."""
    return [*((field, "") for field in HIDDEN), *(("cells", name) for name in HIDDEN_OF_CELLS)]


def value_of(recipe: Recipe, key: Key) -> Any:
    """Return the value of a setting."""
    field, name = key
    if field == "options":
        return recipe.options.get(name, {})
    if field == "cells":
        return getattr(recipe.cells or CellSettings(), name)
    return getattr(recipe, field)
