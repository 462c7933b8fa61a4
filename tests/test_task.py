"""Threads that work on items in order, and stop."""

from __future__ import annotations

import threading
import time

import pytest

from napari_phase4d.task import THREADS, Cancelled, Task, Watch, in_threads


def test_results_come_in_order_and_are_counted() -> None:
    seen: list[tuple[int, int]] = []
    watch = Watch(300, "work", Task(lambda done, total, _: seen.append((done, total)), None))
    found = list(in_threads(lambda i: i * i, range(300), watch))
    assert found == [i * i for i in range(300)]
    assert seen == [(i + 1, 300) for i in range(300)]


def test_nothing_to_do() -> None:
    assert list(in_threads(lambda i: i, [], Watch(0, "work"))) == []


def test_what_was_done_before_an_error_is_not_lost() -> None:
    def work(i: int) -> int:
        if i == 45:
            msg = "the 46th"
            raise ValueError(msg)
        return i

    found = []
    with pytest.raises(ValueError, match="the 46th"):
        for result in in_threads(work, range(100), Watch(100, "work")):
            found.append(result)  # noqa: PERF402 - what came before the error is to be kept
    assert found == list(range(45))


def test_threads_end_soon_after_quick_items_became_slow() -> None:
    asked = threading.Event()
    threading.Timer(0.5, asked.set).start()

    def work(i: int) -> None:
        time.sleep(0 if i < 200 else 0.3)

    began = time.monotonic()
    with pytest.raises(Cancelled):
        for _ in in_threads(work, range(400), Watch(400, "work", Task(None, asked.is_set))):
            pass
    assert time.monotonic() - began < 1
    for thread in threading.enumerate():
        if thread.name.startswith(THREADS):
            thread.join()
    assert time.monotonic() - began < 1.5
