"""Killed at random moments, full, forbidden, broken: the same bytes in the end (tests/soak.py; longer: `make soak`)."""

import errno
import importlib.util
import itertools
import os
import shutil
import signal
import subprocess
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from synth3dlanes.dataset import write
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.system.errors import InputError
from tests import fake_samples, soak
from tests.thorough import first

KILLS = int(os.environ.get("SYNTH3DLANES_TEST_KILLS", "5"))
N = 20 + 8 * KILLS
needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount file systems")


def plan(out: str | Path, n: int = N, **changes) -> Plan:
    changes = {"workers": 1, "maker": fake_samples.make, **changes}
    return Plan(out, n, fake_samples.recipe(), shard_size=10, **changes)


def go(a_plan: Plan):
    return generate(a_plan, lambda _: None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    return soak.undisturbed(tmp_path_factory.mktemp("whole"), N)


@pytest.mark.thorough
@pytest.mark.timeout(120 * KILLS)
def test_kills_on_this_machine(tmp_path, whole):
    assert soak.soak(tmp_path / "out", N, KILLS, seed=1) == KILLS
    soak.check(tmp_path / "out", N, whole)


@needs_ray
@pytest.mark.slow
@pytest.mark.timeout(180 * KILLS)
def test_kills_and_a_lost_node_on_ray(tmp_path, whole):
    with soak.cluster() as cluster:
        assert soak.soak(tmp_path / "out", N, KILLS, 2, cluster) >= KILLS
        soak.check(tmp_path / "out", N, whole)


@contextmanager
def small_disk(folder: Path, size: str, n_files: int = 0):
    folder.mkdir()
    options = f"size={size}" + f",nr_inodes={n_files}" * bool(n_files)
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@needs_root
@pytest.mark.parametrize(("size", "n_files", "piece"), first(1, [("8M", 0, 4096), ("64M", 100, 0)]))
def test_a_full_disk_makes_the_run_wait_and_nothing_is_lost(tmp_path, whole, size, n_files, piece):
    """Full of bytes; or of files, while bytes are free all the time."""
    told = []
    with small_disk(tmp_path / "disk", size, n_files) as disk:
        ballast = disk / "ballast"

        def tell(event):
            told.append(event)
            if event.kind == "sample" and event.done == 8:
                ballast.mkdir()
                with suppress(OSError):
                    for number in itertools.count():
                        (ballast / str(number)).write_bytes(bytes(piece))
            if event.kind == "pause":
                assert piece or shutil.disk_usage(disk).free > 60 << 20
                shutil.rmtree(ballast, ignore_errors=True)

        report = generate(plan(disk / "out", 20, workers=2), tell)
        assert report.exit_code == 0
        pauses = [event.message for event in told if event.kind == "pause"]
        assert len(pauses) == sum(event.kind == "resume" for event in told) > 0
        assert all("waiting for" in message and str(disk) in message for message in pauses)
        shards = ("00000.parquet", "00000.tar", "00001.parquet", "00001.tar")
        assert soak.files(disk / "out") == {name: whole[name] for name in shards}


@pytest.mark.thorough
@pytest.mark.parametrize("number", first(1, [errno.EDQUOT, errno.ENOSPC]))
def test_a_quota_that_is_used_up_makes_the_run_wait_until_it_can_write(tmp_path, whole, monkeypatch, number):
    """Workers cannot write, nor can this process, while there is a ballast; the file system counts free bytes."""
    monkeypatch.setenv("SYNTH3DLANES_TEST_MARK", str(tmp_path))
    monkeypatch.setenv("SYNTH3DLANES_TEST_ERRNO", str(number))
    ballast, told, tries, fsync = tmp_path / "ballast", [], [], os.fsync
    ballast.touch()

    def sync(descriptor):
        if "/.room." in os.readlink(f"/proc/self/fd/{descriptor}"):
            tries.append(ballast.exists())
            if len(tries) == 2:
                ballast.unlink()
            if tries[-1]:
                raise OSError(number, os.strerror(number))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", sync)
    report = generate(
        plan(tmp_path / "out", 10, workers=2, maker=fake_samples.find_the_disk_full),
        lambda event: told.append(event.kind),
    )
    assert report.exit_code == 0
    assert tries == [True, True, False]
    assert told.count("pause") == told.count("resume") == 1
    assert soak.files(tmp_path / "out") == {name: whole[name] for name in ("00000.parquet", "00000.tar")}
    assert not list((tmp_path / "out").glob(".room*"))


@pytest.mark.thorough
@needs_root
@pytest.mark.timeout(60)
def test_a_worker_that_tells_late_of_a_full_disk_does_not_make_the_run_wait_again(tmp_path, monkeypatch):
    told = []
    with small_disk(tmp_path / "disk", "8M") as disk:
        monkeypatch.setenv("SYNTH3DLANES_TEST_MARK", str(disk))
        ballast = disk / "ballast"
        ballast.write_bytes(bytes(2 << 20))

        def tell(event):
            told.append(event.kind)
            if event.kind == "pause":
                ballast.unlink()

        report = generate(plan(disk / "out", 4, workers=2, maker=fake_samples.find_the_disk_full), tell)
    assert report.exit_code == 0
    assert told.count("pause") == told.count("resume") == 1


@needs_root
def test_a_read_only_folder_is_named(tmp_path):
    with small_disk(tmp_path / "disk", "8M") as folder:
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        with pytest.raises(InputError, match=f"out {folder}/out: cannot write to this folder: .*Read-only"):
            go(plan(folder / "out", 10))


@pytest.mark.thorough
def test_a_store_keeps_what_an_interrupted_run_has_made(tmp_path):
    url = f"file://{tmp_path}/store"
    a_plan = plan(url, 10, maker=fake_samples.make_slowly)

    def tell(event):
        if event.kind == "sample" and event.done == 3:
            os.kill(os.getpid(), signal.SIGINT)

    stopped = generate(a_plan, tell)
    assert stopped.exit_code == 130
    assert 3 <= stopped.done < 10
    assert len(a_plan.missing()[0]) == 10 - stopped.done
    again = go(a_plan)
    assert (again.exit_code, again.made) == (0, 10 - stopped.done)
    with pytest.raises(InputError, match="image_format"):
        go(replace(a_plan, recipe=fake_samples.recipe(image_format="jpg")))


@pytest.mark.parametrize("moment", ["while samples are made", "during a join"])
def test_a_vanished_folder_is_named_and_comes_back(tmp_path, whole, monkeypatch, moment):
    """It goes at once: a tree that is removed file by file meets files that workers add."""
    out, read = tmp_path / "out", write.read_bounded

    def vanish():
        if out.exists():
            out.rename(tmp_path / "moved")

    def tell(event):
        if moment == "while samples are made" and event.kind == "sample" and event.done == 25:
            vanish()

    def read_and_vanish(path, n_bytes):
        data = read(path, n_bytes)
        if path.suffix == ".parquet":
            vanish()
        return data

    if moment == "during a join":
        monkeypatch.setattr(write, "read_bounded", read_and_vanish)
    report = generate(plan(out), tell)
    assert report.exit_code == 1
    assert report.problem == f"{out}: the folder is gone"
    monkeypatch.undo()
    shutil.rmtree(out, ignore_errors=True)
    (tmp_path / "moved").rename(out)
    assert go(plan(out)).exit_code == 0
    soak.check(out, N, whole)
