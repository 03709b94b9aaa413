"""A bounded queue between two threads that never holds up the one that fills it."""

from __future__ import annotations

import threading
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

Content = TypeVar("Content")


class Mailbox(Generic[Content]):
    """Lists of items in their order; when full, new items are dropped and counted.

    Orders are never dropped: there are few of them, and each comes from a person.

    Args:
        limit: Lists that may wait.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._queue: SimpleQueue[list[Content]] = SimpleQueue()
        self._lock = threading.Lock()
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Items that were dropped since the beginning."""
        return self._dropped

    @property
    def waiting(self) -> int:
        """Lists that wait now."""
        return self._queue.qsize()

    def offer(self, items: list[Content]) -> bool:
        """Put items at the end, unless the queue is full.

        Returns:
            Whether there was room.
        """
        if self._queue.qsize() < self._limit:
            self._queue.put(items)
            return True
        with self._lock:
            self._dropped += len(items)
        return False

    def order(self, item: Content) -> None:
        """Put one item at the end, full or not."""
        self._queue.put([item])

    def take(self, timeout_s: float) -> list[Content]:
        """Everything that waits; nothing if nothing comes in time.

        Args:
            timeout_s: Longest wait [s].
        """
        items: list[Content] = []
        try:
            items = list(self._queue.get(timeout=timeout_s))
            for _ in range(self._limit):
                items += self._queue.get_nowait()
        except Empty:
            pass
        return items
