"""Break important lines one by one and show that a test notices each.

    python3 dev.py mutations            all of them
    python3 dev.py mutations flip mask  those whose name holds one of these words

The tree is copied to a temporary folder and changed there. A line that is not found exactly once
is an error: it was rewritten, and its mutation must be too.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "src/napari_phase4d"
LEFT_OUT = (".git", ".venv", ".*_cache", "_build", "pictures", "demo_output", "*.egg-info")
#: A mutation may make a test go on for ever.
LONGEST_S = 900
SURVIVED = "SURVIVED"


@dataclass(frozen=True)
class Mutation:
    """One change of one line, and the tests that are to notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, source: str) -> str:
        """Return the text of the file with the change."""
        found = source.count(self.old)
        if found != 1:
            msg = f"{self.name}: {self.old!r} is {found} times in {self.file}, not once"
            raise ValueError(msg)
        changed = source.replace(self.old, self.new)
        compile(changed, self.file, "exec")
        return changed

    def line_in(self, source: str) -> int:
        """Return the number of the line."""
        return source[: source.index(self.old)].count("\n") + 1


MUTATIONS = (
    Mutation("sign of a mirrored half's phase", "holography/demodulation.py",
             "if mirrored:  # F(-k)", "if not mirrored:  # F(-k)", ("test_holography",)),
    Mutation("pixels begin at the seam", "holography/demodulation.py",
             "return (ratio - 1) / 2", "return 0.0 * ratio", ("test_holography",)),
    Mutation("pixels moved the other way", "holography/demodulation.py",
             "np.exp(2j * np.pi * offsets[-1] * middle",
             "np.exp(-2j * np.pi * offsets[-1] * middle", ("test_holography",)),
    Mutation("sign of the carrier's rest", "holography/demodulation.py",
             "(k - centre / n) * (n / m)", "(centre / n - k) * (n / m)", ("test_holography",)),
    Mutation("flip of a view", "holography/demodulation.py",
             "if self.flip:", "if not self.flip:", ("test_holography",)),
    Mutation("window off by one frequency", "holography/demodulation.py",
             "(centre + np.arange(m) - m // 2) / n - k",
             "(centre + np.arange(m) + 1 - m // 2) / n - k",
             ("test_windows", "test_holography")),
    Mutation("window's edge", "holography/demodulation.py",
             "scipy.special.erfc((rho - 1)", "scipy.special.erfc((rho - 0.9)",
             ("test_windows",)),
    Mutation("shift of the spectrum's axis", "holography/spectrum.py",
             "scipy.fft.fftshift(scipy.fft.fftfreq(width))", "scipy.fft.fftfreq(width)",
             ("test_spectrum",)),
    Mutation("sign of the background that is fitted", "holography/background.py",
             "wrapped(phase - np.tensordot(found, self.terms, 1))",
             "wrapped(phase + np.tensordot(found, self.terms, 1))", ("test_holography",)),
    Mutation("wrapping of a step", "unwrapping/growing/costs.py",
             "if step < -np.pi:", "if step < -TURN:", ("test_growing",)),
    Mutation("mask: both ends of a second difference", "unwrapping/growing/costs.py",
             "if seen_before[x] and seen_after[x]:", "if seen_before[x] or seen_after[x]:",
             ("test_growing",)),
    Mutation("tie-break of equal steps", "unwrapping/growing/merging.py",
             "(c < cheapest[end])", "(c <= cheapest[end])", ("test_growing",)),
    Mutation("turns between groups", "unwrapping/growing/merging.py",
             "steps[e] + turns[a] - turns[b]", "steps[e] - turns[a] + turns[b]",
             ("test_growing",)),
    Mutation("registration along y", "unwrapping/pieces.py",
             "(now.shift[0] - before.shift[0]) % height",
             "(before.shift[0] - now.shift[0]) % height", ("test_unwrapping",)),
    Mutation("boundary frame of another line", "unwrapping/chain.py",
             "if b[across] == other})", "if b[across] != other})", ("test_lines",)),
    Mutation("mass that is gained for mass that is lost", "analysis/balance.py",
             "= -float(gained[group]), over", "= float(gained[group]), over", ("test_balance",)),
    Mutation("mass that what slipped has left", "analysis/balance.py",
             "objects.mass[own].sum() + sum(", "objects.mass[own].sum() - sum(",
             ("test_balance",)),
    Mutation("mass counted towards the boundary frame", "analysis/balance.py",
             "jumps[number] if forwards else -jumps[number]", "jumps[number]", ("test_balance",)),
    Mutation("mass of objects that are cut off", "analysis/balance.py",
             "np.bincount(own, ~look.objects.intact, minlength=count) == 0",
             "np.bincount(own, ~look.objects.intact, minlength=count) >= 0",
             ("test_balance",)),
    Mutation("groups before the wrong change", "analysis/balance.py",
             "(one.after, other.before) if number > previous",
             "(one.before, other.after) if number > previous", ("test_balance",)),
    Mutation("steady growth for a loss", "analysis/balance.py",
             "change.gain - change.steps * middle", "change.gain - 0 * middle",
             ("test_balance",)),
    Mutation("cells that touch for one", "analysis/objects.py",
             "more = cells > 1\n", "more = cells > 99\n", ("test_balance",)),
    Mutation("small cells in a large piece", "analysis/cell_frames.py",
             "min(step, int(deepest * step / HALF_WIDTH))", "step", ("test_balance",)),
    Mutation("parts of losses that are parted again", "analysis/balance.py",
             "parts.setdefault(loss[:2], {})", "parts.setdefault(loss, {})", ("test_balance",)),
    Mutation("two turns of one daughter", "analysis/balance.py",
             "items() if count > 1}", "items() if count > 9}", ("test_balance",)),
    Mutation("slips of cells that touch for one", "analysis/slips.py",
             ">= least", "< 0", ("test_confidence",)),
    Mutation("a coarse form where nothing is", "analysis/cell_frames.py",
             "if (blob & (found == 0)).any():", "if False:", ("test_balance",)),
    Mutation("a gap for one step", "analysis/balance.py",
             "change.gain - change.steps * middle", "change.gain - middle", ("test_balance",)),
    Mutation("what is seen once", "unwrapping/directional/outliers.py",
             "    more = max(more, 0.0)", "    more = 0.0",
             ("test_outliers",)),
    Mutation("what changes by half a turn a frame", "unwrapping/directional/outliers.py",
             "(was_steady or stays_so)", "True",
             ("test_outliers",)),
    Mutation("missing mass remembered on disk", "pipeline/streaming.py",
             'ALL_USABLE, "missing mass"', "ALL_USABLE", ("test_confidence_long",)),
    Mutation("blocks know two frames on either side", "unwrapping/directional/outliers.py",
             "block.wider(2, 2, n)", "block.wider(1, 1, n)", ("test_outliers",)),
    Mutation("what is damaged is no witness", "unwrapping/directional/outliers.py",
             "range(time + 2, len(found)) if not found[k]",
             "range(time + 2, len(found)) if k >= 0", ("test_outliers",)),
    Mutation("outliers remembered on disk", "pipeline/streaming.py",
             '"lost", FRAMES_LEFT_OUT, "brightness"', '"lost", "brightness"', ("test_outliers",)),
    Mutation("room for what goes over the edge", "unwrapping/directional/scene.py",
             "WIDEST = 0.25", "WIDEST = 0.0", ("test_directional_edges",)),
    Mutation("several guesses are one", "holography/signs.py",
             "return float(np.clip(guesses, -GUESS, GUESS)) + others", "return guesses + others",
             ("test_layouts",)),
    Mutation("loss that touching cells share", "analysis/balance.py",
             "shared >= OVERLAP * smaller", "shared > 0", ("test_balance",)),
    Mutation("threads that don't wait for what one of them computes", "unwrapping/shared_steps.py",
             "setdefault(name, threading.RLock())", "setdefault(object(), threading.RLock())",
             ("test_task",)),
    Mutation("views that show a field where others do not", "unwrapping/background.py",
             "/ counts >= FRAME_SHARE", "/ counts > 1", ("test_left_out",)),
    Mutation("stacks that another run has replaced", "io/zarr_results.py",
             "if which_array(self.path) not in (None, self._which):", "if False:",
             ("test_guarding",)),
    Mutation("boundary counted from the end", "unwrapping/given.py",
             "found.append((t % shape[0], a % shape[1]))",
             "found.append((abs(t), a % shape[1]))", ("test_lines",)),
    Mutation("larger of two candidates (step 4)", "unwrapping/pieces.py",
             "max(whole, np.int32(turns[x]))", "min(whole, np.int32(turns[x]))",
             ("test_unwrapping",)),
    Mutation("cancel check along a line", "unwrapping/chain.py",
             "check=watch.check,", "check=lambda: None,", ("test_cancelling",)),
    Mutation("cancel check after a step", "task.py",
             "self.task.progress(self._done, self.total, self.message)\n        self.check()",
             "self.task.progress(self._done, self.total, self.message)",
             ("test_task", "test_unwrapping")),
    Mutation("WL1: views are lost one by one", "unwrapping/directional/registration.py",
             "np.flatnonzero(~self.lost.all(axis=1))", "np.flatnonzero(~self.lost.any(axis=1))",
             ("test_directional_hard",)),
    Mutation("WL1: sums over squares", "unwrapping/directional/registration.py",
             "sums[x] += near - kept[x]", "sums[x] += near", ("test_directional",)),
    Mutation("WL1: what a shift is worth in noise", "unwrapping/directional/registration.py",
             "most * np.array(costs)", "1 * np.array(costs)", ("test_directional",)),
    Mutation("WL1: level of a map of changes", "unwrapping/directional/changes.py",
             "turns - level, np.int32(0))", "turns + level, np.int32(0))",
             ("test_directional_hard",)),
    Mutation("WL1: turns that a change has passed", "unwrapping/directional/changes.py",
             "by_frames += whole_turns(difference - change)", "by_frames += 0 * known",
             ("test_directional_hard",)),
    Mutation("WL1: steep frames are no witnesses", "unwrapping/directional/changes.py",
             "<= STEEP_EDGE * parts.steps", "<= 2 * parts.steps", ("test_directional_hard",)),
    Mutation("WL1: which changes are looked at as a map", "unwrapping/directional/changes.py",
             "where=known) <= SURE:", "where=known) >= SURE:", ("test_directional_hard",)),
    Mutation("WL1: neighbours turned back along the slope", "unwrapping/neighbours.py",
             "real += z_real * s_real + z_imag * s_imag",
             "real += z_real * s_real - z_imag * s_imag", ("test_directional_hard",)),
    Mutation("WL1: parts that go on as before", "unwrapping/directional/changes.py",
             "count > MOST_LIKE * pieces.size", "count < MOST_LIKE * pieces.size",
             ("test_directional_boundary",)),
    Mutation("WL1: only what has a steep rim goes on as before",
             "unwrapping/directional/changes.py",
             ">= STEEP_RIM * self.steps", ">= 0 * self.steps", ("test_directional_boundary",)),
    Mutation("WL1: changes without empty field", "unwrapping/directional/changes.py",
             "down |= pieces.have_steep_rims(inside)", "pass",
             ("test_directional_hard",)),
    Mutation("the empty field that has truly moved", "unwrapping/border.py",
             "still < STILL and", "False and", ("test_directional_edges",)),
    Mutation("the empty field stays where it was", "unwrapping/border.py",
             "if border.share > SHARE_THAT_GOES_ON:", "if False:", ("test_directional_edges",)),
    Mutation("WL1: what slipped does not say that the field sags",
             "unwrapping/directional/sides.py",
             "min(whole, FURTHER * of_field)", "whole", ("test_directional_edges",)),
    Mutation("WL1: all of a cell pays where its rim is dark", "unwrapping/directional/sides.py",
             "faint[pays].mean() >= IN_THE_DARK", "faint[pays].mean() > 1",
             ("test_directional_edges",)),
    Mutation("WL1: what lies on the other side with all of it stays there",
             "unwrapping/directional/sides.py",
             "right >= PARTLY * size", "right >= 0 * size", ("test_directional_edges",)),
    Mutation("WL1: changes are followed to both sides", "unwrapping/directional/changes.py",
             "order if forward else reversed(order)", "order",
             ("test_directional_boundary",)),
    Mutation("WL1: which boundary frame is thin", "unwrapping/directional/following.py",
             ">= THINNER * steep * min(every, of_all)", ">= 0 * steep * min(every, of_all)",
             ("test_directional_boundary",)),
    Mutation("WL1: what has left is not thin", "unwrapping/directional/following.py",
             "steep * min(every, of_all)", "steep * every",
             ("test_directional_boundary",)),
    Mutation("WL1: doubt of a followed step grows", "unwrapping/directional/following.py",
             "max(doubt[k - way - first, i], unsteady[link, i])", "unsteady[link, i]",
             ("test_directional_hard",)),
    Mutation("WL1: end of a line of means", "unwrapping/neighbours.py",
             "mean_of_three(before[:size], here[:size], here[:size], row)",
             "mean_of_three(before[:size], here[:size], before[:size], row)",
             ("test_directional_hard",)),
    Mutation("a frame of noise among others", "unwrapping/given.py",
             "noise > typical + NOISIER", "noise > typical - NOISIER",
             ("test_directional_lost",)),
    Mutation("more than half of all frames are noise", "unwrapping/given.py",
             "np.median(noise[clear])", "np.median(noise[seen])", ("test_directional_lost",)),
    Mutation("a beam that is stronger as a whole", "holography/lost.py",
             "STRONG * max(1.0, middle)", "STRONG", ("test_lost",)),
    Mutation("a beam that is off for most of the time", "holography/lost.py",
             "(strength >= COLLAPSED * strong)", "(strength >= 0)", ("test_lost",)),
    Mutation("few clear frames", "unwrapping/given.py",
             "np.median(noise[noisy])) < PURE", "np.median(noise[noisy])) < 0",
             ("test_directional_lost",)),
    Mutation("a view that is lost counts", "unwrapping/directional/registration.py",
             "seen.usable[i, angle] = False", "pass", ("test_directional_lost",)),
    Mutation("the frame before a lost one is held", "unwrapping/directional/registration.py",
             "if now == 0 or len(next_to_it) < 2", "if True or len(next_to_it) < 2",
             ("test_directional_lost",)),
    Mutation("empty frames before a cell are not lost", "unwrapping/given.py",
             "same &= before & after", "same &= before | after", ("test_directional_lost",)),
    Mutation("tilt of the empty field", "unwrapping/border.py",
             "tilt = tilt + fit[1:]", "tilt = tilt - fit[1:]", ("test_directional_hard",)),
    Mutation("lost frames in the result's notes", "unwrapping/running.py",
             '= np.argwhere(left_out).tolist()', '= []',
             ("test_directional_lost",)),
    Mutation("what is not known stays so", "unwrapping/problem.py",
             "if self.unknown is not None:\n            values",
             "if self.unknown is None:\n            values",
             ("test_directional_lost",)),
    Mutation("what is not known stays so on disk", "unwrapping/given.py",
             "if self.usable is None and not usable.all():\n            unwrapped",
             "if False:\n            unwrapped", ("test_streaming",)),
    Mutation("cells that reach what is not known", "analysis/cell_table.py",
             "unknown <= UNKNOWN_SHARE", "unknown >= 0 * UNKNOWN_SHARE", ("test_cells",)),
    Mutation("what a signal raises in a loop", "compiling.py",
             "raise cause from None", "raise", ("test_warming",)),
    Mutation("typed angles of a recipe's lobes", "cli/options.py",
             "| typed_lobes(recipe, typed)", "", ("test_commands",)),
    Mutation("border of the Laplacian", "unwrapping/laplacian.py",
             "total[tail] -= step", "total[tail] += step", ("test_competitors",)),
    Mutation("safest frame", "unwrapping/boundaries.py",
             "int(np.argmax([", "int(np.argmin([", ("test_confidence", "test_boundaries")),
    Mutation("lost frames are never safe", "unwrapping/boundaries.py",
             "np.argwhere(~lost)", "np.argwhere(~lost | lost)", ("test_boundaries",)),
    Mutation("safest frame of a run", "pipeline/starting.py",
             "boundary=(best_frame(scores),)", "boundary=((0, 0),)", ("test_starting",)),
    Mutation("wavelength in the optical path", "optics.py",
             "self.wavelength_um / (2 * np.pi)", "self.wavelength_um / np.pi", ("test_optics",)),
    Mutation("medium's index in the height", "optics.py",
             '"object_index", object_index) - self.medium_index',
             '"object_index", object_index) + self.medium_index',
             ("test_optics",)),
    Mutation("area of a pixel in dry mass", "analysis/measures.py",
             "optics.dry_mass_pg(1.0, pixel_um2,", "optics.dry_mass_pg(1.0, 1.0,",
             ("test_measures",)),
    Mutation("nanometres to micrometres", "io/video.py",
             '("nm", "nanometer", "nanometre"), 1e-3', '("nm", "nanometer", "nanometre"), 1e3',
             ("test_io",)),
    Mutation("Itoh's limit of half a turn", "analysis/itoh.py",
             "steps[counted] > 1", "steps[counted] > 2",
             ("test_itoh",)),
    Mutation("last frame of a streamed block", "stack.py",
             "Block(t, min(t + each, shape[0])) for",
             "Block(t, min(t + each, shape[0] - 1)) for", ("test_streaming", "test_stack_pieces")),
    Mutation("a folder that is not ours is left alone", "pipeline/batch_folders.py",
             "if folder.is_symlink() or not own:", "if folder.is_symlink():", ("test_batch",)),
    Mutation("resume by the input's content", "pipeline/batch_folders.py",
             'if note["input"] != source.result(task).as_dict():',
             'if note["input"].keys() != source.result(task).as_dict().keys():',
             ("test_batch",)),
    Mutation("resume by the results' content", "pipeline/batch_folders.py",
             "task, look_inside=True)", "task, look_inside=False)", ("test_batch",)),
    Mutation("sign of a synthetic wavelength's second view", "unwrapping/light/views.py",
             "float(k == i) - float(k == j)", "float(k == i) + float(k == j)",
             ("test_wavelengths",)),
    Mutation("turns between regions that meet", "unwrapping/light/steps.py",
             "apart = up_a + asked[step] - up_b", "apart = up_a - asked[step] - up_b",
             ("test_wavelengths",)),
    Mutation("walls between regions", "unwrapping/light/steps.py",
             "> 2 * variance * odds[2]", "> 1e9 * variance * odds[2]", ("test_wavelengths",)),
    Mutation("a wall that one step leads over", "unwrapping/light/steps.py",
             "min(2, n) for n in smooth.shape", "min(1, n) for n in smooth.shape",
             ("test_wavelengths",)),
    Mutation("edges of views that a transform mixed", "unwrapping/light/synthetic.py",
             "led_to_edges(path, known) if settings.settle else path", "path",
             ("test_wavelengths",)),
    Mutation("steps where wavelengths agree by accident", "analysis/confidence.py",
             "np.maximum(by_steps_alone, least)", "np.float32(0.9)",
             ("test_wavelengths_trust",)),
    Mutation("steep phase, where views are apart", "unwrapping/light/agreement.py",
             "(APART * each * steepest)", "(0 * each * steepest)", ("test_wavelengths_trust",)),
    Mutation("wavelengths that WL1 would mix up", "analysis/confidence.py",
             "METHODS[REFERENCE].function(part, ViewsOf(found, views), task)",
             "METHODS[REFERENCE].function(problem, found, task)", ("test_confidence_long",)),
    Mutation("turns of what small steps lead to", "unwrapping/light/steps.py",
             "(turns - turns[ground])[led_to] - level",
             "(turns - turns[ground])[led_to] - level + 1", ("test_wavelengths",)),
    Mutation("level where a slope covers half of the border", "unwrapping/frames.py",
             "if 2 * near >= len(phase):", "if True:", ("test_unwrapping",)),
    Mutation("tilts have no fullest place", "unwrapping/frames.py",
             "if last - first > enough:", "if True:", ("test_unwrapping",)),
    Mutation("field followed through frames that hide it", "unwrapping/frames.py",
             "line[before] + way[t] - way[before]", "0", ("test_unwrapping",)),
    Mutation("field not shown at the boundary time", "unwrapping/frames.py",
             "np.isnan(field[start]), 0.0,", "False, 0.0,", ("test_unwrapping",)),
    Mutation("level of a volume where a slope covers half of the border", "unwrapping/volumes.py",
             "if field != median and", "if False and", ("test_unwrapping",)),
    Mutation("views of one wavelength by themselves", "unwrapping/running.py",
             "facts.wavelengths == 1 and problem.parts()", "facts.wavelengths == 0",
             ("test_wavelengths",)),
    Mutation("path by each view's wavelength", "analysis/cell_table.py",
             "return light / optics.wavelength_um", "return optics.wavelength_um / light",
             ("test_wavelengths",)),
    Mutation("beams of one wavelength interfere", "simulation/multiplexing.py",
             "np.flatnonzero(colours == colour) for colour in np.unique(colours)",
             "np.flatnonzero(colours) for colour in colours[:1]", ("test_wavelengths",)),
)  # fmt: skip


def main(words: Sequence[str]) -> int:
    """Apply each mutation, print the table, and return 1 if any survives."""
    chosen = [m for m in MUTATIONS if not words or any(word in m.name for word in words)]
    with tempfile.TemporaryDirectory(prefix="phase4d-mutations-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
        check_that_the_copy_is_tested(tree)
        for mutation in chosen:
            mutation.applied((tree / PACKAGE / mutation.file).read_text(encoding="utf-8"))
        sound = tested(tree, sorted({test for m in chosen for test in m.tests}))
        if sound is not None:
            print(f"Without any mutation: {sound}")
            return 2
        print("| what | where | killed by | seconds |\n| --- | --- | --- | --- |", flush=True)
        survivors = sum(not killed(mutation, tree) for mutation in chosen)
    print(f"\n{len(chosen)} mutations, {survivors} survived")
    return 1 if survivors else 0


def killed(mutation: Mutation, tree: Path) -> bool:
    """Apply a mutation, run its tests, print its row, and say whether a test failed."""
    path = tree / PACKAGE / mutation.file
    source = path.read_text(encoding="utf-8")
    path.write_text(mutation.applied(source), encoding="utf-8")
    begin = monotonic()
    try:
        by = tested(tree, mutation.tests)
    finally:
        # Not with its old time: what was compiled from the mutation must look outdated.
        path.write_text(source, encoding="utf-8")
    where = f"{mutation.file}:{mutation.line_in(source)}"
    cells = (mutation.name, where, by or SURVIVED, f"{monotonic() - begin:.0f}")
    print(f"| {' | '.join(cells)} |", flush=True)
    return by is not None


def tested(tree: Path, tests: Sequence[str]) -> str | None:
    """Run test files in the copy; return the first test that fails, None if none does."""
    files = [f"tests/{name}.py" for name in tests]
    line = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-rfE",
            "-p", "no:cacheprovider", "-m", "not gui", *files]  # fmt: skip
    try:
        done = subprocess.run(
            line, cwd=tree, env=environment(tree), capture_output=True, text=True,
            timeout=LONGEST_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no end after {LONGEST_S} s"
    if done.returncode == 0:
        return None
    found = re.search(r"^(?:FAILED|ERROR) tests/(\S+)", done.stdout, re.MULTILINE)
    if done.returncode != 1 or found is None:
        raise RuntimeError(done.stdout[-2000:] + done.stderr[-2000:])
    return found[1]


def environment(tree: Path) -> dict[str, str]:
    """Return variables with which the copy is imported, not what is installed."""
    return {**os.environ, "PYTHONPATH": str(tree / "src"), "PYTHONDONTWRITEBYTECODE": "1"}


def check_that_the_copy_is_tested(tree: Path) -> None:
    """Raise if another package than the copy would be imported."""
    line = [sys.executable, "-c", "import napari_phase4d; print(napari_phase4d.__file__)"]
    done = subprocess.run(
        line, cwd=tree, env=environment(tree), capture_output=True, text=True, check=True
    )
    place = Path(done.stdout.strip()).resolve()
    if not place.is_relative_to(tree.resolve()):
        msg = f"the tests would import {place}, which is not the copy in {tree}"
        raise RuntimeError(msg)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
