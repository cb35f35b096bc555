"""Kill and kill again (production/test_soak.py, and with more kills `make soak`): the bytes are those of no kill.

Samples are fake ones, which take 0.15 s; everything around them is real. SIGKILL meets workers and whole runs at
random moments; with Ray, one of two nodes as well.
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from synth3dlanes.dataset.read import Reader
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

ROOT = Path(__file__).parents[1]
# Without the mode, a node asks for a token where one lies in the home folder, as other uses of Ray may leave it.
RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), **RAY}
START_S = 400.0


def undisturbed(out: Path, n: int) -> dict[str, bytes]:
    """The files of a run that nobody disturbed."""
    plan = Plan(out, n, fake_samples.recipe(), workers=1, shard_size=10, maker=fake_samples.make)
    assert generate(plan, lambda _: None).exit_code == 0
    return files(out)


def files(out: Path) -> dict[str, bytes]:
    """Everything in the split's folder by its path, hidden files apart."""
    folder = out / "train"
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def soak(out: Path, n: int, kills: int, seed: int, cluster: "Cluster | None" = None) -> int:
    """Kill `kills` workers and runs while they make `n` samples, and let the last run finish; return the kills.

    Half way a node of the cluster dies, and another takes its place.
    """
    rng = np.random.default_rng(seed)
    command = [sys.executable, "-m", "tests.fake_samples", str(out), str(n), "1" if cluster else "2"]
    command += [cluster.address] if cluster else []
    done, restarts = 0, 0
    while True:
        assert restarts < kills + 10, "the runs end, but not the work"
        restarts += 1
        run = subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while done < kills and run.poll() is None:
            time.sleep(rng.uniform(0.05, 1.0))
            workers = pool_workers(cluster.processes() if cluster else [psutil.Process(run.pid)])
            is_run = rng.random() < 0.15
            victims = [psutil.Process(run.pid)] if is_run else list(rng.permutation(workers)[:1])
            for victim in victims:
                with suppress(psutil.NoSuchProcess):
                    victim.kill()
                    done += 1
            if cluster and not cluster.has_lost_node and done >= kills // 2:
                cluster.lose_node()
                done += 1
        stderr = run.communicate()[1].decode()
        if run.returncode == 0 and done >= kills:
            return done
        assert run.returncode in (0, -9), stderr
        if run.returncode == 0:
            raise AssertionError(f"all samples were made after {done} kills: take more than {n}")


def pool_workers(roots: list[psutil.Process]) -> list[psutil.Process]:
    """The worker processes of our pools below these processes."""
    found = []
    for root in roots:
        with suppress(psutil.Error):
            for process in root.children(recursive=True):
                with suppress(psutil.Error):
                    if any(part.endswith("production/workers.py") for part in process.cmdline()):
                        found.append(process)
    return found


@dataclass
class Cluster:
    """Ray nodes on this machine, by default with a core each, by `ray start`."""

    folder: Path
    port: int
    nodes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    has_lost_node: bool = False

    @property
    def address(self) -> str:
        """What `--address` takes."""
        return f"127.0.0.1:{self.port}"

    def add_node(self, cores: int = 1) -> None:
        """Start a node and wait until it is there; the first is the head."""
        where = ["--head", f"--port={self.port}", f"--temp-dir={self.folder}", "--include-dashboard=false"]
        command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", f"--num-cpus={cores}"]
        command += ["--object-store-memory=80000000", "--disable-usage-stats"]
        command += [f"--address={self.address}"] if self.nodes else where
        log = self.folder / f"node-{len(self.nodes)}.log"
        with log.open("wb") as stream:
            self.nodes.append(
                subprocess.Popen(command, env=ENVIRONMENT, stdout=stream, stderr=stream, start_new_session=True)
            )
        until = time.monotonic() + START_S
        while "Ray runtime started" not in log.read_text():
            assert time.monotonic() < until, log.read_text()
            time.sleep(0.2)

    def processes(self) -> list[psutil.Process]:
        """The nodes' first processes."""
        return [psutil.Process(node.pid) for node in self.nodes if node.poll() is None]

    def lose_node(self) -> None:
        """SIGKILL all of the second node, as a power cut would, and start a third."""
        kill_tree(self.nodes[1])
        self.has_lost_node = True
        self.add_node()


@contextmanager
def cluster(n_nodes: int = 2) -> Iterator[Cluster]:
    """A cluster at a free port, whose nodes are killed at the end."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # Ray's sockets need a short path.
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        found = Cluster(Path(folder), port)
        try:
            for _ in range(n_nodes):
                found.add_node()
            yield found
        finally:
            for node in reversed(found.nodes):
                kill_tree(node)


def kill_tree(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL a process and all below it."""
    with suppress(psutil.NoSuchProcess):
        root = psutil.Process(process.pid)
        for member in [*root.children(recursive=True), root]:
            with suppress(psutil.NoSuchProcess):
                member.kill()
    process.wait()


def check(out: Path, n: int, expected: dict[str, bytes]) -> None:
    """Exactly n samples, in order, in the same bytes, and nothing beside them."""
    assert [sample.key for sample in Reader(str(out / "train"))] == [f"{i:08d}" for i in range(n)]
    assert files(out) == expected
