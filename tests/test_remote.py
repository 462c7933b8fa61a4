"""Recordings on a server, over http and S3: the same frames, one by one, and faults in words."""

from __future__ import annotations

import pickle
import time
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path, PureWindowsPath
from threading import Thread
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
import xarray as xr
import zarr

import napari_phase4d as p4d
from napari_phase4d.io import address_of
from napari_phase4d.pipeline import fingerprint, run_batch
from test_commands import told

pytest.importorskip("fsspec", reason="the extra 'remote' is not installed")
pytest.importorskip("aiohttp", reason="the extra 'remote' is not installed")

N_FRAMES, SIDE = 6, 96


class Server(SimpleHTTPRequestHandler):
    """Serves a folder, as files over http and as objects of S3; notes what it was asked for."""

    asked: list[str]
    refuses: set[str]

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self._answer(super().do_GET)

    def do_HEAD(self) -> None:
        self._answer(super().do_HEAD)

    def _answer(self, answer: object) -> None:
        name = unquote(urlsplit(self.path).path).lstrip("/")
        if self.command == "GET":  # S3's programs ask for the size before
            type(self).asked.append(name)
        if any(name.startswith(refused) for refused in self.refuses):
            self.send_error(403)
        elif not (Path(self.directory) / name).is_file():
            # The error that S3 gives; over plain http any will do.
            body = b"<Error><Code>NoSuchKey</Code><Message>not there</Message></Error>"
            self.send_response(404)
            self.send_header("Content-Type", "application/xml")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(body)
        else:
            answer()  # type: ignore[operator]


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    exact = p4d.simulation.swimming_euglena((SIDE, SIDE), N_FRAMES, pixel_um=0.5, peak_rad=5)
    video = p4d.simulation.multiplexed_video(exact["phase"])
    return np.asarray(video.holograms.data)


@pytest.fixture
def folder(tmp_path: Path, frames: np.ndarray) -> Path:
    """A folder with a plain store and an OME-Zarr of the same frames."""
    shape, pieces = frames.shape, (1, SIDE, SIDE)
    plain = tmp_path / "lab" / "plain.zarr"
    store = zarr.open(str(plain), mode="w", shape=shape, chunks=pieces, dtype=frames.dtype)
    store[:] = frames
    group = zarr.open_group(str(tmp_path / "lab" / "ome.zarr"), mode="w", zarr_format=2)
    axes = [
        {"name": "t", "type": "time", "unit": "second"},
        {"name": "y", "type": "space", "unit": "micrometer"},
        {"name": "x", "type": "space", "unit": "micrometer"},
    ]
    scale = [{"type": "scale", "scale": [0.25, 0.1, 0.1]}]
    levels = [{"path": "0", "coordinateTransformations": scale}]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": levels}]
    group.create_array("0", shape=shape, chunks=pieces, dtype=frames.dtype)[:] = frames
    return tmp_path


@pytest.fixture
def server(folder: Path) -> Iterator[ThreadingHTTPServer]:
    handler = type("Handler", (Server,), {"asked": [], "refuses": set()})
    found = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(folder)))
    found.kind = handler  # type: ignore[attr-defined]
    Thread(target=found.serve_forever, daemon=True).start()
    yield found
    found.shutdown()
    found.server_close()


@pytest.fixture(params=["http", "s3"])
def lab(
    request: pytest.FixtureRequest, server: ThreadingHTTPServer, monkeypatch: pytest.MonkeyPatch
) -> str:
    """Where the stores lie."""
    host = f"http://127.0.0.1:{server.server_port}"
    if request.param == "http":
        return f"{host}/lab"
    pytest.importorskip("s3fs", reason="the extra 'remote' is not installed")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nowhere")
    monkeypatch.setenv("AWS_ENDPOINT_URL", host)
    return "s3://lab"


@pytest.mark.parametrize(
    ("given", "address"),
    [
        ("https://example.org/a.zarr/", "https://example.org/a.zarr"),
        (Path("https://example.org/a.zarr"), "https://example.org/a.zarr"),
        ("S3://lab/a.zarr", "s3://lab/a.zarr"),
        ("http:/host:80/a.zarr", "http://host:80/a.zarr"),
        (PureWindowsPath("https://example.org/a.zarr"), "https://example.org/a.zarr"),
        ("C:/data/a.zarr", None),
        ("http", None),
        ("sample:cells", None),
        ("ftp://host/a.zarr", None),
    ],
)
def test_addresses_are_told_from_paths(given: str | Path, address: str | None) -> None:
    assert address_of(given) == address


@pytest.mark.slow
def test_frames_are_the_same_and_fetched_when_they_are_looked_at(
    lab: str, server: ThreadingHTTPServer, frames: np.ndarray
) -> None:
    found = p4d.open_recording(f"{lab}/plain.zarr")
    asked = server.kind.asked  # type: ignore[attr-defined]
    assert found.n_frames == N_FRAMES
    assert not [name for name in asked if "/c/" in name]
    np.testing.assert_array_equal(found.raw_frame(4), frames[4])
    assert {name for name in asked if "/c/" in name} == {"lab/plain.zarr/c/4/0/0"}
    np.testing.assert_array_equal(found.holograms.values, frames)
    again = pickle.loads(pickle.dumps(found.holograms))
    np.testing.assert_array_equal(again.values, frames)


@pytest.mark.slow
def test_an_ome_zarr_brings_its_facts(lab: str, frames: np.ndarray) -> None:
    found = p4d.open_recording(f"{lab}/ome.zarr")
    np.testing.assert_array_equal(found.holograms.values, frames)
    assert found.optics.pixel_um == pytest.approx(0.1)
    np.testing.assert_allclose(np.diff(found.times_s), 0.25)


@pytest.mark.thorough
def test_a_run_gives_what_the_file_gives(lab: str, folder: Path, tmp_path: Path) -> None:
    recipe = p4d.Recipe(methods=("spatial-2d", "temporal"), boundary=((0, 0),))
    there = p4d.run(recipe.changed(recording=f"{lab}/plain.zarr"))
    here = p4d.run(recipe.changed(recording=str(folder / "lab" / "plain.zarr")))
    for method, result in here.comparison.results.items():
        xr.testing.assert_equal(result.drop_attrs(), there.comparison.results[method].drop_attrs())
    table = run_batch(recipe, [f"{lab}/plain.zarr"], tmp_path / "out")
    assert list(table["status"]) == ["done"]
    # Whether the pixels on the server are the same can't be told, so it is done again.
    again = run_batch(recipe, [f"{lab}/plain.zarr"], tmp_path / "out", resume=True)
    assert list(again["status"]) == ["done"]


@pytest.mark.thorough
def test_the_command_line_takes_addresses(lab: str) -> None:
    printed = told("info", f"{lab}/ome.zarr")
    assert printed.startswith("ome.zarr")
    assert f"{N_FRAMES} frames of {SIDE} x {SIDE}" in printed


@pytest.mark.slow
def test_black_frames_that_zarr_leaves_out_are_black(lab: str, folder: Path) -> None:
    (folder / "lab" / "plain.zarr" / "c" / "2" / "0" / "0").unlink()
    found = p4d.open_recording(f"{lab}/plain.zarr")
    assert not found.raw_frame(2).any()
    assert found.raw_frame(3).any()


@pytest.mark.slow
def test_a_recording_that_ended_early_is_said(lab: str, folder: Path) -> None:
    for frame in (4, 5):
        (folder / "lab" / "plain.zarr" / "c" / str(frame) / "0" / "0").unlink()
    found = p4d.open_recording(f"{lab}/plain.zarr")
    assert found.raw_frame(3).any()
    with pytest.raises(OSError, match="nothing of it is on the server"):
        found.raw_frame(4)


@pytest.mark.slow
def test_faults_are_said_in_one_sentence(lab: str, server: ThreadingHTTPServer) -> None:
    with pytest.raises(
        OSError, match=r"there is no Zarr store at .*none\.zarr, or none that may be read"
    ):
        p4d.open_recording(f"{lab}/none.zarr")
    server.kind.refuses.add("lab/secret.zarr")  # type: ignore[attr-defined]
    with pytest.raises(OSError, match=r"at .*secret\.zarr, or none that may be read"):
        p4d.open_recording(f"{lab}/secret.zarr")
    found = p4d.open_recording(f"{lab}/plain.zarr")
    server.kind.refuses.add("lab/plain.zarr/c/1")  # type: ignore[attr-defined]
    with pytest.raises(OSError, match=r"frame 1 of plain\.zarr can't be read"):
        found.raw_frame(1)


@pytest.mark.parametrize(
    "address", ["http://127.0.0.1:9/a.zarr", "https://nowhere.invalid/a.zarr"]
)
def test_a_server_that_is_not_there_is_no_endless_wait(address: str) -> None:
    began = time.monotonic()
    with pytest.raises(OSError, match="can't be read"):
        p4d.open_recording(address)
    assert time.monotonic() - began < 30


@pytest.mark.slow
def test_fingerprints_do_not_pretend_to_know_pixels(lab: str) -> None:
    assert fingerprint(f"{lab}/plain.zarr").as_dict() == {"name": "plain.zarr"}


@pytest.mark.slow
def test_frames_before_the_first_that_was_written_are_black(lab: str, folder: Path) -> None:
    for frame in (0, 1, 2, 4, 5):
        (folder / "lab" / "plain.zarr" / "c" / str(frame) / "0" / "0").unlink()
    found = p4d.open_recording(f"{lab}/plain.zarr")
    assert not found.raw_frame(0).any()
    assert found.raw_frame(3).any()
    with pytest.raises(OSError, match="nothing of it is on the server"):
        found.raw_frame(5)


@pytest.mark.slow
def test_each_piece_is_asked_for_once(lab: str, server: ThreadingHTTPServer) -> None:
    found = p4d.open_recording(f"{lab}/plain.zarr")
    asked = server.kind.asked  # type: ignore[attr-defined]
    asked.clear()
    found.raw_frame(1)
    assert [name for name in asked if "/c/" in name] == ["lab/plain.zarr/c/1/0/0"]


@pytest.mark.slow
def test_who_may_not_list_may_still_read(
    lab: str, server: ThreadingHTTPServer, folder: Path, frames: np.ndarray
) -> None:
    # A bucket that refuses to say what is not there; Zarr asks for version 3 first.
    refused = ("zarr.json", ".zgroup", ".zmetadata")
    store = zarr.open(
        str(folder / "lab" / "old.zarr"), mode="w", shape=frames.shape, dtype="u1",
        chunks=(1, SIDE, SIDE), zarr_format=2,
    )  # fmt: skip
    store[:] = frames
    for name in refused:
        server.kind.refuses.add(f"lab/old.zarr/{name}")  # type: ignore[attr-defined]
    found = p4d.open_recording(f"{lab}/old.zarr")
    np.testing.assert_array_equal(found.raw_frame(2), frames[2])


@pytest.mark.slow
def test_results_are_not_written_to_a_server(
    lab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    phase = p4d.simulation.budding_yeast((16, 16), n_times=2)["wrapped"]
    file = p4d.write_phase(tmp_path / "phase.ome.tif", phase)
    on_disk = p4d.Recipe(recording=str(file), content="phase", storage="disk")
    for call in (
        lambda: p4d.write_phase(f"{lab}/out.ome.tif", phase),
        lambda: p4d.read_results(f"{lab}/out.ome.tif"),
        lambda: run_batch(p4d.Recipe(), [f"{lab}/plain.zarr"], f"{lab}/out"),
        lambda: p4d.run(on_disk, folder=f"{lab}/out"),
    ):
        with pytest.raises(OSError, match="lies on a server; results are written and read here"):
            call()
    assert not (tmp_path / "http:").exists()
    assert not (tmp_path / "s3:").exists()


@pytest.mark.slow
def test_phase_is_read_from_a_server(lab: str, folder: Path) -> None:
    wrapped = p4d.simulation.budding_yeast((24, 24), n_times=3)["wrapped"].values[:, 0]
    there = zarr.open(
        str(folder / "lab" / "phase.zarr"), mode="w", shape=wrapped.shape, dtype="f4"
    )
    there[:] = wrapped
    found = p4d.open_phase(f"{lab}/phase.zarr")
    np.testing.assert_array_equal(found.values[:, 0], wrapped)
    outcome = p4d.run(
        p4d.Recipe(recording=f"{lab}/phase.zarr", methods=("spatial-2d",), boundary=((0, 0),))
    )
    assert outcome.comparison.results["spatial-2d"].sizes["time"] == 3
