"""Frames that any thread or process can read."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.starting import found_anywhere, open_by
from napari_phase4d.recording import Recording

__all__ = ["FrameSource"]


class FrameSource:
    """A recording's frames; another process opens the recording anew.

    Parameters
    ----------
    recipe : Recipe
        Names the file.
    recording : Recording
        What was opened.
    """

    def __init__(self, recipe: Recipe, recording: Recording) -> None:
        self.recording = recording
        self._recipe = recipe.changed(
            recording=found_anywhere(recording.source),
            optics=recording.optics,
            frame_rate_hz=recording.frame_rate_hz,
            content="holograms",
        )

    def raw_frame(self, index: int) -> NDArray[np.generic]:
        """Return one frame, shape (y, x), its numbers as they are in the file."""
        return self.recording.raw_frame(index)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the frames out where they can be opened anew."""
        if not self.recording.source:
            if isinstance(self.recording.holograms.data, np.ndarray):
                msg = (
                    f"{self.recording.name} is in memory, where the workers of a cluster can't "
                    "read it; save it to a file first"
                )
                raise ValueError(msg)
            return dict(vars(self))
        return {"_recipe": self._recipe, "_stamp": self._stamp()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Open the recording where only its name has come along."""
        stamp = state.pop("_stamp", None)
        self.__dict__.update(state)
        if stamp is None:
            return
        self.recording = opened_anew(self._recipe.model_dump_json(), stamp)
        if self._stamp() != stamp:
            msg = f"{self.recording.name} has changed since this run began; run it again"
            raise OSError(msg)

    def _stamp(self) -> tuple[int, ...]:
        """Return what tells this recording from another one of the same name."""
        source = Path(self._recipe.recording)
        status = source.stat() if source.exists() else None
        when = () if status is None else (status.st_size, status.st_mtime_ns)
        return (*self.recording.holograms.shape, *when)


@lru_cache(4)
def opened_anew(recipe: str, _stamp: tuple[int, ...]) -> Recording:
    """Return the recording that a recipe names, opened once in each process."""
    found = open_by(Recipe.model_validate_json(recipe))
    assert isinstance(found, Recording)  # the recipe says what the file holds
    return found
