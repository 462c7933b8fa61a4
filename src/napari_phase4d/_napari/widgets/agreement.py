"""The strip that shows over time how far the methods agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from qtpy.QtWidgets import QWidget

from napari_phase4d._napari.widgets.boundary_map import BoundaryMap
from napari_phase4d._napari.widgets.map_picture import MapPicture
from napari_phase4d._napari.widgets.paths import Frame, time_unit

__all__ = ["AgreementStrip"]


@dataclass
class AgreementPicture(MapPicture):
    """Frames in the colours of the share of the object on which all methods agree."""

    with_times: bool = False
    ends: tuple[str, str] = ("methods disagree", "agree")

    def words_on(self, frame: Frame) -> str:
        """Say in words what is shown of a frame."""
        t, a = frame
        factor, unit = time_unit(self.times_s)
        where = f"Time {self.times_s[t] / factor:.4g} {unit} (frame {t})"
        words = f"{where}, {self.view(a)}."
        if self.scores is not None:
            agreement = float(self.scores[t, a])
            if np.isnan(agreement):
                return f"{words}\nThis frame says nothing of the object.\nClick to go there."
            words += f"\nMethods disagree on {100 * (1 - agreement):.3g} % of the object."
        return f"{words}\nClick to go there."


class AgreementStrip(BoundaryMap):
    """Time to the right, one row a viewing angle; dark where methods disagree.

    The colours are those of the map of frames to start from.

    Signals
    -------
    frame_clicked(int, int, bool)
        (time index, angle index) to go to.
    """

    heights = (13, 14, 54)
    enlarged = 1.3
    picture_class = AgreementPicture

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("agreement")
        self.setAccessibleName("Agreement of the methods over time and viewing angle")
        self.setAccessibleDescription("The arrow keys move over the frames, Enter goes to one.")
