"""Random numbers by name: whatever is drawn for a scene has a stream of its own, and moves nothing else."""

import hashlib

import numpy as np


def stream(seed: int, split: str, index: int, name: str) -> np.random.Generator:
    """The random numbers of one group of parameters of one scene, independent of every other group and scene."""
    digest = hashlib.sha256(f"{seed}/{split}/{index}/{name}".encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))
