"""Where `synth3dlanes` starts: it has its standard streams, and Ctrl-C or too little memory end it in one line even
while its commands are still being imported."""

import os
import resource
import signal
import sys
from io import TextIOWrapper
from typing import NoReturn

NO_MEMORY = "not enough memory; close other programs, raise the limit (ulimit -v), or use fewer workers"
# `sample` takes 400 MB on two cores. With less, OpenBLAS aborts the process or waits for ever for its threads.
LEAST_BYTES = 1 << 29
# Messages of errors for lack of memory other than MemoryError: of Python's threads, torch on CPUs and GPUs, the linker.
WORDS = ("can't start new thread", "DefaultCPUAllocator", "CUDA out of memory", "Cannot allocate memory", "map segment")


def run() -> None:
    """Import the commands and run the one that is asked for."""
    open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # Names of files may be of any bytes.
            stream.reconfigure(errors="backslashreplace")
    bound = resource.getrlimit(resource.RLIMIT_AS)[0]
    if bound != resource.RLIM_INFINITY and bound < LEAST_BYTES:
        _leave(f"expected an address space of at least {LEAST_BYTES >> 10} KiB (ulimit -v), got {bound >> 10}", 1)
    # Matrices are small here: threads of algebra would wait for each other longer than they work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from .main import run as start
    except KeyboardInterrupt:
        _leave("interrupted", 128 + signal.SIGINT)
    except (MemoryError, RuntimeError, ImportError) as error:
        if not is_lack_of_memory(error):
            raise
        _leave(NO_MEMORY, 1)
    start()


def open_closed_streams() -> None:
    """Let standard streams that the caller closed (`2>&-`) be the null device, or the next files would be in their
    place."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            stream = open(os.devnull, mode)  # noqa: SIM115
            if stream.fileno() != number:
                os.dup2(stream.fileno(), number)
                stream = open(number, mode)  # noqa: SIM115
            setattr(sys, name, stream)


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error says that there is no memory, or no room for another thread."""
    return isinstance(error, MemoryError) or any(words in str(error) for words in WORDS)


def _leave(why: str, code: int) -> NoReturn:
    sys.stderr.write(f"synth3dlanes: {why}\n")
    sys.exit(code)
