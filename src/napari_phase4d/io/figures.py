"""Figures to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from napari_phase4d.io.atomic import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_figure"]

DOTS_PER_INCH = 150
ENDINGS = (".png", ".svg", ".pdf")


def write_figure(path: str | Path, figure: Figure) -> Path:
    """Write a figure; the ending, .png, .svg or .pdf, says as what.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    ValueError
        If the ending is another one.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        msg = f"{path.name} can't be written as a figure; use one of {', '.join(ENDINGS)}"
        raise ValueError(msg)
    import matplotlib as mpl

    # Words of an SVG or a PDF stay words, which can be found and edited.
    words = {"svg.fonttype": "none", "pdf.fonttype": 42}
    with mpl.rc_context(words), written_whole(path) as temporary:
        figure.savefig(temporary, dpi=DOTS_PER_INCH)
    return path
