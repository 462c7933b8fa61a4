"""Threads that work on items in order, and stop."""

from __future__ import annotations

import threading
import time

import pytest

from napari_phase4d.task import Cancelled, Task, Watch, in_threads
from napari_phase4d.unwrapping import SharedSteps


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


@pytest.mark.slow
def test_threads_end_soon_after_quick_items_became_slow(threads_end) -> None:
    asked = threading.Event()
    threading.Timer(0.5, asked.set).start()

    def work(i: int) -> None:
        time.sleep(0 if i < 200 else 0.3)

    began = time.monotonic()
    with pytest.raises(Cancelled):
        for _ in in_threads(work, range(400), Watch(400, "work", Task(None, asked.is_set))):
            pass
    assert time.monotonic() - began < 1
    threads_end()
    assert time.monotonic() - began < 1.5


def test_what_several_threads_ask_for_is_computed_once() -> None:
    steps, calls = SharedSteps(), []

    def work() -> int:
        time.sleep(0.05)
        calls.append("work")
        # Threads of its own may ask for something else meanwhile.
        return sum(in_threads(lambda _: steps.once("other", lambda: 2), range(4), Watch(4, "")))

    found = list(in_threads(lambda _: steps.once("name", work), range(8), Watch(8, "")))
    assert found == [8] * 8
    assert calls == ["work"]


def test_after_an_error_it_is_tried_again() -> None:
    steps, tried = SharedSteps(), []

    def work() -> int:
        tried.append(len(tried))
        return 1 // tried[-1]

    with pytest.raises(ZeroDivisionError):
        steps.once("name", work)
    assert not steps.knows("name")
    assert [steps.once("name", work) for _ in range(3)] == [1, 1, 1]
    assert tried == [0, 1]


def test_what_is_forgotten_while_somebody_asks_is_there_for_him() -> None:
    steps, over = SharedSteps(), threading.Event()

    def forget() -> None:
        while not over.is_set():
            steps.forget("name")

    forgetting = threading.Thread(target=forget)
    forgetting.start()
    try:
        assert [steps.once("name", lambda: 4) for _ in range(20_000)] == [4] * 20_000
    finally:
        over.set()
        forgetting.join()
