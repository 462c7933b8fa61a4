"""Damages small files of every format at random and counts what reading them leads to.

    python benchmarks/fuzz.py --seconds 300 --seed 0

Each file is opened as a recording, as the input of a run and, where its name allows that, as a
result of this program, and frames are read, in a process with bounded time and memory. Opening it
well and refusing it in one sentence are both right; anything else is listed with what makes the
file again:

    python benchmarks/fuzz.py --seed 0 --only "HDF5" --case 17 --keep /tmp/broken
"""

from __future__ import annotations

import argparse
import json
import select
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from damaging import mutated
from faulty import (
    FORMATS,
    RESULTS,
    outcome_as_input,
    outcome_as_result,
    outcome_of,
    sound,
)

KINDS = FORMATS | RESULTS

#: What a process may take beyond what it has after reading sound files.
MORE_BYTES = 1 << 30
#: A file that takes longer is a hang.
MOST_SECONDS = 20.0
#: A process is replaced after so many files, so that what it keeps can't add up unseen.
FILES_A_PROCESS = 500
RIGHT = ("fine", "sentence")

Tree = dict[str, bytes]


def tree_of(path: Path) -> Tree:
    """Return a file, or all files of a folder, by their places in it."""
    if path.is_file():
        return {"": path.read_bytes()}
    return {
        str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()
    }


def write_tree(tree: Tree, path: Path) -> None:
    for place, data in tree.items():
        there = path / place if place else path
        there.parent.mkdir(parents=True, exist_ok=True)
        there.write_bytes(data)


class Worker:
    """A process that reads files until it is ended.

    Parameters
    ----------
    folder : Path
        Where sound files lie, which it reads before its memory is bounded.
    """

    def __init__(self, folder: Path) -> None:
        line = [sys.executable, __file__, "--work", str(folder)]
        self.process = subprocess.Popen(
            line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.files = 0
        self._answer(120)

    def outcome(self, path: Path, place: float) -> str:
        """Return what reading a file led to; the process may not survive it."""
        self.files += 1
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([str(path), place]) + "\n")
        self.process.stdin.flush()
        return self._answer(MOST_SECONDS)

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def _answer(self, seconds: float) -> str:
        ready, _, _ = select.select([self.process.stdout], [], [], seconds)
        if not ready:
            self.end()
            return f"hang: more than {seconds:g} s"
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if line:
            return str(json.loads(line))
        _, errors = self.process.communicate()
        return f"crash: ended with {self.process.returncode}: {' '.join(errors.split())[-300:]}"


def work(folder: Path) -> None:
    """Answer for one file a line."""
    import resource

    warnings.simplefilter("ignore")  # what libraries murmur is no outcome
    for path in sorted(folder.iterdir()):
        worst_outcome(next(path.iterdir()), 0)
    status = Path("/proc/self/statm")
    used = int(status.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MORE_BYTES, used + MORE_BYTES))
    answers = sys.stdout
    sys.stdout = sys.stderr
    print(json.dumps("ready"), file=answers, flush=True)
    for line in sys.stdin:
        path, place = json.loads(line)
        print(json.dumps(worst_outcome(Path(path), place)), file=answers, flush=True)


def worst_outcome(path: Path, place: float) -> str:
    """Return what reading a file led to, in the way that went worst.

    It is read as a recording, as the input of a run, and as a result of this program.
    """
    ways = {
        "": outcome_of(path, (0, 1, place)),
        "as input, ": outcome_as_input(path),
        "as result, ": outcome_as_result(path),
    }
    if path.suffix not in (".tif", ".zarr"):
        del ways["as result, "]
    for way, outcome in ways.items():
        if outcome not in RIGHT:
            return way + outcome
    return "fine" if "fine" in ways.values() else "sentence"


def broken(trees: dict[str, Tree], name: str, seed: int, case: int) -> tuple[str, Tree, float]:
    """Return a damaged copy of a format's file, the kind of damage, and a frame to read."""
    names = list(KINDS)
    rng = np.random.default_rng([seed, names.index(name), case])
    tree = dict(trees[name])
    place = str(rng.choice(list(tree)))
    other = trees[str(rng.choice(names))]
    kind, tree[place] = mutated(tree[place], rng, next(iter(other.values())))
    return kind, tree, float(rng.random())


def cases(only: str | None, case: int | None) -> Iterator[tuple[str, int]]:
    """Yield formats and numbers, all formats in turn."""
    names = [only] if only else list(KINDS)
    if case is not None:
        yield names[0], case
        return
    number = 0
    while True:
        yield from ((name, number) for name in names)
        number += 1


def table(counts: dict[str, Counter[str]]) -> str:
    """Return the counts of each format and of all, as Markdown."""
    total: Counter[str] = Counter()
    for count in counts.values():
        total += count
    lines = ["| format | files | fine | one sentence | anything else |", "|---|---|---|---|---|"]
    for name, count in {**counts, "all": total}.items():
        right = [count[r] for r in RIGHT]
        files = count.total()
        lines.append(f"| {name} | {files} | {right[0]} | {right[1]} | {files - sum(right)} |")
    return "\n".join(lines)


def run(options: argparse.Namespace, folder: Path) -> int:
    """Fuzz until time is up; print the table; return how many files went wrong."""
    trees: dict[str, Tree] = {}
    for number, name in enumerate(KINDS):
        place = folder / "sound" / f"{number:03d}"
        place.mkdir(parents=True)
        trees[name] = tree_of(sound(name, place))
    counts: dict[str, Counter[str]] = {name: Counter() for name in trees}
    worker, wrong = Worker(folder / "sound"), 0
    end = time.monotonic() + options.seconds
    for name, case in cases(options.only, options.case):
        if time.monotonic() > end:
            break
        kind, tree, place = broken(trees, name, options.seed, case)
        path = folder / f"broken{KINDS[name][0]}"
        write_tree(tree, path)
        if not worker.alive or worker.files >= FILES_A_PROCESS:
            worker.end()
            worker = Worker(folder / "sound")
        outcome = worker.outcome(path, place)
        counts[name][outcome if outcome in RIGHT else "wrong"] += 1
        if outcome not in RIGHT or options.case is not None:
            wrong += outcome not in RIGHT
            print(f'--only "{name}" --case {case} ({kind}): {outcome}', flush=True)
            keep(path, options.keep, f"{name} {case}")
        remove(path)
    worker.end()
    print(table(counts))
    return wrong


def keep(path: Path, folder: Path | None, name: str) -> None:
    """Copy a broken file where it can be looked at."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        copy: Any = shutil.copytree if path.is_dir() else shutil.copy
        copy(path, folder / f"{name}{path.suffix}")


def remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(KINDS), help="one format")
    parser.add_argument("--case", type=int, help="one file of that format")
    parser.add_argument("--keep", type=Path, help="folder for files that went wrong")
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work is not None:
        work(options.work)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        return int(run(options, Path(folder)) > 0)


if __name__ == "__main__":
    sys.exit(main())
