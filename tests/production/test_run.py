"""Runs: whatever is killed, full or broken, the same bytes are there in the end."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from threading import Thread

import psutil
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.write import Shard
from synth3dlanes.production import local, workers
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import make_sample
from synth3dlanes.production.run import generate
from synth3dlanes.production.workers import Limits, Worker
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import ClaimedError, DiskFullError, InputError, MissingPackageError
from synth3dlanes.system.files import Draft
from tests import fake_samples
from tests.thorough import first

N = 23


def plan(out: Path, n: int = N, workers: int = 1, maker=fake_samples.make, **changes) -> Plan:
    return Plan(out, n, fake_samples.recipe(), workers=workers, shard_size=10, maker=maker, **changes)


def go(a_plan: Plan):
    events = []
    return generate(a_plan, events.append), events


def contents(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((out / "train").glob("[0-9]*"))}


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """The files of an uninterrupted run with one worker."""
    out = tmp_path_factory.mktemp("whole")
    report, _ = go(plan(out, workers=1))
    assert (report.exit_code, report.made, report.done) == (0, N, N)
    assert list(contents(out)) == [f"{i:05d}.{suffix}" for i in range(3) for suffix in ("parquet", "tar")]
    return contents(out)


def shard_0(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if name.startswith("00000.")}


@pytest.mark.fresh
def test_workers_leave_no_trace(tmp_path, whole):
    report, events = go(plan(tmp_path, workers=2))
    assert report.exit_code == 0
    assert contents(tmp_path) == whole
    assert [sample.key for sample in Reader(str(tmp_path / "train"))] == [f"{i:08d}" for i in range(N)]
    assert sum(event.kind == "sample" for event in events) == N
    (log,) = (tmp_path / "logs").iterdir()
    assert [json.loads(line)["kind"] for line in log.read_text().splitlines()] == [event.kind for event in events]


def test_running_again_does_nothing_and_a_larger_n_extends(tmp_path, whole):
    for n, made, done in [(4, 4, 4), (12, 8, 12), (5, 0, 5), (N, 11, N), (N, 0, N)]:
        report, _ = go(plan(tmp_path, n))
        assert (report.made, report.done, report.exit_code) == (made, done, 0)
    assert contents(tmp_path) == whole


def test_a_run_waits_for_workers_only_while_they_have_tasks(tmp_path, monkeypatch):
    """A pool without tasks sleeps, and the run would end so much later than its last shard."""
    wait, n_busy = workers.Pool.wait, []

    def note_and_wait(pool, seconds):
        n_busy.append(pool.busy)
        return wait(pool, seconds)

    monkeypatch.setattr(workers.Pool, "wait", note_and_wait)
    assert go(plan(tmp_path))[0].exit_code == 0
    assert min(n_busy) > 0


def test_an_empty_folder_that_a_killed_join_left_goes(tmp_path, whole):
    go(plan(tmp_path))
    (tmp_path / "train" / "00001.parts").mkdir()
    report, _ = go(plan(tmp_path))
    assert (report.made, report.exit_code) == (0, 0)
    assert contents(tmp_path) == whole


def test_parts_are_disjoint_and_make_the_whole(tmp_path, whole):
    made = []
    for part in (1, 2):
        out = tmp_path / str(part)
        report, _ = go(plan(out, part=(part, 2)))
        made.append(set(contents(out)))
        assert report.done == report.asked == report.made
        shutil.copytree(out, tmp_path / "joined", dirs_exist_ok=True)
    assert not made[0] & made[1]
    assert contents(tmp_path / "joined") == whole
    report, _ = go(plan(tmp_path / "joined"))
    assert (report.made, report.done) == (0, N)


def test_a_worker_whose_run_is_gone_makes_nothing():
    """One that was started a moment before its run was killed: its death signal comes too late."""
    ours, theirs = Pipe()
    command = [sys.executable, "-P", workers.__file__, str(theirs.fileno()), "-1"]
    # Nobody is process 2**22: Linux has none above.
    process = subprocess.Popen(command, pass_fds=[theirs.fileno()], env={**os.environ, workers.PARENT: str(1 << 22)})
    assert process.wait(30) == 1
    ours.close()


@pytest.mark.parametrize("number", first(1, [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
def test_a_signal_stops_in_order_within_seconds(tmp_path, whole, number):
    command = [sys.executable, "-m", "tests.fake_samples", str(tmp_path), str(N), "2"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert next(line for line in process.stdout if "kind='sample'" in line)
    start = time.monotonic()
    process.send_signal(number)
    rest = process.communicate()[0]
    assert time.monotonic() - start < 30
    assert process.returncode == 128 + number
    assert "interrupted" in rest.splitlines()[-1]
    assert not [path for name in ("*.tmp", "*.run") for path in (tmp_path / "train").rglob(name)]
    report, _ = go(plan(tmp_path))
    assert report.made < N
    assert contents(tmp_path) == whole


@pytest.mark.fresh
@pytest.mark.parametrize(
    ("maker", "limits", "reasons"),
    first(
        1,
        [
            (fake_samples.make_what_no_reader_takes, Limits(), {3: "camera.height_px: expected"}),
            (fake_samples.fail_to_draw_bad, Limits(), {3: "cars.n: no room for this scene"}),
            (fake_samples.crash_on_bad, Limits(), {3: "worker ended with 1"}),
            (
                fake_samples.hang_on_bad_and_spin_on_the_next,
                Limits(seconds=2.5),
                {3: "no progress for 2.5 s", 4: "no end after 2.5 s of CPU time"},
            ),
            (fake_samples.eat_memory_on_bad, Limits(rss_bytes=1 << 30), {3: "more than 1024 MiB of memory"}),
        ],
    ),
)
def test_a_bad_scene_is_set_aside_and_blocks_nothing(tmp_path, whole, maker, limits, reasons):
    report, events = go(plan(tmp_path, workers=2, maker=maker, limits=limits))
    assert (report.exit_code, report.set_aside, report.done) == (1, tuple(reasons), N - len(reasons))
    restarts = [event for event in events if event.kind == "restart"]
    # A scene that cannot be drawn is tried once, in a worker that goes on, and has no file.
    is_drawn = maker is not fake_samples.fail_to_draw_bad
    assert sorted(event.details["index"] for event in restarts) == sorted([*reasons] * 3 * is_drawn)
    told = [event for event in events if event.kind == "set_aside"]
    assert all(reasons[event.details["index"]] in event.message for event in [*restarts, *told])
    folder = tmp_path / "failed" / "train" / "00000003"
    assert not is_drawn or json.loads((folder / "scene.json").read_text())["index"] == 3
    assert is_drawn or (folder / "stderr.txt").read_text() == f"{reasons[3]}\n"
    assert (
        maker is not fake_samples.crash_on_bad or "ValueError: this scene is bad" in (folder / "stderr.txt").read_text()
    )
    assert [s.key for s in Reader(str(tmp_path / "train"))] == [f"{i:08d}" for i in range(N) if i not in reasons]
    # Once the fault is mended, running again fills the gap.
    report, _ = go(plan(tmp_path))
    assert (report.exit_code, report.made) == (0, len(reasons))
    assert contents(tmp_path) == whole
    assert not folder.exists()


@pytest.mark.parametrize(
    ("cpu_share", "reasons"),
    [(0.0, {"no progress for 100 s"}), (0.05, {""}), (1.0, {"", "no end after 100 s of CPU time"})],
)
def test_a_worker_that_gets_little_of_a_busy_machine_is_waited_for(tmp_path, monkeypatch, cpu_share, reasons):
    """Five minutes, in which it gets nothing, a twentieth of a core, or a whole one."""
    now_s = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    monkeypatch.setattr(Worker, "cpu_s", property(lambda self: cpu_share * now_s))
    process = subprocess.Popen(["true"])
    process.wait()
    worker, found = Worker(process, Pipe()[0], tmp_path), set()
    worker.begin("task")
    while now_s < 300:
        now_s += 1
        found.add(worker.endless(100.0))
    assert found == reasons | {""}


@pytest.mark.fresh
def test_a_machine_at_fault_stops_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(local, "MAX_IN_A_ROW", 2)
    monkeypatch.setattr(local, "MAX_FAILURES", 1)
    report, _ = go(plan(tmp_path, n=1000, maker=fake_samples.always_crash))
    assert report.exit_code == 1
    last_words = "worker ended with 1: ValueError: no scene is good"
    assert report.problem.startswith(f"2 scenes in a row failed, the last with: {last_words}")
    report, _ = go(plan(tmp_path, n=1000, maker=fake_samples.miss_a_library))
    assert report.problem.startswith("ImportError: libmissing.so.1: cannot open shared object file; install the")


@pytest.mark.thorough
@pytest.mark.fresh
def test_workers_are_recycled_and_pinned(tmp_path, whole):
    pids = set()

    def look(event):
        pids.update(worker.pid for worker in psutil.Process().children())

    a_plan = plan(tmp_path, 10, workers=2, maker=fake_samples.insist_on_one_core, limits=Limits(tasks=3))
    assert generate(a_plan, look).exit_code == 0
    assert len(pids) >= 4
    assert contents(tmp_path) == shard_0(whole)


def test_waits_for_room_and_goes_on(tmp_path, whole, monkeypatch):
    usage = namedtuple("usage", "total used free")
    free = [10**12]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**12, 0, free[0]))
    seen = []

    def tell(event):
        seen.append(event.kind)
        if event.kind == "sample" and event.done == 5:
            free[0] = 10**6
        if event.kind == "pause":
            free[0] = 10**12

    assert generate(plan(tmp_path, workers=2), tell).exit_code == 0
    assert seen.index("pause") < seen.index("resume")
    assert contents(tmp_path) == whole
    free[0] = 10**6
    with pytest.raises(DiskFullError, match=r"77 samples need .* MB, but only 1 MB are free"):
        go(plan(tmp_path, n=100))


@pytest.mark.thorough
def test_waits_for_room_for_a_folder_and_for_a_join(tmp_path, whole, monkeypatch):
    full, opened, appear, seen = iter([True]), Shard.open, Draft.appear, []
    full_join = iter([True, True])

    def open_shard(shard):
        if next(full, False):
            raise OSError(errno.ENOSPC, "No space left on device")
        opened(shard)

    def appear_or_not(draft):
        if draft.path.name.startswith(".00001.tar.") and next(full_join, False):
            raise OSError(errno.EDQUOT, "Disk quota exceeded")
        appear(draft)

    monkeypatch.setattr(Shard, "open", open_shard)
    monkeypatch.setattr(Draft, "appear", appear_or_not)
    assert generate(plan(tmp_path, workers=2), lambda event: seen.append(event.kind)).exit_code == 0
    assert seen.count("pause") == seen.count("resume") == 3
    assert contents(tmp_path) == whole


@pytest.mark.thorough
@pytest.mark.fresh
def test_a_second_run_of_the_same_process_is_refused(tmp_path, whole):
    """POSIX's locks are those of a process. Other shards are free to both, and a run that ends takes no lock of another
    with it."""
    problems = []

    def tell(event):
        if event.kind == "sample" and event.done == 1:
            other = Thread(target=try_it, args=((1, 1), (2, 2)))
            other.start()
            other.join()

    def try_it(*parts):
        for part in parts:
            try:
                problems.append(go(plan(tmp_path, part=part))[0].exit_code)
            except ClaimedError as error:
                problems.append(str(error))
        command = [sys.executable, "-m", "tests.fake_samples", str(tmp_path), str(N), "1"]
        problems.append(subprocess.run(command, capture_output=True, text=True).stderr.splitlines()[-1])

    assert generate(plan(tmp_path, part=(1, 2)), tell).exit_code == 0
    refused = f"out {tmp_path}: shard 0 is locked by another run"
    assert problems == [refused, 0, f"synth3dlanes.system.errors.ClaimedError: {refused}"]
    assert contents(tmp_path) == whole


def test_another_recipe_is_named_and_nothing_advised_before_anything_is_read(tmp_path):
    go(plan(tmp_path, n=4))
    before = contents(tmp_path)
    deep = replace(fake_samples.recipe(), settings=RenderSettings(passes=("depth",)))
    other = replace(plan(tmp_path, n=4), recipe=deep)
    for ask in (other.expected, lambda: go(other)):
        with pytest.raises(InputError) as caught:
            ask()
        line = f'{tmp_path}/dataset.json: render.passes: expected [] as in this dataset, got ["depth"]'
        assert caught.value.problems == (line,)
    assert contents(tmp_path) == before


def test_what_killed_writers_left_in_a_folder_goes_when_it_is_claimed(tmp_path, whole):
    tmp_path.joinpath("train").mkdir()
    left = [f".{name}.0123456789abcdef.tmp" for name in ("dataset.json", "README.md", "croissant.json", "room")]
    for name in left:
        (tmp_path / name).write_text("half")
    (tmp_path / ".mine.tmp").write_text("whole")
    go(plan(tmp_path))
    assert {name for name in os.listdir(tmp_path) if name.endswith(".tmp")} == {".mine.tmp"}
    assert contents(tmp_path) == whole


def test_a_python_without_blender_is_told_which_one(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"Python 3\.11 .*pip install 'bpy==4\.5\.\*'"):
        generate(replace(plan(tmp_path), maker=make_sample), print)
    assert not list(tmp_path.iterdir())
