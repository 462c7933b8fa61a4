"""Recordings larger than memory: the same numbers as in memory, in bounded memory."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.io.lazy import FrameReader, lazy_frames
from napari_phase4d.machine import measured
from napari_phase4d.pipeline import Needs, find_place, needs_of, phase_needs, run_batch, unwrap_by
from napari_phase4d.pipeline.stored import new_folder, stored_at
from napari_phase4d.recording import Recording
from napari_phase4d.stack import blocks_of
from napari_phase4d.task import Cancelled, Cluster, Threads, Watch, in_threads
from napari_phase4d.unwrapping import (
    METHODS,
    Method,
    directional,
    frame_by_frame,
    methods_for,
    volumes,
)

#: A method of another package, which is given all frames at once.
WHOLE = Method(
    "Whole",
    "this test",
    "Along rows.",
    frame_by_frame(lambda wrapped, mask: np.unwrap(wrapped, axis=1)),
    working_stacks=20.0,
    package="another 1.0",
)
STREAMING = tuple(m for m in methods_for(None) if METHODS[m].streams)


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut frames, small as they are, into blocks of 8: a short recording is to have several."""
    monkeypatch.setattr("napari_phase4d.stack.SMALL_FRAMES", 8)


@pytest.fixture(scope="module")
def video() -> Recording:
    """Nineteen frames of a moving cell: two whole blocks and a part of one."""
    exact = p4d.simulation.swimming_euglena((96, 112), 19, pixel_um=0.35, peak_rad=9)
    return p4d.simulation.multiplexed_video(exact["phase"], name="video")


@pytest.fixture(scope="module")
def recipe(video: Recording) -> p4d.Recipe:
    lobes = tuple(p4d.find_lobes(video, 2))
    return p4d.Recipe(lobes=lobes, methods=STREAMING, storage="memory")


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(METHODS._own, "whole", WHOLE)
    return "whole"


def assert_same(found: p4d.pipeline.Outcome, expected: p4d.pipeline.Outcome) -> None:
    for name in ("phase", "amplitude"):
        xr.testing.assert_identical(
            found.reconstruction[name].compute(), expected.reconstruction[name]
        )
    assert list(found.comparison.results) == list(expected.comparison.results)
    for method, result in expected.comparison.results.items():
        on_disk = found.comparison.results[method]
        assert on_disk.chunks is not None, "it lies in memory"
        xr.testing.assert_identical(on_disk.compute(), result)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"mask": None},
        {"boundary": ((11, 1),)},
        {"boundary": ((0, 0), (18, 1), (9, 0))},
        {"options": {"temporal-angular": {"registration": False, "split": False}}},
        {"options": {"spatial-2d": {"reliability": "coherence"}}},
        {"background": "none", "drift": False, "reference": 3},
    ],
    ids=str,
)
def test_stacks_on_disk_are_those_in_memory(
    settings: dict, video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    chosen = recipe.changed(**settings)
    expected = p4d.run(chosen, video)
    found = p4d.run(chosen.changed(storage="disk"), video, folder=tmp_path)
    assert_same(found, expected)
    names = {"wrapped", "amplitude", *STREAMING}
    assert {p.name for p in tmp_path.iterdir()} == {f"{name}.ome.zarr" for name in names}


def name_of(work: Callable) -> str:
    """Return the name of a function, or of the class of an object that is called."""
    named = work if hasattr(work, "__qualname__") else type(work)
    return f"{named.__module__}.{named.__qualname__}".removeprefix("napari_phase4d.unwrapping.")


@pytest.mark.slow
def test_every_block_may_be_done_twice(
    recipe: p4d.Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster does a block again when its worker dies, at whatever moment that was."""
    exact = p4d.simulation.swimming_euglena((48, 56), 19, pixel_um=0.7, peak_rad=9)["phase"]
    # Levels that wrap, so that most frames have to be lifted by a turn.
    drift = xr.DataArray(np.where(np.arange(19) % 2, 2.8, -2.8), dims="time")
    noise = np.random.default_rng(3).normal(0, 0.2, exact.shape)  # to be averaged
    wrapped = np.angle(np.exp(1j * (exact + drift + noise))).astype(np.float32)
    p4d.write_phase(tmp_path / "in.ome.zarr", exact.copy(data=wrapped))
    chosen = recipe.changed(recording=str(tmp_path / "in.ome.zarr"), boundary=((0, 0),))
    expected = p4d.run(chosen).comparison.results
    done: set[str] = set()
    once = Threads.map

    def twice(self: Threads, work: Callable, items: Iterable, watch: Watch) -> Iterator:
        def again(item: object) -> object:
            done.add(name_of(work))
            work(item)
            return work(item)

        return once(self, again, items, watch)

    def twice_in_threads(work: Callable, items: Iterable, watch: Watch, **more: bool) -> Iterator:
        def again(item: object) -> object:
            done.add(name_of(work))
            work(item)
            return work(item)

        return in_threads(again, items, watch, **more)

    monkeypatch.setattr(Threads, "map", twice)
    monkeypatch.setattr(volumes, "working_blocks", lambda shape: blocks_of(shape, 8))
    for part in iter_modules(directional.__path__, f"{directional.__name__}."):
        monkeypatch.setattr(f"{part.name}.in_threads", twice_in_threads, raising=False)
    found = p4d.run(chosen.changed(storage="disk"), folder=tmp_path / "out").comparison.results
    for method, result in expected.items():
        xr.testing.assert_identical(found[method].compute(), result)
    assert len(done) >= 20, sorted(done)  # every stage but the holograms'
    assert {
        "volumes.ContractBlock",
        *(f"laplacian.{part}Block" for part in ("Frames", "Time")),
        *(f"network_flow.{part}Block" for part in ("Course", "Close")),
        *(f"{part}.FinishBlock" for part in ("alone", "directional.methods")),
    } <= done


@pytest.mark.slow
def test_methods_that_need_all_frames_write_to_disk_too(
    video: Recording, recipe: p4d.Recipe, whole: str, tmp_path: Path
) -> None:
    chosen = recipe.changed(methods=("temporal-angular", whole, "directional-l1"))
    expected = p4d.run(chosen, video)
    found = p4d.run(chosen.changed(storage="disk"), video, folder=tmp_path)
    assert_same(found, expected)


@pytest.mark.slow
def test_phase_that_is_not_known_everywhere(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    phase = p4d.reconstruct(video, recipe.lobes)["phase"]
    phase[2, 1, 10:20, 10:30] = np.nan
    p4d.write_phase(tmp_path / "in.ome.zarr", phase)
    chosen = recipe.changed(recording=str(tmp_path / "in.ome.zarr"), mask=None)
    expected = p4d.run(chosen).comparison.results
    found = p4d.run(chosen.changed(storage="disk"), folder=tmp_path / "out").comparison.results
    for method, result in expected.items():
        xr.testing.assert_identical(found[method].compute(), result)
        np.testing.assert_array_equal(np.isnan(found[method].values), np.isnan(phase.values))


class Endless(FrameReader):
    """A long video that is made as it is read; it repeats a short one."""

    def __init__(self, short: np.ndarray, n_frames: int) -> None:
        super().__init__(Path("endless"), (n_frames, *short.shape[1:]), short.dtype)
        self.short = short
        self.once = threading.Event()

    def read(self, index: int) -> np.ndarray:
        return self.short[index % len(self.short)]


def long_video(video: Recording, n_frames: int) -> tuple[Recording, Endless]:
    reader = Endless(video.holograms.values, n_frames)
    return Recording.from_frames(lazy_frames(reader), optics=video.optics), reader


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_recording(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path, traced_memory: None
) -> None:
    def peak_of(n_frames: int) -> float:
        rec, _ = long_video(video, n_frames)
        # Finding the start looks at some frames at once, up to a limit of its own.
        settings = {"storage": "disk", "methods": ("temporal-angular",), "boundary": ((0, 0),)}
        chosen = recipe.changed(**settings)
        return measured(lambda: p4d.run(chosen, rec, folder=tmp_path / str(n_frames))).peak_mb

    peak_of(20)  # what is loaded and compiled once
    # The shorter one fills as many blocks as are under way at once, too.
    short, long = peak_of(160), peak_of(480)
    stack = 320 * np.prod(p4d.reconstruct(video, recipe.lobes)["phase"].shape[1:]) * 4 / 2**20
    # How many blocks are under way at once varies; the turns of all frames would take half of it.
    assert long - short < 0.2 * stack, f"{short:.1f} and {long:.1f} MB; the rest is {stack:.1f} MB"


@pytest.mark.slow
def test_cancelling_leaves_whole_stacks_only(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    said: list[str] = []

    def cancelled() -> bool:
        return any("along time" in message for message in said)

    with pytest.raises(Cancelled):
        p4d.run(
            recipe.changed(storage="disk", methods=("spatial-2d", "temporal-angular")),
            video,
            folder=tmp_path,
            progress=lambda done, total, message: said.append(message),
            cancelled=cancelled,
        )
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {"wrapped.ome.zarr", "amplitude.ome.zarr", "spatial-2d.ome.zarr"}
    for name in names:
        assert np.isfinite(p4d.read_results(tmp_path / name).values).all()


@pytest.mark.slow
def test_the_default_place_goes_when_it_is_not_needed(
    video: Recording, recipe: p4d.Recipe
) -> None:
    found = p4d.run(recipe.changed(storage="disk", methods=("spatial-2d",)), video)
    assert found.comparison.results["spatial-2d"].shape[0] == 19


@pytest.mark.slow
def test_what_does_not_fit_is_said_before_it_begins(
    video: Recording, recipe: p4d.Recipe, whole: str, tmp_path: Path
) -> None:
    rec, reader = long_video(video, 3_000_000)
    with pytest.raises(OSError, match=r"Whole works on all frames at once and needs about .* GB"):
        p4d.run(recipe.changed(methods=(whole,), storage="auto"), rec, folder=tmp_path)
    with pytest.raises(OSError, match=r"results need about .* of disk, but .* has .* left"):
        p4d.run(recipe.changed(storage="disk"), rec, folder=tmp_path / "not there yet")
    with pytest.raises(OSError, match=r"this needs about .* GB of memory, but"):
        p4d.run(recipe, rec, folder=tmp_path)
    assert not list(tmp_path.iterdir())
    assert not reader.once.is_set()


@pytest.mark.slow
def test_what_is_needed_is_what_is_used(
    video: Recording, recipe: p4d.Recipe, whole: str, tmp_path: Path
) -> None:
    needs = needs_of(recipe.changed(methods=("temporal-angular",)), video, recipe.lobes)
    assert isinstance(needs, Needs)
    assert needs.greediest == ""
    chosen = recipe.changed(storage="disk", methods=("temporal-angular",))
    p4d.run(chosen, video, folder=tmp_path)
    used = sum(f.stat().st_size for f in tmp_path.rglob("*") if f.is_file())
    assert used < needs.disk < 4 * used  # scratch is gone by now, and zeros are small
    shape = (1000, 2, 100, 100)
    all_at_once = phase_needs(("spatial-2d", whole, "temporal"), shape)
    assert all_at_once.greediest == whole
    assert all_at_once.on_disk > WHOLE.working_stacks * 4 * np.prod(shape)
    assert phase_needs(("spatial-2d",), shape).on_disk == pytest.approx(
        phase_needs(("spatial-2d",), (10**6, *shape[1:])).on_disk
    )


@pytest.mark.slow
def test_stacks_on_disk_can_be_written_as_tiff(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    np.save(tmp_path / "video.npy", video.holograms.values)
    chosen = recipe.changed(methods=("temporal-angular",), storage="disk")
    expected = p4d.run(chosen, video)
    table = run_batch(chosen, [tmp_path / "video.npy"], tmp_path / "out", form="tiff")
    assert list(table["status"]) == ["done"], table["error"].tolist()
    folder = tmp_path / "out" / "video"
    assert not [p for p in folder.iterdir() if p.is_dir()]
    found = p4d.read_results(folder / "temporal-angular.ome.tif")
    exact = expected.comparison.results["temporal-angular"]
    np.testing.assert_array_equal(found.values, exact.values)


@pytest.mark.slow
def test_a_folder_can_be_used_again_for_another_recording(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    chosen = recipe.changed(storage="disk", methods=("temporal-angular",))
    for n_frames in (9, 19, 3):
        rec, kept = long_video(video, n_frames)
        found = p4d.run(chosen, rec, folder=tmp_path)
        expected = p4d.run(chosen.changed(storage="memory"), rec)
        assert_same(found, expected)
        assert kept.shape[0] == n_frames


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*(left out as lost|little empty field)")
def test_frames_without_light_are_written_too(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    frames = video.holograms.values.copy()
    frames[8:] = 0  # whole blocks of one value, which Zarr may leave out
    dark = Recording.from_frames(frames, optics=video.optics)
    every = ("spatial-2d", "temporal-angular", "angular-temporal", "directional-l1")
    chosen = recipe.changed(methods=every, mask=None, background="none")
    found = p4d.run(chosen.changed(storage="disk"), dark, folder=tmp_path)
    assert np.isnan(found.reconstruction["amplitude"].values[8:]).all()
    assert found.reconstruction.attrs["lost_times"] == list(range(8, len(frames)))
    assert_same(found, p4d.run(chosen, dark))


@pytest.mark.slow
def test_a_part_of_a_stack_on_disk_is_that_part(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    start = ((4, 1),)
    chosen = recipe.changed(storage="disk", methods=("temporal-angular",), boundary=start)
    whole = p4d.run(chosen, video, folder=tmp_path).reconstruction["phase"]
    assert stored_at(whole) is not None
    part = whole.isel(time=slice(10, 19))
    assert stored_at(part) is None
    assert stored_at(-whole) is None
    place = find_place(chosen, phase_needs(chosen.methods, part.shape), tmp_path / "part")
    found = unwrap_by(chosen, part, place=place).results["temporal-angular"]
    expected = p4d.unwrap(part.compute(), boundary=start, mask="auto")
    np.testing.assert_array_equal(found.values, expected.values)
    with place.nested("again") as other:
        unwrap_by(chosen, -part.compute(), place=other)
    np.testing.assert_array_equal(found.values, expected.values)
    place.close()


@pytest.mark.slow
@pytest.mark.parametrize("after", [1, 2, 3])
def test_what_is_under_way_leaves_nothing_behind(
    after: int, video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    rec, _ = long_video(video, 400)
    asked = iter(range(10**6))
    with pytest.raises(Cancelled):
        p4d.run(
            recipe.changed(storage="disk", methods=("spatial-2d",)),
            rec,
            folder=tmp_path,
            cancelled=lambda: next(asked) > 40 * after,
        )
    time.sleep(0.5)
    assert all(p.name.endswith(".ome.zarr") for p in tmp_path.iterdir())


def test_leftovers_of_a_killed_run_are_removed(tmp_path: Path) -> None:
    mine = new_folder(tmp_path, ".phase4d")
    machine = mine.name.split("-")[1]
    dead = tmp_path / f".phase4d-{machine}-99999999-abc"
    elsewhere = tmp_path / ".phase4d-00000000-99999999-abc"
    for folder in (dead, elsewhere):
        folder.mkdir()
        (folder / "stack").write_bytes(b"1")
    new_folder(tmp_path, ".phase4d")
    assert mine.exists()
    assert elsewhere.exists()
    assert not dead.exists()


@pytest.mark.slow
def test_truth_is_looked_at_first_and_in_any_order_of_axes(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    chosen = recipe.changed(methods=("temporal-angular",))
    memory = p4d.run(chosen, video)
    truth = memory.comparison.results["temporal-angular"] + 1
    expected = p4d.run(chosen, video, truth).comparison.table["mse_rad2"]
    turned = truth.transpose("x", "time", "y", "angle")
    on_disk = chosen.changed(storage="disk")
    found = p4d.run(on_disk, video, turned, folder=tmp_path).comparison.table["mse_rad2"]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    with pytest.raises(ValueError, match="truth is"):
        p4d.run(on_disk, video, truth[:3], folder=tmp_path)


def test_what_can_not_be_is_said_before_the_work(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    chosen = recipe.changed(storage="disk")
    with pytest.raises(ValueError, match=r"boundary frame \(time 99, angle 0\) does not exist"):
        p4d.run(chosen.changed(boundary=((99, 0),)), video, folder=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"file can't be written .*; choose another one"):
        p4d.run(chosen, video, folder=tmp_path / "file")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


# On a cluster


@pytest.fixture
def cluster() -> Iterator[object]:
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        # Its own servers are closed in an order that some of its versions warn of.
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as found:
            yield found
            # Older versions wait for ever when they are closed while a worker is replaced.
            both_alive(found)


def both_alive(cluster: Any) -> bool:
    """Wait until a worker that was killed is replaced, and say whether it is."""
    give_up = time.monotonic() + 15
    while len(cluster.scheduler.workers) < 2 and time.monotonic() < give_up:
        time.sleep(0.05)
    return len(cluster.scheduler.workers) == 2


@pytest.fixture(scope="module")
def saved(video: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "video.npy"
    np.save(path, np.concatenate([video.holograms.values] * 4))
    return path


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_though_a_worker_is_killed(
    cluster: object, saved: Path, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    methods = ("temporal-angular", "spatial-2d", "region-growing", "laplacian")
    chosen = recipe.changed(recording=str(saved), methods=methods)
    expected = p4d.run(chosen)
    killed: dict[str, int] = {}

    def progress(done: int, total: int, message: str) -> None:
        """Kill a worker at the first sign of every stage, when the last one is replaced."""
        if message in killed or done == total:
            return
        killed[message] = 0
        if both_alive(cluster):  # what looks after the workers does not always start another one
            killed[message] = next(w.pid for w in cluster.workers.values() if w.pid)  # type: ignore[attr-defined]
            with contextlib.suppress(ProcessLookupError):
                os.kill(killed[message], signal.SIGKILL)

    address = cluster.scheduler_address  # type: ignore[attr-defined]
    found = p4d.run(chosen, folder=tmp_path, scheduler=address, progress=progress)
    stages = ("reconstruct", "2-D unwrapping", "the object", "along angle", "writing")
    stages += ("region growing", "estimate, frame by frame")
    assert all(any(stage in message for message in killed) for stage in stages)
    assert sum(victim > 0 for victim in killed.values()) >= len(stages)
    assert_same(found, expected)


@pytest.mark.slow
def test_a_cluster_can_be_cancelled(
    cluster: object, saved: Path, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    began: list[float] = []

    def cancelled() -> bool:
        began.append(time.monotonic())
        return len(began) > 3

    with pytest.raises(Cancelled):
        p4d.run(
            recipe.changed(recording=str(saved)),
            folder=tmp_path,
            scheduler=cluster.scheduler_address,  # type: ignore[attr-defined]
            cancelled=cancelled,
        )
    assert not list(tmp_path.iterdir())


def test_without_a_scheduler_there_is_one_sentence(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.task.ANSWER_S", 1)
    with pytest.raises(OSError, match="no dask scheduler answers at tcp://127.0.0.1:9"):
        p4d.run(recipe, video, folder=tmp_path, scheduler="tcp://127.0.0.1:9")


def test_a_scheduler_file_that_is_not_there(
    video: Recording, recipe: p4d.Recipe, tmp_path: Path
) -> None:
    with pytest.raises(OSError, match=r"no dask scheduler answers at .*none\.json"):
        p4d.run(recipe, video, folder=tmp_path, scheduler=str(tmp_path / "none.json"))


def chatter(port: socket.socket, said: bytes) -> None:
    """Take one connection and say something that no scheduler says, or nothing."""
    connection, _ = port.accept()
    with connection, contextlib.suppress(OSError):
        connection.sendall(said)
        connection.recv(1000)  # until the other end gives up


@pytest.mark.thorough
@pytest.mark.parametrize("said", [b"", b"SSH-2.0-OpenSSH_9.6\r\n", b"\0" * 8])
def test_what_else_listens_is_no_scheduler(said: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as port:
        threading.Thread(target=chatter, args=(port, said), daemon=True).start()
        began = time.monotonic()
        with pytest.raises(OSError, match="no dask scheduler answers at tcp"):
            Cluster(f"tcp://127.0.0.1:{port.getsockname()[1]}")
        assert time.monotonic() - began < 10
