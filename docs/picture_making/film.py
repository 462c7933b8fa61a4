"""A moving picture of the window: frames, captions and the mouse pointer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from picture_making.saving import Palette, palette_of, tell, window_image, with_palette

#: Pixels of the film across, of the strip with the caption, and its type size.
WIDTH, STRIP, TYPE = 840, 30, 16
STRIP_COLOUR, INK, DONE_COLOUR = "#14151a", "#ffffff", "#3d8fe0"
#: Colours of the whole film.
COLOURS = 255
#: Outline of a mouse pointer whose tip is at (0, 0), in pixels of the film.
POINTER = ((0, 0), (0, 17), (4, 13), (7, 19), (10, 18), (7, 12), (12, 12))
PRESSED_RADIUS = 9


#: Left, top, right, bottom.
Box = tuple[int, int, int, int]


@dataclass
class Film:
    """Pictures of a window, each with how long it is shown.

    Parameters
    ----------
    viewer : napari.Viewer
        Whose window to film.
    n_captions : int
        How many captions there will be.
    """

    viewer: Any
    n_captions: int
    caption: str = ""
    n_said: int = 0
    pointer: tuple[int, int] | None = None
    #: A part of the window, and where it is shown larger; pixels of the window.
    magnified: tuple[Box, Box] | None = None
    frames: list[Image.Image] = field(default_factory=list)
    durations_ms: list[int] = field(default_factory=list)

    def say(self, caption: str) -> None:
        """Give all frames from now on the next caption."""
        self.n_said += 1
        self.caption = caption

    def shoot(self, duration_ms: int, *, pressed: bool = False) -> None:
        """Take a picture; one that is like the last only makes that last longer."""
        frame = self._frame(pressed=pressed)
        if self.frames and frame.tobytes() == self.frames[-1].tobytes():
            self.durations_ms[-1] += duration_ms
            return
        self.frames.append(frame)
        self.durations_ms.append(duration_ms)

    def _frame(self, *, pressed: bool) -> Image.Image:
        window = window_image(self.viewer)
        scale = WIDTH / window.width
        height = round(window.height * scale)
        frame = Image.new("RGB", (WIDTH, height + STRIP), STRIP_COLOUR)
        frame.paste(window.resize((WIDTH, height), Image.Resampling.LANCZOS))
        if self.magnified is not None:
            part, target = self.magnified
            left, top, right, bottom = (round(n * scale) for n in target)
            larger = window.crop(part).resize(
                (right - left, bottom - top), Image.Resampling.LANCZOS
            )
            frame.paste(larger, (left, top))
            edge = (left - 1, top - 1, right, bottom)
            ImageDraw.Draw(frame).rectangle(edge, outline=DONE_COLOUR, width=2)
        if self.pointer is not None:
            x, y = (round(n * scale) for n in self.pointer)
            draw_pointer(ImageDraw.Draw(frame), x, y, pressed=pressed)
        self._write_caption(ImageDraw.Draw(frame), height)
        return frame

    def _write_caption(self, draw: ImageDraw.ImageDraw, top: int) -> None:
        """Write the caption, and draw how far the film is as dots."""
        font = ImageFont.truetype(font_manager.findfont("DejaVu Sans:bold"), TYPE)
        draw.text((14, top + STRIP / 2), self.caption, fill=INK, font=font, anchor="lm")
        for n in range(self.n_captions):
            x, y = WIDTH - 16 * (self.n_captions - n), top + STRIP / 2
            colour = DONE_COLOUR if n < self.n_said else "#4a4d57"
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), fill=colour)

    def save(self, path: Path) -> None:
        """Write a GIF that runs for ever, all frames with the same colours."""
        palette = palette_of_film(self.frames)
        frames = [with_palette(frame, palette) for frame in self.frames]
        frames[0].save(
            path,
            save_all=True,
            append_images=frames[1:],
            duration=self.durations_ms,
            loop=0,
            optimize=False,
            disposal=1,
        )
        tell(path)
        seconds = sum(self.durations_ms) / 1000
        print(f"  {len(frames)} frames, {seconds:.1f} s, {frames[0].width} x {frames[0].height}")


def draw_pointer(draw: ImageDraw.ImageDraw, x: int, y: int, *, pressed: bool) -> None:
    """Draw a mouse pointer, with a ring round its tip while the button is down."""
    if pressed:
        ring = (x - PRESSED_RADIUS, y - PRESSED_RADIUS, x + PRESSED_RADIUS, y + PRESSED_RADIUS)
        draw.ellipse(ring, outline="#ffd21f", width=3)
    draw.polygon([(x + a, y + b) for a, b in POINTER], fill="white", outline="black")


def palette_of_film(frames: list[Image.Image]) -> Palette:
    """Return the colours that suit some frames of the whole film."""
    chosen = frames[:: max(1, len(frames) // 24)]
    width, height = chosen[0].size
    sheet = Image.new("RGB", (width, height * len(chosen)))
    for n, frame in enumerate(chosen):
        sheet.paste(frame, (0, n * height))
    return palette_of(sheet, COLOURS)
