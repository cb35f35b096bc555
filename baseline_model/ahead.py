"""Work of a thread ahead of the one that uses it: reading, the network and drawing go on beside each other."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

T = TypeVar("T")
ImageProgress = Callable[[int, int | None], None]
"""Gets how many are done, and how many there are, None if that is not known."""


def told(items: Iterable[T], total: int | None, progress: ImageProgress | None) -> Iterator[T]:
    """The items; `progress` gets how many were taken, and how many there are in all."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(done, total)


def ahead(items: Iterable[T], n: int = 1) -> Iterator[T]:
    """The same items, of which a thread makes up to `n` before they are asked for. An error is raised where its item
    would come."""
    end, rest = object(), iter(items)
    with ThreadPoolExecutor(1) as thread:
        made = deque(thread.submit(next, rest, end) for _ in range(n))
        try:
            while (item := made.popleft().result()) is not end:
                made.append(thread.submit(next, rest, end))
                yield cast(T, item)
        finally:
            for waiting in made:
                waiting.cancel()
