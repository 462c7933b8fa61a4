"""A recording on a server is opened by its address, with the mouse and the keyboard."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
import zarr
from driving import answer_dialog

pytestmark = pytest.mark.gui
pytest.importorskip("aiohttp", reason="the extra 'remote' is not installed")


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def address(tmp_path: Path, small_video: Any) -> Iterator[str]:
    frames = np.asarray(small_video.holograms.data)
    pieces = (1, *frames.shape[1:])
    path = str(tmp_path / "far.zarr")
    store = zarr.open(path, mode="w", shape=frames.shape, chunks=pieces, dtype=frames.dtype)
    store[:] = frames
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/far.zarr"
    server.shutdown()
    server.server_close()


@pytest.mark.thorough
def test_an_address_is_typed_and_worked_on(dock, click, qtbot, address, small_video) -> None:
    answered = answer_dialog(address)
    click("open_address")
    assert answered()
    qtbot.waitUntil(lambda: dock.session.recording is not None, timeout=60_000)
    assert dock.session.recording.name == "far.zarr"
    assert dock.session.recording.source == address
    np.testing.assert_array_equal(dock.session.recording.raw_frame(2), small_video.raw_frame(2))
    click("find_lobes")
    click("reconstruct")
    assert dock.session.reconstruction.sizes["angle"] == 2


def test_what_is_no_address_is_said(dock, click) -> None:
    answered = answer_dialog("far.zarr")
    click("open_address")
    assert answered()
    assert "an address begins with https://" in dock.status.text()
    assert dock.session.recording is None
