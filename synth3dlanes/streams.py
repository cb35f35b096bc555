"""Random numbers by name: whatever is drawn for a scene has a stream of its own, and moves nothing else."""

import hashlib
from collections.abc import Callable

import numpy as np

# From the name of what is drawn to its random numbers.
Streams = Callable[[str], np.random.Generator]


def stream(seed: int, split: str, index: int, name: str) -> np.random.Generator:
    """The random numbers of one group of parameters of one scene, independent of every other group and scene."""
    digest = hashlib.sha256(f"{seed}/{split}/{index}/{name}".encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))
