"""What a call of `unwrap` takes, everything counted: small frames, masks, T/A and WL1."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from measuring import ROUNDS, peak_bytes, touch_memory
from scenes import frame, wrapped
from skimage.restoration import unwrap_phase
from unwrapping import same, wrong_share

import napari_phase4d as p4d
from napari_phase4d.unwrapping.objects import object_mask, smooth_share_left_out

#: (time, angle, y, x) of a camera of a megapixel with two lobes: for T/A, and for WL1.
OF_PAPER, OF_OWN = (64, 2, 270, 330), (48, 2, 270, 330)
#: So often is a call of less than some milliseconds repeated.
REPEATS = 50


def turning_cell(shape: tuple[int, ...], noise: float) -> np.ndarray:
    """Return wrapped phase of a cell that drifts, turns and grows thick."""
    n = shape[0]
    t, a, y, x = np.ogrid[tuple(slice(length) for length in shape)]
    off_y, off_x = (y - 130 - 10 * a - 0.3 * t) / 45, (x - 160 + 0.5 * t) / (60 + 5 * a)
    exact = (2 + 18 * np.sin(np.pi * (t + 1) / (n + 2))) * np.exp(-((off_y**2 + off_x**2) ** 2))
    found: np.ndarray = wrapped(exact + np.random.default_rng(0).normal(0, noise, shape))
    return found


def seconds(work: Callable[[], object], repeats: int = 1) -> tuple[float, float]:
    """Return the median seconds of a call by the clock, and those of all cores."""
    work()
    by_clock, by_cores = [], []
    for _ in range(ROUNDS):
        began, used = time.perf_counter(), time.process_time()
        for _ in range(repeats):
            work()
        by_clock.append((time.perf_counter() - began) / repeats)
        by_cores.append((time.process_time() - used) / repeats)
    return statistics.median(by_clock), statistics.median(by_cores)


def lines() -> Iterator[str]:
    """Time by the clock, which others on the machine lengthen, and processor time of all cores."""
    touch_memory(2)
    yield "| work | by the clock | processor time | goal | results |"
    yield "|---|---|---|---|---|"
    small = frame("gentle", (64, 64), 0)
    for method in ("spatial-2d", "temporal-angular"):
        label = p4d.METHODS[method].label
        clock, cores = seconds(partial(p4d.unwrap, small, method), REPEATS)
        yield (
            f"| {label} of a frame of 64 x 64 | {1e3 * clock:.2f} ms | {1e3 * cores:.2f} ms "
            f"| <= 0.3 ms | |"
        )
    yield from against_peer()
    yield mask_line()
    yield from voxel_lines()


def against_peer() -> Iterator[str]:
    """A frame, and a hundred of them, as how many times as fast as scikit-image on one thread."""
    few = [frame("gentle", (512, 512), seed) for seed in range(4)]
    stack = np.stack(few)[np.arange(100) % 4]
    for phase, n, goal, repeats in ((few[0], 1, 120, REPEATS), (stack, 100, 250, 1)):
        found = p4d.unwrap(phase, "spatial-2d").values.reshape(-1, 512, 512)[:4]
        pairs = zip(found, few, strict=False)
        share = max(wrong_share(a, unwrap_phase(b, rng=0)) for a, b in pairs)
        theirs, _ = seconds(lambda: [unwrap_phase(f) for f in few])
        clock, cores = seconds(partial(p4d.unwrap, phase, "spatial-2d"), repeats)
        of_peer = theirs / 4 * n
        yield (
            f"| 2-D of {n} frame{'s' * (n > 1)} of 512 x 512 without residues "
            f"| {1e3 * clock:.2f} ms, {of_peer / clock:.0f} times as fast as scikit-image "
            f"| {1e3 * cores:.2f} ms | >= {goal} times | {same(share)} |"
        )


def mask_line() -> str:
    """The object of a frame, one thread."""
    exact = np.unwrap(np.unwrap(turning_cell((9, 1, 270, 330), 0.2)[8, 0], axis=0), axis=1)

    def find() -> None:
        smooth_share_left_out(exact, object_mask(exact))

    clock, cores = seconds(find, REPEATS)
    return (
        f'| the object of a frame of 270 x 330 (mask="auto") | {1e3 * clock:.2f} ms '
        f"| {1e3 * cores:.2f} ms | <= 0.5 ms | |"
    )


def voxel_lines() -> Iterator[str]:
    """What the methods for thick objects cost a voxel, beside the two-dimensional step."""
    phase = turning_cell(OF_PAPER, 0.2)
    for method, goal in (("spatial-2d", ""), ("temporal-angular", "<= 10 ns")):
        yield voxel_line(phase, method, "noise 0.2 rad", goal)
    for noise, most in ((0.2, 100), (0.5, 150)):
        phase = turning_cell(OF_OWN, noise)
        goal = f"<= {most} ns, <= 30 bytes"
        yield voxel_line(phase, "directional-l1", f"noise {noise} rad", goal)


def voxel_line(phase: np.ndarray, method: str, words: str, goal: str) -> str:
    """One of them."""
    clock, cores = seconds(partial(p4d.unwrap, phase, method))
    memory = peak_bytes(partial(p4d.unwrap, phase, method)) / phase.size
    by_clock, by_cores = (f"{1e9 * took / phase.size:.1f} ns a voxel" for took in (clock, cores))
    return (
        f"| {p4d.METHODS[method].label} on {phase.shape}, {words} "
        f"| {by_clock} | {by_cores}, {memory:.0f} bytes | {goal} | |"
    )
