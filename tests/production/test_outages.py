"""Stores that go away: what is finished is kept on this machine, waited with, and put when the store is back."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import s3fs

from synth3dlanes.dataset import patience
from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.spool import SPOOL, spool_of, spooled
from synth3dlanes.dataset.write import Shard
from synth3dlanes.production import local
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples, soak, store_server

N = 10


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with store_server.server(tmp_path_factory.mktemp("server") / "log") as environment:
        yield environment


@pytest.fixture
def gate(server: dict[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[store_server.Gate]:
    """The way to the store `s3://lanes`, open."""
    gate = store_server.Gate(int(server["AWS_ENDPOINT_URL"].rpartition(":")[2]))
    quick = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{gate.port}",
        "AWS_MAX_ATTEMPTS": "1",
        SPOOL: str(tmp_path / "spool"),
    }
    monkeypatch.setattr(patience, "FIRST_PAUSE_S", 0.1)
    with store_server.seen_by_clients({**server, **quick}):
        gate.open()
        yield gate
        gate.close()


def plan(url: str, n: int = N, **changes) -> Plan:
    return Plan(url, n, fake_samples.recipe(), **{"workers": 1, "shard_size": 4, "maker": fake_samples.make, **changes})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("whole")
    assert generate(plan(str(out)), lambda _: None).exit_code == 0
    return soak.files(out)


def files_at(url: str) -> dict[str, bytes]:
    """The shards of a store."""
    return store_server.contents(f"{url.removeprefix('s3://')}/train")


def kept(url: str) -> list[int]:
    return spooled(url, "train", recipe_text(plan(url).description()))


def test_an_outage_is_waited_for_and_nothing_is_lost(gate: store_server.Gate, whole: dict[str, bytes]) -> None:
    url, events = "s3://lanes/waited", []
    assert generate(plan(url, 3), lambda _: None).made == 3

    def tell(event) -> None:
        events.append(event)
        if event.kind == "sample" and event.done == 6:
            gate.close()
        if event.kind == "pause":
            gate.open()

    report = generate(plan(url), tell)
    assert (report.exit_code, report.made, report.done, report.problem) == (0, N - 3, N, "")
    assert [event.done for event in events if event.kind == "sample"] == list(range(4, N + 1))
    assert files_at(url) == whole
    (pause,) = (event.message for event in events if event.kind == "pause")
    assert pause.startswith(url)
    assert "waiting for the store since" in pause
    assert "at most 30 min" in pause
    assert str(spool_of(url, recipe_text(plan(url).description()))) in pause
    assert sum(event.kind == "resume" for event in events) == 1
    assert kept(url) == []
    # A shard without its index is not there: whatever stopped its upload, it is made again.
    store, shard = s3fs.S3FileSystem(use_listings_cache=False, skip_instance_cache=True), "lanes/waited/train/00001"
    store.rm_file(f"{shard}.parquet")
    store.pipe_file(f"{shard}.tar", b"half a tar")
    assert [generate(plan(url), lambda _: None).made for _ in range(2)] == [4, 0]
    assert files_at(url) == whole


@pytest.mark.thorough
@pytest.mark.parametrize("stopped", [False, True], ids=["gone for ever", "Ctrl-C"])
def test_what_an_outage_leaves_here_is_put_by_the_next_run(
    gate: store_server.Gate, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, stopped: bool
) -> None:
    url, told = f"s3://lanes/{'stopped' if stopped else 'gone'}", []
    if not stopped:
        monkeypatch.setattr(local, "LIMIT_S", 0.5)

    def tell(event) -> None:
        told.append(event.message)
        if event.kind == "sample" and event.done == 6:
            gate.close()
        if event.kind == "pause" and stopped and "waiting" in event.message:
            os.kill(os.getpid(), signal.SIGINT)

    start = time.monotonic()
    report = generate(plan(url), tell)
    assert time.monotonic() - start < 120, "far less than the patience of half an hour"
    assert report.exit_code == (130 if stopped else 1)
    assert report.done == 4
    line = next(one for one in told if "put by the next run" in one) if stopped else report.problem
    assert "\n" not in line
    assert str(spool_of(url, recipe_text(plan(url).description()))) in line
    assert kept(url) == [1]
    gate.open()
    events: list = []
    # A run of another part puts them too.
    again = generate(plan(url, part=(1, 3)), events.append)
    assert (again.exit_code, again.made) == (0, 0)
    assert any("finished samples of an earlier run" in event.message for event in events)
    assert kept(url) == []
    assert generate(plan(url), lambda _: None).made == N - report.made
    assert files_at(url) == whole


@pytest.mark.thorough
def test_a_killed_run_loses_no_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SPOOL, str(tmp_path / "spool"))
    url = (tmp_path / "store").as_uri()
    command = [sys.executable, "-m", "tests.fake_samples", url, "10", "1"]
    run = subprocess.Popen(command, cwd=soak.ROOT, stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    made = 0
    while made < 4:
        made += "kind='sample'" in next(run.stdout)
    run.kill()
    run.communicate()
    report = generate(plan(url, shard_size=10), lambda _: None)
    assert report.exit_code == 0
    assert report.made <= 10 - made
    assert soak.files(tmp_path / "store") == soak.undisturbed(tmp_path / "whole", 10)
    assert not [path for path in (tmp_path / "spool").rglob("*") if path.is_file()]


RECIPE = fake_samples.recipe()
SHARD = Shard(Path("train"), 0, 8, RECIPE.names)


def fill(shard: Shard, indices: range) -> None:
    for index in indices:
        shard.write_part(index, fake_samples.make(RECIPE, index).members)
    shard.join(8)


def test_machines_that_have_parts_of_one_shard_put_all_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, folder = Destination((tmp_path / "store").as_uri()), Destination(tmp_path / "folder")
    (tmp_path / "folder/train").mkdir(parents=True)
    with folder.working_copy(SHARD) as here:
        fill(here, range(6))
    monkeypatch.setenv(SPOOL, str(tmp_path / "one"))
    with store.working_copy(SHARD) as here:
        fill(here, range(4))
        monkeypatch.setenv(SPOOL, str(tmp_path / "other"))
        with store.working_copy(SHARD) as there:
            fill(there, range(2, 6))
    assert soak.files(tmp_path / "store") == soak.files(tmp_path / "folder")
    # One that has fewer takes nothing away.
    monkeypatch.setenv(SPOOL, str(tmp_path / "third"))
    with store.working_copy(SHARD) as here:
        here.path("parquet").unlink()
        here.path("tar").unlink()
        fill(here, range(1))
    assert soak.files(tmp_path / "store") == soak.files(tmp_path / "folder")


def test_two_runs_on_one_machine_have_a_shard_each_and_what_one_leaves_the_next_takes_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SPOOL, str(tmp_path / "spool"))
    store = Destination((tmp_path / "store").as_uri())
    with suppress(KeyboardInterrupt), store.working_copy(SHARD) as first, store.working_copy(SHARD) as second:
        assert first.folder != second.folder
        fill(first, range(2))
        fill(second, range(2, 4))
        assert spooled(store.place, "train", "") == []
        raise KeyboardInterrupt
    assert spooled(store.place, "train", "") == [0]
    with store.working_copy(SHARD) as here:
        assert here.missing(8) == [4, 5, 6, 7]
        here.join(8)
    with store.working_copy(SHARD) as here:
        assert here.joined() == set(range(4))
    assert not [path for path in (tmp_path / "spool").rglob("*") if path.is_file()]
