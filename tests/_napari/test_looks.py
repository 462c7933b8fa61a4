"""The five steps look as they did when somebody last looked at them.

Where a change is wanted, look at the pictures and make them anew: ``python3 dev.py looks``.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from napari.settings import get_settings
from numpy.typing import NDArray
from qtpy.QtGui import QFontInfo, QImage
from qtpy.QtWidgets import QApplication

from napari_phase4d.recording import Recording

pytestmark = pytest.mark.gui

LOOKS = Path(__file__).parent / "looks"
#: Set to make them anew instead of comparing.
ANEW = bool(os.environ.get("PHASE4D_LOOKS_ANEW"))
STEPS = ("recording", "lobes", "phase", "unwrap", "compare")
SIZES = {"small": (1280, 720), "large": (1600, 980)}
THEMES = ("dark", "light")
#: Pictures are kept half as large, and a pixel differs from so many grey values on. Seconds and
#: megabytes on screen differ from run to run, and fill less than that share of the panel.
SMALLER, GREY, SHARE = 2, 40, 0.015
#: Seconds for which a picture that differs is taken again.
LATE_S = 20


def picture_of(dock: Any) -> NDArray[np.uint8]:
    """Return grey values of the panel, half as large."""
    image = dock.grab().toImage().convertToFormat(QImage.Format.Format_Grayscale8)
    bits = image.constBits()
    if hasattr(bits, "asarray"):  # PyQt gives a pointer, PySide a view
        bits = bits.asarray(image.sizeInBytes())
    rows = np.frombuffer(bytes(bits), np.uint8)
    grey = rows.reshape(image.height(), image.bytesPerLine())[:, : image.width()]
    height, width = (n // SMALLER * SMALLER for n in grey.shape)
    blocks = grey[:height, :width].reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER)
    return blocks.mean(axis=(1, 3)).astype(np.uint8)


def share_that_differs(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    """Return the share of pixels that differ; all of them where the sizes do."""
    if one.shape != other.shape:
        return 1.0
    return float((np.abs(one.astype(int) - other) > GREY).mean())


def settled(qtbot: Any, dock: Any) -> None:
    """Wait until nothing runs, seen or unseen, and all is laid out."""
    qtbot.waitUntil(lambda: not dock.jobs.running and not dock._quiet.isActive(), timeout=60_000)
    for _ in range(3):
        qtbot.wait(60)
        QApplication.processEvents()


def looks(
    viewer: Any, dock: Any, qtbot: Any, before: dict[str, NDArray[np.uint8]]
) -> dict[str, NDArray[np.uint8]]:
    """Return the picture of every step in both themes and sizes.

    One that differs from that before is taken again for a while: on a busy machine, what is laid
    out last may come late.
    """
    found = {}
    for theme in THEMES:
        viewer.theme = theme
        for size, (width, height) in SIZES.items():
            viewer.window.resize(width, height)
            for number, step in enumerate(STEPS):
                dock.show_step(number)
                name = f"{number + 1}_{step}_{theme}_{size}"
                until = time.monotonic() + LATE_S
                while True:
                    settled(qtbot, dock)
                    found[name] = picture_of(dock)
                    share = share_that_differs(found[name], before.get(name, found[name]))
                    if share <= SHARE or time.monotonic() > until:
                        break
    return found


@pytest.mark.thorough
def test_the_five_steps_look_as_they_did(
    viewer: Any, dock: Any, qtbot: Any, small_video: Recording
) -> None:
    family = QFontInfo(dock.font()).family()
    known = LOOKS / "fonts.json"
    if not ANEW and json.loads(known.read_text()) != family:
        pytest.skip(f"the pictures are drawn with another font than {family}")
    get_settings().appearance.font_size = 9
    session = dock.session
    session.set_recording(small_video)
    session.find_lobes()
    session.reconstruct()
    session.unwrap(("spatial-2d", "temporal-angular", "directional-l1"))
    session.weigh()
    before = {} if ANEW else {path.stem: iio.imread(path) for path in LOOKS.glob("*.png")}
    found = looks(viewer, dock, qtbot, before)
    if ANEW:
        LOOKS.mkdir(exist_ok=True)
        for name, grey in found.items():
            iio.imwrite(LOOKS / f"{name}.png", grey)
        known.write_text(json.dumps(family) + "\n")
        return
    assert set(found) == set(before)
    shares = {name: share_that_differs(grey, before[name]) for name, grey in found.items()}
    assert {name: s for name, s in shares.items() if s > SHARE} == {}
    # What moves by a few pixels is noticed.
    for grey in found.values():
        assert share_that_differs(grey, np.roll(grey, 3, axis=0)) > SHARE
