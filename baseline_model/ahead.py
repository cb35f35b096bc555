"""Work of a thread ahead of the one that uses it: reading, the network and drawing go on beside each other."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

T = TypeVar("T")


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
