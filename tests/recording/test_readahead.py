"""Reading ahead: order, bound, errors and an end to the thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from posetrack_cli.recording.recording import read_ahead


def reader_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "read-ahead"]


def wait_until(condition: object, seconds: float = 2.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:  # type: ignore[operator]
        time.sleep(0.005)


def test_items_come_in_order() -> None:
    assert list(read_ahead(iter(range(100)))) == list(range(100))
    assert list(read_ahead(iter(()))) == []
    assert reader_threads() == []


def test_only_a_few_items_are_read_ahead() -> None:
    made: list[int] = []

    def source() -> Iterator[int]:
        for number in range(1000):
            made.append(number)
            yield number

    items = read_ahead(source(), ahead=4)
    assert next(items) == 0
    wait_until(lambda: len(made) >= 6)
    time.sleep(0.05)
    assert len(made) == 6, "one used, four in the queue, one in the thread's hand"
    items.close()  # type: ignore[attr-defined]


def test_closing_stops_the_thread_and_closes_the_source() -> None:
    closed = threading.Event()

    def source() -> Iterator[int]:
        try:
            yield from range(1_000_000)
        finally:
            closed.set()

    items = read_ahead(source(), ahead=1)
    next(items)
    begin = time.monotonic()
    items.close()  # type: ignore[attr-defined]
    assert time.monotonic() - begin < 1.0
    assert closed.is_set()
    assert reader_threads() == []


def test_error_comes_after_the_items_before_it() -> None:
    def source() -> Iterator[int]:
        yield 1
        yield 2
        raise OSError("disk")

    items = read_ahead(source())
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(OSError, match="disk"):
        next(items)
    assert reader_threads() == []


def test_interrupt_in_the_consumer_leaves_no_thread() -> None:
    def consume() -> None:
        for number in read_ahead(iter(range(1_000_000))):
            if number == 3:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        consume()
    wait_until(lambda: not reader_threads())
    assert reader_threads() == []


def test_stopping_many_times_never_hangs() -> None:
    for used in range(50):
        items = read_ahead(iter(range(60)), ahead=1 + used % 3)
        for _ in range(used):
            next(items)
        items.close()  # type: ignore[attr-defined]
    assert reader_threads() == []
