"""Speed of unwrapping against scikit-image, whose results it checks pixel by pixel."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import numpy as np
from measuring import ROUNDS, Row, median_seconds, paired, peak_bytes, touch_memory
from scenes import FRAMES, TURN, frame, hard_frames, moving_cells, phase_of, wrapped
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from napari_phase4d.simulation import budding_yeast, with_noise
from napari_phase4d.unwrapping.frames import unwrap_frame
from napari_phase4d.unwrapping.growing import Workspace, grow_grid, second_differences

SEEDS = 5
PEER = "scikit-image 2-D"
STACK = (100, 2, 512, 512)


def wrong_share(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the share of pixels inside the border that differ by more than one number for all.

    At the border, scikit-image leaves the order to random numbers.
    """
    inner = (..., slice(1, -1), slice(1, -1))
    off = np.round((ours[inner] - theirs[inner]) / TURN)
    return float((off != np.median(off)).mean())


def same(share: float) -> str:
    return "identical" if share == 0 else f"{share:.1e} of the pixels differ"


def one_frame(phase: np.ndarray, work: Workspace) -> tuple[float, float, float]:
    """Return seconds of ours and of scikit-image's, and the share of pixels that differ."""
    everything, out = np.ones(phase.shape, dtype=bool), np.empty_like(phase)

    def ours() -> None:
        unwrap_frame(phase, everything, second_differences, work, out)

    def theirs() -> None:
        unwrap_phase(phase, rng=0)

    ours()
    quick = paired(ours, theirs, repeats=(5, 1))
    return *quick, wrong_share(out, unwrap_phase(phase, rng=0))


def frame_rows() -> Iterator[Row]:
    """One frame after the other on one thread; medians over seeds of medians over rounds."""
    work = Workspace()
    goals = {"gentle": ">= 200", "noise 0.5 rad": ">= 25", "steep": ">= 15"}
    for shape in FRAMES:
        for kind, goal in goals.items():
            found = [one_frame(frame(kind, shape, seed), work) for seed in range(SEEDS)]
            ours, theirs = (statistics.median(f[i] for f in found) for i in (0, 1))
            least = min(f[1] / f[0] for f in found)
            note = f"{same(max(f[2] for f in found))}; {SEEDS} seeds, least {least:.0f}"
            yield Row(f"{kind}, {shape[0]} x {shape[1]}", ours, PEER, theirs, goal, note)
        for name, phase in hard_frames(shape).items():
            ours, theirs, differing = one_frame(phase, work)
            what = f"hard: {name}, {shape[0]} x {shape[1]}"
            yield Row(what, ours, PEER, theirs, ">= 7", same(differing))


def stack_rows() -> Iterator[Row]:
    """A stack by `unwrap`, everything counted, against scikit-image frame by frame."""
    for kind, goals in (("gentle", (">= 300", "")), ("noise 0.5 rad", ("", ">= 20"))):
        few = [frame(kind, STACK[2:], seed) for seed in range(8)]
        stack = np.stack(few)[np.arange(np.prod(STACK[:2])) % 8].reshape(STACK)
        frames = list(stack.reshape(-1, *STACK[2:]))
        some = frames[:50]  # all take scikit-image a quarter of an hour
        scale = len(frames) / len(some)

        def on_threads(frames: list[np.ndarray] = some) -> None:
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(unwrap_phase, frames))

        def one_by_one(frames: list[np.ndarray] = some) -> None:
            for f in frames:
                unwrap_phase(f)

        p4d.unwrap(stack[:2], "spatial-2d")
        touch_memory(2)
        ours = median_seconds(partial(p4d.unwrap, stack, "spatial-2d"), ROUNDS)
        found = p4d.unwrap(stack, "spatial-2d").values[:4].reshape(8, *STACK[2:])
        pairs = zip(found, few, strict=True)
        share = max(wrong_share(a, unwrap_phase(b, rng=0)) for a, b in pairs)
        what = f"stack {STACK} by unwrap(), 2 threads, {kind}"
        peers: list[tuple[str, Callable[[], None], str]] = [
            ("1 thread", one_by_one, goals[0]),
            ("2 threads", on_threads, goals[1]),
        ]
        for peer, theirs, goal in peers:
            slow = median_seconds(theirs) * scale
            yield Row(what, ours, f"{PEER}, {peer}", slow, goal, same(share))
        with ProcessPoolExecutor(2) as pool:
            list(pool.map(unwrap_phase, some[:2]))
            slow = median_seconds(lambda: list(pool.map(unwrap_phase, some))) * scale  # noqa: B023
        yield Row(what, ours, f"{PEER}, 2 processes", slow, goals[1], same(share))


def volume_rows() -> Iterator[Row]:
    """Growing over three dimensions against scikit-image, with its rule for the faces."""
    work = Workspace()
    costs = partial(second_differences, bounded=(1, 2))
    for noise in (0.5, 0.9):
        volume = moving_cells(19, 1, 256, noise)[:, 0]
        turns = grow_grid(volume, None, costs, work)[0].copy()
        ours, theirs = paired(
            partial(grow_grid, volume, None, costs, work), partial(unwrap_phase, volume, rng=0)
        )
        off = turns - np.round((unwrap_phase(volume, rng=0) - volume) / TURN)
        share = float((off != np.median(off))[1:-1, 1:-1, 1:-1].mean())
        goal = ">= 12" if noise == 0.5 else ""
        what = f"3-D (19, 256, 256) with scikit-image's rule for the faces, noise {noise} rad"
        yield Row(what, ours, "scikit-image 3-D", theirs, goal, same(share))


def growing_lines() -> Iterator[str]:
    """What region growing in four dimensions costs a voxel."""
    yield "| 4-D region growing (19, 6, 256, 256) | ns a voxel | bytes a voxel | goal |"
    yield "|---|---|---|---|"
    for noise in (0.5, 0.9):
        volume = moving_cells(19, 6, 256, noise)
        grow_grid(volume)
        touch_memory(2)
        seconds = median_seconds(partial(grow_grid, volume, None))
        memory = peak_bytes(partial(grow_grid, volume, None))
        yield (
            f"| noise {noise} rad | {1e9 * seconds / volume.size:.0f} "
            f"| {memory / volume.size:.0f} | <= 110, <= 40 |"
        )


def own_method_rows() -> Iterator[Row]:
    """Directional L1 against the two-dimensional step of the same volume."""
    for size in (48, 96, 160, 256):
        for noise, goal in ((0.0, "6"), (0.2, "3"), (0.5, "3")):
            volume = with_noise(budding_yeast((size, size)), noise, seed=1)["wrapped"].values
            frames = list(volume.reshape(-1, size, size))
            p4d.unwrap(volume, "directional-l1")
            ours, theirs = paired(
                partial(p4d.unwrap, volume, "directional-l1"),
                lambda frames=frames: [unwrap_phase(f) for f in frames],
            )
            what = f"WL1 on yeast (19, 6, {size}, {size}), noise {noise} rad"
            note = f"{ours / theirs:.1f} times as long; may take {goal} times"
            yield Row(what, ours, f"{PEER}, 1 thread", theirs, f">= 1/{goal}", note)


def reliability_lines() -> Iterator[str]:
    """Share of wrong pixels of two ways to say what is joined first, against exact phase."""
    yield "| 512 x 512, wrong pixels (%), 4 seeds | second differences | coherence |"
    yield "|---|---|---|"
    for kind in ("noise 0.5 rad", "steep", "noise 0.9 rad"):
        shares: dict[str, list[float]] = {"herraez": [], "coherence": []}
        for seed in range(10, 14):
            exact = phase_of(kind, (512, 512), seed)
            for name, wrong in shares.items():
                found = p4d.unwrap(wrapped(exact), "spatial-2d", reliability=name).values
                off = np.round((found - exact) / TURN)
                values, counts = np.unique(off, return_counts=True)
                wrong.append(float(100 * (off != values[np.argmax(counts)]).mean()))
        means = " | ".join(f"{statistics.mean(wrong):.3f}" for wrong in shares.values())
        yield f"| {kind} | {means} |"
