"""What malloc of glibc is told; others have no such functions."""

import ctypes

# Constants from malloc.h.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4


def keep_freed_memory() -> None:
    """Let malloc reuse the memory of large tensors. By default each is mapped and unmapped at every step, and page
    faults take a quarter of the CPU time."""
    if hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(M_MMAP_MAX, 0)
        libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)


def return_freed_memory() -> None:
    """Give back what is free. Threads have heaps of their own, in which a large picture leaves 200 MB."""
    if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)
