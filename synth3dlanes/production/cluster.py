"""A Ray cluster, seen from the process that drives a run: whether it answers, what it has, and when it is lost."""

import io
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from threading import current_thread
from typing import TextIO, TypeVar

import ray

from synth3dlanes.dataset.patience import attempt, since
from synth3dlanes.system.errors import InputError, OutageError

CONNECT_S, HEALTH_S, SHUTDOWN_S = 5.0, 20.0, 10.0
LOOK_EVERY_S = 5.0
# Ray ends processes that have not seen their control store for a minute.
LOST_AFTER_S = 30.0


Answer = TypeVar("Answer")


@contextmanager
def connected(address: str) -> Iterator[None]:
    """Connect this process to the cluster at `address` for the duration of the block. Ray's output goes to stderr.

    Raises InputError if something else is there, OutageError if its machine does not answer or none has been started.
    """
    _check(address)
    with redirect_stdout(_OwnOutput(sys.stdout)):
        try:
            with redirect_stdout(sys.stderr):
                ray.init(address=address, log_to_driver=False, logging_level="error")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise _refusal(address)(_no_cluster(address, str(error))) from None
        try:
            yield
        finally:
            until = time.monotonic() + SHUTDOWN_S
            # Without a control store this would take a minute.
            with redirect_stdout(sys.stderr), suppress(OutageError):
                attempt("Ray", ray.shutdown, lambda: time.monotonic() > until)


class Cluster:
    """The cluster that this process is part of."""

    def __init__(self) -> None:
        self._address: str = ray.get_runtime_context().gcs_address
        self._looked = self._seen = time.monotonic()

    def lost(self) -> str:
        """A problem text if the control store has not answered for long, else ""."""
        now = time.monotonic()
        if now - self._looked < LOOK_EVERY_S:
            return ""
        self._looked = now
        if not _connection_problem(self._address):
            self._seen = now
        if now - self._seen < LOST_AFTER_S:
            return ""
        return f"the Ray cluster is lost: its control store at {self._address} has not answered {since(self._seen)}"

    def uses(self, n_cores: int) -> bool:
        """Whether at least `n_cores` cores are in use, by anyone, or this is not known."""
        found = _asked(lambda: (ray.cluster_resources(), ray.available_resources()))
        return found is None or found[0].get("CPU", 0) - found[1].get("CPU", 0) >= n_cores

    def text(self) -> str:
        """The nodes and the free cores, as text."""
        found = _asked(lambda: (ray.nodes(), ray.available_resources()))
        if found is None:
            return "the cluster does not say what it has"
        nodes, free = [node["Resources"] for node in found[0] if node["Alive"]], found[1]
        cores = ", ".join(f"{node.get('CPU', 0):.0f}" for node in nodes)
        n_gpus = sum(node.get("GPU", 0) for node in nodes)
        gpus = f", and {free.get('GPU', 0):.0f} of {n_gpus:.0f} GPUs" if n_gpus else ""
        return f"its nodes ({len(nodes)}) have {cores} cores; {free.get('CPU', 0):.0f} cores{gpus} are free"


def _asked(question: Callable[[], Answer]) -> Answer | None:
    """The answer of the control store, None if it does not answer."""
    until = time.monotonic() + CONNECT_S
    try:
        return attempt("Ray", question, lambda: time.monotonic() > until)
    except (OutageError, ConnectionError, ray.exceptions.RayError):
        return None


class _OwnOutput(io.TextIOBase):
    """A stdout that only the thread that made it writes to. What other threads, which are Ray's, print goes to
    stderr."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._thread = stream, current_thread()

    def write(self, text: str) -> int:
        return self._of_thread().write(text)

    def flush(self) -> None:
        self._of_thread().flush()

    def fileno(self) -> int:
        return self._stream.fileno()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def _of_thread(self) -> TextIO:
        return self._stream if current_thread() is self._thread else sys.stderr


def _check(address: str) -> None:
    """Raise InputError or OutageError within half a minute if no cluster answers."""
    if address == "local":
        return
    place = address.removeprefix("ray://")
    host, _, port = place.rpartition(":")
    if address != "auto":
        if not (host and port.isdecimal()):
            raise InputError(f"address: expected auto or HOST:PORT of a Ray cluster, got {address!r}")
        try:
            problem = _connection_problem(place)
        except OSError as error:
            raise InputError(_no_cluster(address, str(error.strerror or error))) from None
        if problem:
            raise OutageError(_no_cluster(address, problem))
    if not address.startswith("ray://"):
        where = [] if address == "auto" else ["--address", address]
        command = [sys.executable, "-m", "ray.scripts.scripts", "health-check", *where]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=HEALTH_S, env=os.environ, check=False
            )
        except subprocess.TimeoutExpired:
            raise _refusal(address)(_no_cluster(address, f"no answer within {HEALTH_S:.0f} s")) from None
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["it is not healthy"])[-1]
            raise _refusal(address)(_no_cluster(address, last))


def _connection_problem(place: str) -> str:
    """Why nothing answers at HOST:PORT, or "" if something does. Raises OSError for an unknown host."""
    host, _, port = place.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECT_S):
            return ""
    except socket.gaierror:
        raise
    except OSError as error:
        return str(error.strerror or error)


def _refusal(address: str) -> type[InputError | OutageError]:
    """What it means that no cluster is at an address: without one, it has still to be started."""
    return OutageError if address == "auto" else InputError


def _no_cluster(address: str, reason: str) -> str:
    return f"address: cannot connect to a Ray cluster at {address}: {reason}"
