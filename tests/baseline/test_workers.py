"""Worker processes of the loader: whatever ends one ends the run in a line, and none outlives its run."""

import faulthandler
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import pytest
import torch
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.devices import Process
from synth3dlanes_baseline.loading import decoding_of, open_examples, training_batches
from synth3dlanes_baseline.workers import made_ahead
from torch import Tensor

from synth3dlanes.system.errors import WorkerError
from tests.baseline import roads

ROOT = Path(__file__).parents[2]
CPU = torch.device("cpu")
ORDER = [[index, index + 1] for index in range(0, 20, 2)]
# A mount namespace of its own with a small /dev/shm, as Docker's; where that is not allowed, a bound on all new files.
SMALL_SHM = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs -o size=1m tmpfs /dev/shm && exec "$@"', "sh"]
SMALL_FILES = ["sh", "-c", 'ulimit -f 1024 && exec "$@"', "sh"]


class Made(NamedTuple):
    numbers: Tensor
    image: Tensor
    names: tuple[str, ...]


def make(indices):
    image = torch.from_numpy(np.random.default_rng(indices).integers(0, 256, (2, 300, 200, 3), np.uint8))
    return Made(torch.tensor(indices), image.permute(0, 3, 1, 2), tuple(map(str, indices)))


def made_by(n_workers, make=make, order=ORDER):
    return made_ahead(lambda number: make(order[number]), len(order), n_workers, CPU)


@pytest.mark.parametrize("n_workers", [1, 3, 10])
def test_batches_come_in_order_with_their_bytes_and_strides(n_workers):
    here = list(made_by(0))
    there = list(made_by(n_workers))
    assert [one.names for one in there] == [one.names for one in here]
    for one, other in zip(here, there, strict=True):
        for a, b in zip(one[:2], other[:2], strict=True):
            assert a.equal(b)
            assert (a.dtype, a.stride()) == (b.dtype, b.stride())
            b += 1  # a worker's tensor can be written, as one that is made here


def end_by(end):
    def make_or_end(indices):
        if 6 in indices:
            faulthandler.disable()
            end()
        return make(indices)

    return make_or_end


def find_no_memory():
    raise MemoryError


@pytest.mark.parametrize(
    ("end", "how"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "was killed by SIGKILL, perhaps because memory ran out"),
        (lambda: os.kill(os.getpid(), signal.SIGBUS), "was killed by SIGBUS"),
        (lambda: os._exit(3), "ended with exit code 3"),
        (find_no_memory, "found no memory"),
    ],
)
@pytest.mark.parametrize("n_workers", [1, 2])
def test_a_worker_that_dies_ends_the_run_in_one_line(end, how, n_workers):
    others = psutil.Process().children()
    batches = made_by(n_workers, end_by(end))
    assert [next(batches).numbers.tolist() for _ in range(3)] == ORDER[:3]
    with pytest.raises(WorkerError, match=rf"^workers: a loader's worker {how}; rerun to resume; .* \(--set workers=1"):
        next(batches)
    assert psutil.Process().children() == others


def test_a_run_that_is_over_leaves_no_worker():
    others = psutil.Process().children()
    batches = made_by(3)
    next(batches)
    assert len(psutil.Process().children()) == len(others) + 3
    batches.close()
    assert psutil.Process().children() == others


def run(*command, script):
    lines = f"import sys; sys.path[:0] = [{str(ROOT)!r}]\n{script}"
    return [*command, sys.executable, "-c", lines]


def test_a_run_that_is_killed_leaves_no_worker():
    script = "import time; from tests.baseline.test_workers import made_by; batches = made_by(3); next(batches)\n"
    script += "print(0, flush=True); time.sleep(1000)"
    with subprocess.Popen(run(script=script), stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        workers = psutil.Process(process.pid).children()
        process.kill()
    assert len(workers) == 3
    assert psutil.wait_procs(workers, timeout=60)[1] == []


@pytest.mark.thorough
def test_training_goes_on_with_any_shared_memory(tmp_path):
    """Batches of 2 MB, where all shared memory is 1 MB."""
    may = shutil.which("unshare") and subprocess.run([*SMALL_SHM, "true"], capture_output=True).returncode == 0
    script = "from tests.baseline.test_workers import shared_memory; shared_memory(sys.argv[1])"
    command = [*run(*(SMALL_SHM if may else SMALL_FILES), script=script), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stdout) == (0, "2073600\n" * 6), done.stderr


def shared_memory(folder):
    samples = roads.samples(np.random.default_rng(0), 8)
    config = train_config("nano", {"batch": 4, "device": "cpu", "workers": 1, "keep_decoded": False})
    process = Process(0, 1, CPU)
    decoding = decoding_of(len(samples), config, process)
    examples = open_examples(samples, decoding, config, process, Path(folder))
    for batch in training_batches(examples, config, process, 0, 6):
        sys.stdout.write(f"{batch.image.nbytes}\n")
