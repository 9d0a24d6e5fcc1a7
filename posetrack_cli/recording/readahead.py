"""Read frames in a thread, a few ahead of whoever uses them."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

FRAMES_AHEAD = 4
JOIN_SECONDS = 5.0


@dataclass(frozen=True)
class _End:
    """The last item in the queue: how reading ended."""

    error: BaseException | None


class _Reader(Generic[T]):
    """A thread that moves items from an iterator into a bounded queue."""

    def __init__(self, items: Iterator[T], ahead: int) -> None:
        self.queue: queue.Queue[T | _End] = queue.Queue(maxsize=ahead)
        self._items = items
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread: it finishes the item at hand at most.

        After the queue is emptied the thread puts at most one more item, so it cannot block again.
        """
        self._stopped.set()
        self._make_room()
        self._thread.join(JOIN_SECONDS)

    def _make_room(self) -> None:
        """Empty the queue, so that a thread blocked on a full one goes on and sees that it is to stop."""
        while True:
            try:
                self.queue.get_nowait()
            except queue.Empty:
                return

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._items:
                self.queue.put(item)
                if self._stopped.is_set():
                    break
        except BaseException as caught:  # handed to the consumer, whatever it is
            error = caught
        finally:
            self._close_items()
        if not self._stopped.is_set():
            self.queue.put(_End(error))

    def _close_items(self) -> None:
        close = getattr(self._items, "close", None)
        if close is not None:
            close()  # in this thread: a generator that holds files closes them now


def read_ahead(items: Iterator[T], ahead: int = FRAMES_AHEAD) -> Generator[T]:
    """Yield the items of an iterator that runs in a thread, at most ``ahead`` + 1 items in front.

    An exception of the iterator is raised here, after the items before it. Closing the generator, or
    an exception such as KeyboardInterrupt while it waits, stops the thread.
    """
    reader = _Reader(items, ahead)
    try:
        while True:
            item = reader.queue.get()
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                return
            yield item
    finally:
        reader.stop()
