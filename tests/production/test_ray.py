"""Runs on a Ray cluster: the same bytes, counts and log as on one machine, in a folder and in a store."""

import importlib.util
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import fake_samples, soak

N = 12

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")


@pytest.fixture(scope="module")
def address():
    with soak.cluster(6395, n_nodes=1) as cluster:
        yield cluster.address


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    return soak.undisturbed(tmp_path_factory.mktemp("whole"), N)


def begin(out: str, n: int, address: str = "") -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.fake_samples", out, str(n), "1", *([address] if address else [])]
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


def test_a_cluster_goes_on_where_one_machine_has_stopped(tmp_path, whole, address):
    finish(begin(str(tmp_path), 5))
    told = finish(begin(str(tmp_path), N, address))
    assert sum("kind='sample'" in line for line in told) == N - 5
    assert "complete" in told[-1]
    soak.check(tmp_path, N, whole)


def test_a_store_is_made_and_continued_on_a_cluster(tmp_path, whole, address):
    url = tmp_path.as_uri()
    for n in (5, N):
        told = finish(begin(url, n, address))
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
    finish(begin(url, N, address))
    soak.check(tmp_path, N, whole)


def test_a_second_run_in_the_folder_is_refused(tmp_path, address):
    # Many samples, and stopped in their midst: it holds the folder however long the second takes to begin.
    first = begin(str(tmp_path), 100 * N, address)
    assert next(line for line in first.stdout if "kind='sample'" in line)
    first.send_signal(signal.SIGSTOP)
    second = begin(str(tmp_path), 100 * N, address)
    _, errors = second.communicate()
    first.kill()
    first.communicate()
    assert second.returncode != 0
    assert "is locked by another run" in errors


def test_a_python_without_ray_is_told_what_to_install(tmp_path, monkeypatch):
    from synth3dlanes.errors import MissingPackageError
    from synth3dlanes.production.plan import Plan
    from synth3dlanes.production.run import generate

    monkeypatch.delitem(sys.modules, "synth3dlanes.production.ray", raising=False)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingPackageError, match=r"Ray is not installed: pip install 'synth3dlanes\[cluster\]'"):
        generate(Plan(tmp_path, 1, fake_samples.recipe(), maker=fake_samples.make), print, "ray")
