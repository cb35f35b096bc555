"""What all tests share. Our packages are imported inside fixtures, or the shape checks would miss them."""

import gc
import importlib.util
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Threads of numpy and torch that wait for each other on busy cores made a step of training ten times slower than one
# thread alone. The libraries look when they are loaded; programs that tests start inherit it.
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import numpy as np
import pytest
from filelock import FileLock
from hypothesis import settings

from tests import checked  # before all that it checks

# Machines are slow at times; a failure must be the same one tomorrow.
settings.register_profile("house", deadline=None, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=5000)
settings.load_profile("house")
# What the tests write need not outlive a power cut, and waiting for the disk took a tenth of the time of exports. That
# files are synced, and in which order, is seen by those who watch the calls (tests/power_cut.py).
os.fsync = lambda descriptor: None

EXIT_STATUS = pytest.StashKey[int]()
# Those that take longest with their thorough tests, in this order.
LONGEST = (
    *("test_planted.py", "test_examples.py", "test_export.py", "test_damaged_exports.py", "test_docs_commands.py"),
    *("test_rerender.py", "test_towns.py", "test_ray.py", "test_links.py", "test_predict.py", "test_clips.py"),
)
LONG_FOLDERS = ("validate", "production")
collect_ignore_glob = [] if importlib.util.find_spec("torch") else ["baseline/*"]


def pytest_configure() -> None:
    """Programs that the tests start heed signals, also where the tests were started in the background or by nohup:
    ignored signals stay so in child processes."""
    for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # The longest files come first, so that no process ends long after the other.
    order = {name: place for place, name in enumerate(LONGEST)}
    last = len(order)
    items.sort(key=lambda item: (order.get(item.path.name, last), item.path.parent.name not in LONG_FOLDERS))
    if importlib.util.find_spec("bpy") is None:
        for item in items:
            if item.get_closest_marker("render"):
                item.add_marker(pytest.mark.skip(reason="there is no bpy for this Python"))


def pytest_collection_finish() -> None:
    # All modules are loaded by now: going through their objects for garbage took a fiftieth of the time.
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    from tests import warm

    warm.use(item.get_closest_marker("fresh") is None)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[EXIT_STATUS] = exitstatus
    if "tests.warm" in sys.modules:
        sys.modules["tests.warm"].stop()


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Blender may hang or crash in an orderly exit, long after the last test."""
    if "bpy" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash.get(EXIT_STATUS, 1))


@pytest.fixture(autouse=True, scope="module")
def types_are_checked() -> None:
    """Of the first calls in each file of tests."""
    checked.begin_file()


@pytest.fixture(autouse=True, scope="session")
def spool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Samples on their way to stores stay out of the home folder."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("spool")
        patch.setenv("SYNTH3DLANES_SPOOL", str(folder))
        yield folder


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """`made_once(name, make)` is a folder that `make` fills, once for all processes of a run."""
    mine = tmp_path_factory.getbasetemp()
    shared = mine.parent if "PYTEST_XDIST_WORKER" in os.environ else mine

    def folder(name: str, make: Callable[[Path], object]) -> Path:
        made, done = shared / name, shared / f"{name}.done"
        with FileLock(f"{made}.lock"):
            if not done.exists():
                shutil.rmtree(made, ignore_errors=True)
                make(made)
                done.touch()
        return made

    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20190901)


@pytest.fixture
def flat_scene() -> Any:
    """A straight road on a plain, no cars or trees."""
    from tests.scenes import FLAT

    return FLAT


@pytest.fixture(scope="session")
def hilly_scene() -> Any:
    """Scene 17 of Appendix I: hills, an exit, cars and trees."""
    from synth3dlanes.draw.sample import Scenes, sample_scene
    from synth3dlanes.params.params import load_params

    return sample_scene(Scenes(load_params("appendix_i")), 17)


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
