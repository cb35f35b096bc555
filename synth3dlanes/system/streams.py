"""Named random streams: each group of draws of a scene has its own stream, so a new draw changes no other."""

import hashlib
from collections.abc import Callable

import numpy as np

# A function from a stream's name to its random generator.
Streams = Callable[[str], np.random.Generator]


def stream(seed: int, split: str, index: int, name: str) -> np.random.Generator:
    """The random generator of one named stream of one scene, independent of all other streams and scenes."""
    digest = hashlib.sha256(f"{seed}/{split}/{index}/{name}".encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))
