"""What a training leaves behind where a write fails, where it is killed, and where two write into one folder."""

import errno
import json
import multiprocessing
import os
import shutil
from fractions import Fraction

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from synth3dlanes_baseline import checkpoint, progress, train
from synth3dlanes_cli.main import main

from synth3dlanes.system import files
from synth3dlanes.system.errors import ClaimedError
from tests.baseline import roads
from tests.thorough import first

CALLS = ("fsync", "replace", "open")
ERRORS = (errno.ENOSPC, errno.EIO, errno.EROFS)
COMMAND = ("train", "DATA", "--model", "tiny", "--set", "workers=0", "--batch", "2", "--device", "cpu", "--out", "run")


@pytest.fixture(scope="module")
def samples():
    return roads.samples(np.random.default_rng(0), 4, (160, 120))


@pytest.fixture
def run(samples, monkeypatch, in_tmp_path):
    """The command, on drawn samples, up to an epoch; every step is written to the history."""
    monkeypatch.setattr(train, "_splits", lambda config, dirs: (samples, samples))
    monkeypatch.setattr(progress, "WRITE_EVERY_S", -1.0)
    return lambda epochs: CliRunner().invoke(main, [*COMMAND, "--epochs", str(epochs)])


class Disk:
    """Counts the calls by which files of ours are written; one of them fails, a write after half of its bytes."""

    def __init__(self, monkeypatch, fails=None, code=0):
        self.calls, self.fails, self.code = [], fails, code
        self.write = files._File.write
        monkeypatch.setattr(files._File, "write", lambda stream, data: self.written(stream, data))
        for name in CALLS:
            monkeypatch.setattr(files.os, name, self.counted(name, getattr(os, name)))

    def written(self, stream, data):
        self.calls.append(stream._path.name)
        if len(self.calls) - 1 == self.fails:
            self.write(stream, bytes(data)[: len(data) // 2])
            raise OSError(self.code, os.strerror(self.code), str(stream._path))
        return self.write(stream, data)

    def counted(self, name, call):
        def counting(*arguments, **options):
            is_ours = name != "open" or arguments[1] & os.O_CREAT
            if is_ours:
                self.calls.append(name)
            if is_ours and len(self.calls) - 1 == self.fails:
                raise OSError(self.code, os.strerror(self.code), str(arguments[0]))
            return call(*arguments, **options)

        return counting


def steps(folder, kind="step"):
    lines = [json.loads(line) for line in (folder / "history.jsonl").read_text().splitlines()]
    return [line["step"] for line in lines if ("val" in line) == (kind == "val")]


def weights_equal(first, second):
    return all(torch.equal(value, second.model[name]) for name, value in first.model.items())


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


@pytest.mark.parametrize("number", first(1, range(24)))
def test_a_failed_write_is_a_line_and_the_older_checkpoint_stays_whole(run, kept, in_tmp_path, number):
    """The 24 cases are spread over all calls by which a resumed run writes."""
    if not (kept / "two").exists():
        assert run(1).exit_code == 0
        shutil.copytree("run", kept / "one")
        with pytest.MonkeyPatch.context() as patch:
            disk = Disk(patch)
            assert run(2).exit_code == 0
            (kept / "calls").write_text(json.dumps(disk.calls))
        shutil.copytree("run", kept / "two")
    calls = json.loads((kept / "calls").read_text())
    assert {"last.pt", "best.pt", "history.jsonl", "fsync", "replace", "open"} <= set(calls)
    assert any(name.startswith("events.out.tfevents") for name in calls)
    fails = number * len(calls) // 24
    shutil.rmtree("run", ignore_errors=True)
    shutil.copytree(kept / "one", "run")
    one, two = (checkpoint.load(kept / name / "last.pt") for name in ("one", "two"))
    with pytest.MonkeyPatch.context() as patch:
        Disk(patch, fails, ERRORS[number % 3])
        failed = run(2)
    assert isinstance(failed.exception, SystemExit), (calls[fails], failed.exception)
    assert failed.exit_code == 1, (calls[fails], failed.output)
    last_line = failed.stderr.splitlines()[-1]
    assert os.strerror(ERRORS[number % 3]) in last_line, (calls[fails], last_line)
    for name in ("last.pt", "best.pt"):
        found = checkpoint.load(in_tmp_path / "run" / name)
        assert weights_equal(found, one) or weights_equal(found, two), (calls[fails], name)
    assert not [path for path in (in_tmp_path / "run").rglob("*.tmp")], calls[fails]
    again = run(2)
    assert again.exit_code == 0, again.output
    assert weights_equal(checkpoint.load(in_tmp_path / "run/last.pt"), two)
    assert steps(in_tmp_path / "run") == steps(kept / "two") == [1, 2, 3, 4]
    assert steps(in_tmp_path / "run", "val") == [2, 4]


def test_history_repeats_no_step_and_keeps_no_broken_line(tmp_path):
    lines = [{"step": 1, "loss": 3}, {"step": 2, "loss": 2}, {"step": 2, "val": {}}, {"step": 3, "loss": 1}]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    for found, step, scale, expected in (
        (text, 2, 1, lines[:3]),
        (text, 3, 1, lines),
        (text + '{"step": 3, "lo', 3, 1, lines),
        (text + '{"step": 3, "loss": 9}\n', 3, 1, [*lines[:3], {"step": 3, "loss": 9}]),
        ("[1]\nnull\n\xff\n" + text, 1, 1, lines[:1]),
        (text, 0, 0, []),
        (text, 2, Fraction(1, 2), [{"step": 0, "loss": 3}, {"step": 1, "loss": 2}, {"step": 1, "val": {}}]),
    ):
        (tmp_path / "history.jsonl").write_text(found, encoding="latin-1")
        progress.trim_history(tmp_path, step, Fraction(scale))
        kept = [json.loads(line) for line in (tmp_path / "history.jsonl").read_text().splitlines()]
        assert kept == expected, found


def test_the_log_of_tensorboard_reads_back(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    for start in (0, 2):
        board = progress.BoardLog(tmp_path, start)
        for step in range(start + 1, start + 4):
            board.add({"loss/total": 10.0 * start + step}, step)
        # Names have the second in them.
        for path in (tmp_path / "tensorboard").iterdir():
            path.rename(path.with_name(f"{path.name}.{start}"))
    found = accumulator.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    told = [(event.step, event.value) for event in found.Scalars("loss/total")]
    assert told == [(1, 1.0), (2, 2.0), (3, 23.0), (4, 24.0), (5, 25.0)]


def _hold(out, entered, leave):
    with train.claimed(out, train.Process(0, 1, torch.device("cpu")), None):
        entered.set()
        leave.wait(60)


def test_of_two_trainings_into_one_folder_the_second_ends_with_a_line(run, in_tmp_path):
    context = multiprocessing.get_context("fork")
    entered, leave = context.Event(), context.Event()
    other = context.Process(target=_hold, args=(in_tmp_path / "run", entered, leave))
    other.start()
    try:
        assert entered.wait(60)
        before = sorted(path.name for path in (in_tmp_path / "run").iterdir())
        second = run(1)
        assert second.exit_code == 1
        assert second.stderr == "--out run: expected no other training at work here, got one; wait until it is done\n"
        assert sorted(path.name for path in (in_tmp_path / "run").iterdir()) == before
    finally:
        leave.set()
        other.join()
    assert run(1).exit_code == 0, "the claim ends with its process"
    read, process = train.last_saved(in_tmp_path / "run"), train.Process(0, 1, torch.device("cpu"))
    assert run(2).exit_code == 0
    with (
        pytest.raises(ClaimedError, match="another training has just been at work"),
        train.claimed(in_tmp_path / "run", process, read),
    ):
        pass


def test_a_log_file_gets_a_line_now_and_then_with_what_is_left(capsys, monkeypatch):
    clock = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock)
    with progress.ProgressLine("step", 100, is_shown=True) as line:
        for step in range(1, 101):
            clock = step * 2.0
            line.update(step, 100, "8.0 samples/s")
    told = capsys.readouterr().err.splitlines()
    assert [text.split()[1] for text in told] == ["16/100", "32/100", "48/100", "64/100", "80/100", "96/100"]
    assert told[0] == "step 16/100  8.0 samples/s  0:02:48 left"


def test_an_epoch_is_one_line_with_loss_validation_speed_and_time_left(capsys, monkeypatch, tmp_path):
    """As trainers print it: the mean loss since the line before, also where a validation comes within an epoch."""
    from synth3dlanes_baseline.metrics import Evaluation, MetricConfig

    clock = 100.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock)
    report = Evaluation(MetricConfig()).report()
    with progress.TrainingLog(tmp_path, 20, 10, 0, 4, is_shown=True) as log:
        for step in range(1, 21):
            clock += 0.5
            log.step(step, 1e-3, {"total": torch.tensor(float(step))})
            if step in (5, 20):
                log.validation(step, report)
            if step in (5, 10, 20):
                log.epoch(step, report if step in (5, 20) else None)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("epoch")]
    assert [line.split(":")[0] for line in lines] == ["epoch 0.5/2", "epoch 1/2", "epoch 2/2"]
    assert [line.split(", ")[0].split(": ")[1] for line in lines] == ["loss 3", "loss 8", "loss 15.5"]
    assert lines[1] == "epoch 1/2: loss 8, 8.0 images/s, 0:00:05 left"
    assert lines[2].endswith("8.0 images/s")
    assert "centerline AP" in lines[0]
    assert "reaches confidence" not in "".join(lines)
