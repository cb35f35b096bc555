"""Runs on a Ray cluster: the same bytes, counts and log as on one machine, in a folder and in a store; what becomes of
a run when the cluster loses what it leans on, or has no room for it; addresses without a cluster."""

import importlib.util
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.system.errors import InputError, MissingPackageError, OutageError
from tests import fake_samples, soak

N, MORE = 12, 40

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")

# A run as `synth3dlanes generate --json` prints it: stdout holds the report alone.
RUN = """
import json, sys
from dataclasses import asdict
from pathlib import Path
from synth3dlanes.production import cluster, plan, run
from tests import fake_samples
out, n, workers, address, lost_after_s = sys.argv[1:]
cluster.LOST_AFTER_S, cluster.LOOK_EVERY_S, cluster.HEALTH_S = float(lost_after_s), 1.0, 120.0
a_plan = plan.Plan(out, int(n), fake_samples.recipe(), int(workers), shard_size=10, maker=fake_samples.make_slowly)
def tell(event):
    print(event.kind, event.message, file=sys.stderr, flush=True)
report = run.generate(a_plan, tell, "ray", address)
print(json.dumps(asdict(report) | {"exit_code": report.exit_code}))
"""


def begin_telling(
    out: Path, address: str, n: int = MORE, workers: int = 1, lost_after_s: int = 60
) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, str(out), str(n), str(workers), address, str(lost_after_s)]
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
    """Those of the cluster that run and whose command has this word."""
    found = []
    for root in cluster.processes():
        for process in root.children(recursive=True):
            # A process that has just ended has no command.
            with suppress(psutil.NoSuchProcess):
                if word in " ".join(process.cmdline()):
                    found.append(process)
    return found


@pytest.fixture(scope="module")
def cluster() -> Iterator[soak.Cluster]:
    with soak.cluster(n_nodes=1) as found:
        yield found


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    return soak.undisturbed(tmp_path_factory.mktemp("whole"), N)


def begin(out: str, n: int, cluster: soak.Cluster) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.fake_samples", out, str(n), "1", cluster.address]
    return subprocess.Popen(
        command, cwd=soak.ROOT, env=soak.ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finish(process: subprocess.Popen[str]) -> list[str]:
    """What the run told, a line for each event."""
    told, errors = process.communicate()
    assert process.returncode == 0, errors
    return told.splitlines()


def log_of(folder: Path) -> list[dict]:
    """The events of the newest log."""
    newest = max((folder / "logs").iterdir(), key=lambda path: path.stat().st_mtime)
    return [json.loads(line) for line in newest.read_text().splitlines()]


@pytest.mark.thorough
def test_a_store_is_made_and_continued_on_a_cluster(tmp_path, whole, cluster):
    url = tmp_path.as_uri()
    for n in (5, N):
        told = finish(begin(url, n, cluster))
    soak.check(tmp_path, N, whole)
    assert {path.name for path in tmp_path.iterdir()} == {
        "README.md",
        "croissant.json",
        "dataset.json",
        "logs",
        "train",
    }
    assert len(list((tmp_path / "logs").iterdir())) == 2
    events = log_of(tmp_path)
    assert len(events) == len(told)
    assert [event["kind"] for event in events if event["kind"] in ("start", "end")] == ["start", "end"]
    assert {event["index"] for event in (e["details"] for e in events if e["kind"] == "sample")} == set(range(5, N))
    assert (events[-1]["done"], events[-1]["asked"]) == (N, N)
    # A shard without its index is not there: whatever stopped its upload, it is made again.
    (tmp_path / "train" / "00001.parquet").unlink()
    (tmp_path / "train" / "00001.tar").write_bytes(b"half a tar")
    finish(begin(url, N, cluster))
    soak.check(tmp_path, N, whole)


@pytest.mark.thorough
def test_a_second_run_in_the_folder_is_refused(tmp_path, cluster):
    # Many samples, and stopped in their midst: it holds the folder however long the second takes to begin.
    first = begin(str(tmp_path), 100 * N, cluster)
    assert next(line for line in first.stdout if "kind='sample'" in line)
    first.send_signal(signal.SIGSTOP)
    second = begin(str(tmp_path), 100 * N, cluster)
    _, errors = second.communicate()
    first.kill()
    first.communicate()
    assert second.returncode != 0
    assert "is locked by another run" in errors


def test_a_python_without_ray_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "synth3dlanes.production.ray", raising=False)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingPackageError, match=r"Ray is not installed: pip install '\.\[cluster\]' in"):
        generate(Plan(tmp_path, 1, fake_samples.recipe(), maker=fake_samples.make), print, "ray")


@pytest.mark.thorough
def test_a_run_goes_on_without_the_actor_that_tells_of_progress_and_past_a_killed_task(
    cluster: soak.Cluster, tmp_path: Path
) -> None:
    run = begin_telling(tmp_path / "out", cluster.address)
    wait_for(run, "sample ")
    (board,) = processes(cluster, "ray::Board")
    board.kill()
    wait_for(run, "sample ")
    for task in processes(cluster, "ray::make_shard"):
        with suppress(psutil.NoSuchProcess):
            task.kill()
    stdout, stderr = run.communicate()
    report = json.loads(stdout)
    assert (report["exit_code"], report["done"], report["problem"]) == (0, MORE, ""), stderr
    assert "Traceback" not in stderr
    soak.check(tmp_path / "out", MORE, soak.undisturbed(tmp_path / "whole", MORE))


@pytest.mark.thorough
def test_a_run_without_room_says_what_it_waits_for_and_goes_on_when_a_node_comes(
    cluster: soak.Cluster, tmp_path: Path
) -> None:
    run = begin_telling(tmp_path, cluster.address, workers=2)
    line = wait_for(run, "pause ")
    assert "waiting since" in line
    assert "for 2 cores free on one node (--workers); its nodes (1) have 1 cores; 1 cores are free" in line
    cluster.add_node(cores=2)
    wait_for(run, "resume ")
    run.kill()
    run.communicate()


@pytest.mark.parametrize("address", ["nonsense", "", ":6379", "nonsense:x", "nobody.invalid:6379"])
def test_what_is_no_address_of_a_cluster_is_named(address: str) -> None:
    from synth3dlanes.production.cluster import connected

    with pytest.raises(InputError, match=r"^address: "), connected(address):
        pass


def test_an_address_without_a_cluster_is_named_within_half_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    from synth3dlanes.production import cluster as clusters

    assert clusters.CONNECT_S + clusters.HEALTH_S < 30
    monkeypatch.setattr(clusters, "HEALTH_S", 2.0)

    def reject(address: str, kind: type[Exception], reason: str) -> None:
        told = rf"^address: cannot connect to a Ray cluster at {address}: {reason}"
        with pytest.raises(kind, match=told), clusters.connected(address):
            pass

    with socket.create_server(("127.0.0.1", 0)) as silent:
        reject(f"127.0.0.1:{silent.getsockname()[1]}", InputError, "no answer within 2 s")
    reject("127.0.0.1:9", OutageError, "Connection refused")

    def finds_none(**_: object) -> None:
        raise ConnectionError("Could not find any running Ray instance")

    # The cluster of another test may run on this machine.
    monkeypatch.setattr(clusters, "_check", lambda address: None)
    monkeypatch.setattr(clusters.ray, "init", finds_none)
    reject("auto", OutageError, "Could not find any running Ray instance")


@pytest.mark.thorough
def test_a_cluster_that_is_lost_ends_the_run_in_a_line_and_another_goes_on(
    cluster: soak.Cluster, tmp_path: Path
) -> None:
    """The last one here: it takes the cluster from the others."""
    # Two minutes of samples: a node goes on without its control store, and must not end before the loss is told.
    n = 20 * MORE
    run = begin_telling(tmp_path, cluster.address, n, lost_after_s=10)
    wait_for(run, "sample ")
    (store,) = processes(cluster, "gcs_server")
    store.kill()
    stdout, stderr = run.communicate(timeout=240)
    report = json.loads(stdout)
    assert run.returncode == 0, stderr
    assert report["exit_code"] == 1
    assert report["problem"].startswith("the Ray cluster is lost: its control store at ")
    assert 0 < report["done"] < n
    assert "Traceback" not in stderr
