"""One file after the other."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import typer
from rich.markup import escape

from napari_phase4d.cli.console import console, errors
from napari_phase4d.cli.printing import bar
from napari_phase4d.pipeline import Recipe, run_batch

__all__ = ["batch", "stoppable"]

#: What a shell gives for a program that Ctrl-C has ended.
STOPPED_BY_USER = 130


def batch(recipe: Recipe, files: Sequence[Path], out: Path, **options: Any) -> None:
    """Work on each file, see `run_batch`; of several, one that fails does not stop the others.

    Raises
    ------
    ValueError
        If any failed.
    """
    with bar() as progress:
        table = run_batch(recipe, files, out, progress=progress, told=tell, **options)
    console.print(f"The summary is in [bold]{(out / 'summary.csv').resolve()}[/bold]")
    failed = table[table["status"] == "failed"]
    if len(failed):
        names = ", ".join(Path(file).name for file in failed["file"])
        msg = f"{len(failed)} of {len(table)} files failed: {names}"
        raise ValueError(msg)


def tell(line: str) -> None:
    """Print a line of the log."""
    console.print(escape(line))


class ToldToEndError(KeyboardInterrupt):
    """The system wishes this program to end.

    It is not `KeyboardInterrupt` itself, after which Python may end with a code of its own.
    """


@contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C, and the wish of the system to end, stop the work with one sentence."""
    came: list[int] = []

    def stop(number: int, _: object) -> None:
        came.append(number)
        raise ToldToEndError

    before = listening(stop)
    try:
        yield
    except KeyboardInterrupt:
        by = signal.Signals(came[0]).name if came else "Ctrl-C"
        errors.print(f"Stopped by {by}. What is written is whole; --resume goes on with a batch.")
        raise typer.Exit(128 + came[0] if came else STOPPED_BY_USER) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def listening(stop: Callable[[int, object], None]) -> dict[int, Any]:
    """Let the system's wishes to end call a function; return what they did before.

    What is ignored stays so, as under nohup; outside of the main thread nothing is listened to.
    """
    before: dict[int, Any] = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is None or signal.getsignal(number) is signal.SIG_IGN:
            continue
        with suppress(ValueError):  # not in the main thread
            before[number] = signal.signal(number, stop)
    return before
