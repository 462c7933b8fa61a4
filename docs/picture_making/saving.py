"""Where pictures go, and in which form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

PICTURES = Path(__file__).resolve().parents[1] / "pictures"


#: Figures that would be larger get fewer colours, in bytes.
LARGE = 300_000
#: Share of the colours that is kept for small bright things, such as arrows.
RARE = 1 / 3


def save_image(image: Image.Image, name: str, colours: int | None = None) -> None:
    """Save a picture; with so many colours, or with 255 where it would be large otherwise."""
    path = PICTURES / f"{name}.png"
    image = image.convert("RGB")
    if colours is None:
        image.save(path, optimize=True)
    if colours is not None or path.stat().st_size > LARGE:
        few = with_palette(image, palette_of(image, colours or 255))
        few.save(path, optimize=True)
    tell(path)


def palette_of(image: Image.Image, colours: int) -> Image.Image:
    """Return the colours that suit a picture: those of large areas, and those of small things."""
    rare = round(RARE * colours)
    parts = (
        image.quantize(colours - rare, method=Image.Quantize.MEDIANCUT),
        image.quantize(rare, method=Image.Quantize.MAXCOVERAGE),
    )
    palette = Image.new("P", (1, 1))
    palette.putpalette([colour for part in parts for colour in part.getpalette() or []])
    return palette


def with_palette(image: Image.Image, palette: Image.Image) -> Image.Image:
    """Return a picture in the colours of a palette, without dots between them."""
    return image.quantize(palette=palette, dither=Image.Dither.NONE)


def save_figure(figure: Figure, name: str, dpi: int = 90) -> None:
    """Save what matplotlib has drawn."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    canvas.draw()
    save_image(Image.fromarray(np.asarray(canvas.buffer_rgba())), name)


def window_image(viewer: Any) -> Image.Image:
    """Return the whole window as it is on screen."""
    pixels = viewer.window.screenshot(canvas_only=False, flash=False)
    return Image.fromarray(pixels[..., :3])


def tell(path: Path) -> None:
    """Say what was made and how large it is."""
    print(f"{path.relative_to(PICTURES.parents[1])}  {path.stat().st_size / 1000:.0f} kB")
