"""The small pictures of wrapped phase next to the spectrum."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from qtpy.QtGui import QColor

from napari_phase4d._napari.widgets.spectrum_canvas import VIEW_COLORS
from napari_phase4d._napari.widgets.view_strip import ViewStrip, phase_image

pytestmark = pytest.mark.gui


@pytest.fixture
def strip(qtbot: Any) -> ViewStrip:
    strip = ViewStrip()
    qtbot.addWidget(strip)
    strip.resize(125, 230)
    return strip


def phases(n: int, shape: tuple[int, int] = (40, 50)) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.uniform(-np.pi, np.pi, shape).astype(np.float32) for _ in range(n)]


def color_at(image: Any, x: float, y: float) -> tuple[int, ...]:
    return image.pixelColor(int(x), int(y)).getRgb()[:3]


@pytest.mark.parametrize("shape", [(7, 10), (13, 5), (1, 1)])
def test_colours_are_cyclic_from_minus_pi_to_pi(qapp, shape: tuple[int, int]) -> None:
    (phase,) = phases(1, shape)
    image = phase_image(phase)
    assert (image.height(), image.width()) == shape
    expected = colormaps["twilight_shifted"](np.round((phase / np.pi + 1) * 127.5) / 255)
    for y, x in np.ndindex(shape):
        away = np.subtract(color_at(image, x, y), 255 * expected[y, x, :3])
        assert np.abs(away).max() <= 8  # not more than to the next of the 256 colours


def test_both_ends_of_a_turn_are_one_dark_colour(qapp) -> None:
    image = phase_image(np.array([[-np.pi, np.pi, 0]], dtype=np.float32))
    ends = color_at(image, 0, 0), color_at(image, 1, 0)
    assert ends[0] == ends[1]
    assert max(ends[0]) < 60
    assert min(color_at(image, 2, 0)) > 200


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("size", [(125, 230), (124, 200), (300, 250)])
def test_pictures_fit_next_to_each_other(strip, n: int, size: tuple[int, int]) -> None:
    strip.resize(*size)
    strip.set_views(phases(n), [f"{i + 1}: {7 * i}°" for i in range(n)])
    places = strip.places()
    assert len(places) == n
    wide = size[0] > size[1]
    assert (len({round(p.left()) for p in places}) > 1) == (n > 1 if wide else n > 3)
    for place in places:
        assert strip.rect().toRectF().contains(place.adjusted(-2, -2, 2, 16))
        assert place.width() / place.height() == pytest.approx(50 / 40)
        assert place.height() > 38  # large enough to see an object in
    for a, b in itertools.combinations(places, 2):
        assert not a.adjusted(-2, -2, 2, 16).intersects(b.adjusted(-2, -2, 2, 16))
    order = [(round(p.top()), round(p.left())) for p in places]
    assert order == sorted(order)


def test_each_picture_has_its_phase_and_the_colour_of_its_view(strip) -> None:
    levels = [-2.0, 0.0, 1.5]
    strip.set_views(
        [np.full((30, 30), level, np.float32) for level in levels], ["1: -7°", "2: 21°", "3: 40°"]
    )
    shown = strip.grab().toImage()
    for index, (level, place) in enumerate(zip(levels, strip.places(), strict=True)):
        expected = 255 * np.array(colormaps["twilight_shifted"]((level / np.pi + 1) / 2)[:3])
        inside = color_at(shown, place.center().x(), place.center().y())
        assert np.abs(np.subtract(inside, expected)).max() <= 8
        frame = color_at(shown, place.left() - 1, place.center().y())
        assert np.abs(np.subtract(frame, QColor(VIEW_COLORS[index]).getRgb()[:3])).max() < 40
    assert strip.captions == ["1: -7°", "2: 21°", "3: 40°"]


def test_captions_are_drawn_under_the_pictures(strip) -> None:
    def written(caption: str) -> bytes:
        strip.set_views(phases(2), [caption, "2: 21°"])
        below = strip.places()[0]
        image = (
            strip.grab()
            .toImage()
            .copy(int(below.left()), int(below.bottom()) + 3, int(below.width()), 13)
        )
        colors = {color_at(image, x, y) for x in range(image.width()) for y in range(13)}
        return repr(sorted(colors)).encode() if len(colors) > 1 else b""

    assert written("") == b""
    assert written("1: -7°") != b""


def test_sentence_stands_where_there_is_no_phase(strip) -> None:
    def number_of_colors() -> int:
        image = strip.grab().toImage()
        return len({color_at(image, x, y) for x in range(125) for y in range(230)})

    assert number_of_colors() > 3
    strip.set_views(phases(1), ["1"])
    strip.set_views([], [])
    assert strip.places() == []
    assert 3 < number_of_colors() < 300


@pytest.mark.parametrize(("images", "captions"), [(2, 1), (0, 1), (7, 7)])
def test_wrong_numbers_are_said_so(strip, images: int, captions: int) -> None:
    with pytest.raises(ValueError, match=f"there are {images} images and {captions} captions"):
        strip.set_views(phases(images), ["x"] * captions)


def test_two_previews_are_taken_over_in_no_time(strip) -> None:
    """Previews of holograms of a megapixel, at the pace of the mouse."""
    pair = phases(2, (170, 170))
    strip.set_views(pair, ["1", "2"])
    seconds = []
    for _ in range(20):
        start = time.perf_counter()
        strip.set_views(pair, ["1", "2"])
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.003
