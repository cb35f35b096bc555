"""Ray clusters that lose what a run leans on, or have no room for it; addresses without a cluster."""

import importlib.util
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from synth3dlanes.errors import InputError, OutageError
from tests import soak

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")

N = 40
# A run as `synth3dlanes generate --json` prints it: stdout holds the report alone.
RUN = """
import json, sys
from dataclasses import asdict
from pathlib import Path
from synth3dlanes.production import cluster, plan, run
from tests import fake_samples
cluster.LOST_AFTER_S, cluster.LOOK_EVERY_S = 5.0, 1.0
out, n, workers, address = sys.argv[1:]
a_plan = plan.Plan(out, int(n), fake_samples.recipe(), int(workers), shard_size=10, maker=fake_samples.make_slowly)
def tell(event):
    print(event.kind, event.message, file=sys.stderr, flush=True)
report = run.generate(a_plan, tell, "ray", address)
print(json.dumps(asdict(report) | {"exit_code": report.exit_code}))
"""


def begin(out: Path, address: str, workers: int = 1) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, str(out), str(N), str(workers), address]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=soak.ROOT, env=soak.ENVIRONMENT, text=True, **pipes)


def wait_for(process: subprocess.Popen[str], word: str) -> str:
    assert process.stderr is not None
    told = []
    for line in process.stderr:
        told.append(line)
        if word in line:
            return line
    raise AssertionError("".join(told))


def processes(cluster: soak.Cluster, word: str) -> list[psutil.Process]:
    """Those of the cluster whose command has this word."""
    below = [child for root in cluster.processes() for child in root.children(recursive=True)]
    return [process for process in below if word in " ".join(process.cmdline())]


@pytest.fixture(scope="module")
def cluster() -> Iterator[soak.Cluster]:
    with soak.cluster(6397, n_nodes=1) as found:
        yield found


def test_a_run_goes_on_without_the_actor_that_tells_of_progress_and_past_a_killed_task(
    cluster: soak.Cluster, tmp_path: Path
) -> None:
    run = begin(tmp_path, cluster.address)
    wait_for(run, "sample ")
    (board,) = processes(cluster, "ray::Board")
    board.kill()
    wait_for(run, "sample ")
    for task in processes(cluster, "ray::make_shard"):
        task.kill()
    stdout, stderr = run.communicate()
    report = json.loads(stdout)
    assert (report["exit_code"], report["done"], report["problem"]) == (0, N, ""), stderr
    assert "Traceback" not in stderr
    soak.check(tmp_path, N, soak.undisturbed(tmp_path / "whole", N))


def test_a_run_without_room_says_what_it_waits_for_and_goes_on_when_a_node_comes(
    cluster: soak.Cluster, tmp_path: Path
) -> None:
    run = begin(tmp_path, cluster.address, workers=2)
    line = wait_for(run, "pause ")
    assert "waiting since" in line
    assert "for 2 cores free on one node (--workers); its nodes (1) have 1 cores; 1 cores are free" in line
    cluster.add_node(cores=2)
    wait_for(run, "resume ")
    run.kill()
    run.communicate()


def test_a_cluster_that_is_lost_ends_the_run_in_a_line_and_another_goes_on(tmp_path: Path) -> None:
    with soak.cluster(6399, n_nodes=1) as cluster:
        run = begin(tmp_path, cluster.address)
        wait_for(run, "sample ")
        (store,) = processes(cluster, "gcs_server")
        store.kill()
        stdout, stderr = run.communicate(timeout=90)
    report = json.loads(stdout)
    assert run.returncode == 0, stderr
    assert report["exit_code"] == 1
    assert report["problem"].startswith("the Ray cluster is lost: its control store at ")
    assert 0 < report["done"] < N
    assert "Traceback" not in stderr


@pytest.mark.parametrize("address", ["nonsense", "", ":6379", "nonsense:x", "nobody.invalid:6379"])
def test_what_is_no_address_of_a_cluster_is_named(address: str) -> None:
    from synth3dlanes.production.cluster import connected

    with pytest.raises(InputError, match=r"^address: "), connected(address):
        pass


def test_an_address_without_a_cluster_is_named_within_half_a_minute() -> None:
    from synth3dlanes.production.cluster import connected

    def reject(address: str, kind: type[Exception], reason: str) -> None:
        start = time.monotonic()
        told = rf"^address: cannot connect to a Ray cluster at {address}: {reason}"
        with pytest.raises(kind, match=told), connected(address):
            pass
        assert time.monotonic() - start < 30

    with socket.create_server(("127.0.0.1", 0)) as silent:
        reject(f"127.0.0.1:{silent.getsockname()[1]}", InputError, "no answer within 20 s")
    reject("127.0.0.1:9", OutageError, "Connection refused")
