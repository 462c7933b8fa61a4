"""Where pictures go, and in which form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

PICTURES = Path(__file__).resolve().parents[1] / "pictures"


#: One row a colour: red, green, blue.
Palette = NDArray[np.uint8]
#: Figures that would be larger get fewer colours, in bytes.
LARGE = 300_000
#: So many of the most frequent colours are kept as they are, such as that of the window itself.
EXACT = 24
#: Share of the other colours that goes to small bright things, such as arrows and colour bars.
RARE = 0.5


def save_image(image: Image.Image, name: str, colours: int | None = None) -> None:
    """Save a picture; with so many colours, or with 255 where it would be large otherwise."""
    path = PICTURES / f"{name}.png"
    image = image.convert("RGB")
    if colours is None:
        image.save(path, optimize=True)
    if colours is not None or path.stat().st_size > LARGE:
        palette = palette_of(image, colours or 255)
        few = with_palette(image, palette)
        few.save(path, optimize=True)
    tell(path)


def palette_of(image: Image.Image, colours: int) -> Palette:
    """Return the colours that suit a picture: those of large areas, and those of small things."""
    counted = image.getcolors(image.width * image.height) or []
    exact = [colour for _, colour in sorted(counted, reverse=True)[:EXACT]]
    rare = round(RARE * (colours - EXACT))
    parts = (
        image.quantize(colours - EXACT - rare, method=Image.Quantize.MEDIANCUT),
        image.quantize(rare, method=Image.Quantize.MAXCOVERAGE),
    )
    found = [np.reshape(few.getpalette() or [], (-1, 3)) for few in parts]
    return np.concatenate([np.asarray(exact), *found]).astype(np.uint8)


def with_palette(image: Image.Image, palette: Palette) -> Image.Image:
    """Return a picture in the nearest colours of a palette.

    Pillow's own search is quick but does not always find the nearest.
    """
    pixels = np.asarray(image.convert("RGB"), dtype=np.uint32)
    packed = pixels @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)
    colours, where = np.unique(packed, return_inverse=True)
    apart = np.stack([colours >> 16, (colours >> 8) & 255, colours & 255], axis=-1)
    nearest = cKDTree(palette).query(apart)[1].astype(np.uint8)
    few = Image.fromarray(nearest[where].reshape(packed.shape), mode="P")
    few.putpalette(palette.tobytes())
    return few


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
