"""Parts that start together in a new store, runs that are equal, and runs that ask for different splits."""

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from synth3dlanes.dataset import stores
from synth3dlanes.dataset.description import parse_description
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.spool import SPOOL, spool, spooled
from synth3dlanes.dataset.write import Shard
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples, soak, store_server
from tests.power_cut import contents

# Each process says that it is ready, and begins with the others.
PART = """
import sys
from synth3dlanes.production import plan, run
from tests import fake_samples
url, part, parts = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
a_plan = plan.Plan(url, 3, fake_samples.recipe(), 1, (part, parts), shard_size=1, maker=fake_samples.make)
print("ready", flush=True)
sys.stdin.readline()
report = run.generate(a_plan, lambda _: None)
print(report.text(), report.problem, flush=True)
sys.exit(report.exit_code)
"""


@pytest.fixture(scope="module", autouse=True)
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    log = tmp_path_factory.mktemp("server") / "log"
    with store_server.server(log) as environment, store_server.seen_by_clients(environment):
        yield


def at_once(url: str, parts: list[tuple[int, int]]) -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", PART, url]
    runs = [subprocess.Popen([*command, *map(str, part)], cwd=soak.ROOT, **pipes) for part in parts]
    for run in runs:
        assert run.stdout.readline() == "ready\n", run.stderr.read()
    for run in runs:
        run.stdin.write("go\n")
        run.stdin.flush()
    told = [run.communicate() for run in runs]
    assert [run.returncode for run in runs] == [0] * len(runs), told


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    plan = Plan(out, 3, fake_samples.recipe(), 1, shard_size=1, maker=fake_samples.make)
    assert generate(plan, lambda _: None).exit_code == 0
    return out


@pytest.mark.thorough
@pytest.mark.parametrize("parts", [[(1, 3), (2, 3), (3, 3)], [(1, 1), (1, 1)]], ids=["parts", "equal"])
def test_runs_that_start_together_in_a_new_store(
    whole: Path, parts: list[tuple[int, int]], request: pytest.FixtureRequest
) -> None:
    name = f"lanes/{request.node.callspec.id}"
    at_once(f"s3://{name}", parts)
    found = store_server.contents(name)
    assert {path: data for path, data in found.items() if not path.startswith("logs/")} == contents(whole)


@pytest.mark.parametrize("kind", ["object store", "files"])
def test_no_split_is_lost_where_runs_announce_theirs_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """All have read that there is nothing, before one writes."""
    url, splits = (
        "s3://lanes/splits" if kind == "object store" else (tmp_path / "d").as_uri(),
        [f"s{i}" for i in range(4)],
    )
    recipe = {**fake_samples.recipe().description(), "shard_size": 4}
    barrier, written = Barrier(len(splits)), set()
    put = stores.put_bytes

    def put_together(place: str, name: str, data: bytes) -> None:
        if (key := (id(data), name)) not in written and len(written) < len(splits) and name == "dataset.json":
            written.add(key)
            barrier.wait(30)
        put(place, name, data)

    monkeypatch.setattr(stores, "put_bytes", put_together)
    with ThreadPoolExecutor(len(splits)) as pool:
        list(pool.map(lambda n: stores.announce(url, recipe, splits[n], n), range(len(splits))))
    files, root = stores.connect(url)
    described = parse_description(files.cat_file(f"{root}/dataset.json"), "")
    assert described["splits"] == {split: {"n": n} for n, split in enumerate(splits)}
    card = files.cat_file(f"{root}/README.md").decode()
    assert all(f"| {split} | {n} |" in card for n, split in enumerate(splits))
    for split in splits[1:]:
        assert f'"@id": "{split}/00000.tar"' in files.cat_file(f"{root}/croissant.json").decode()
    there = sorted(path.rpartition("/")[2] for path in files.find(root))
    assert there == ["README.md", "croissant.json", "dataset.json"]


def test_folders_of_the_spool_that_runs_use_remove_and_take_over_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of four runs leaves some of its samples, as if it were killed, and puts the others."""
    monkeypatch.setenv(SPOOL, str(tmp_path))
    shard = Shard(Path("train"), 0, 1000, ("txt",), "recipe")
    put: list[dict[str, bytes]] = [{} for _ in range(4)]

    def run(number: int) -> None:
        for turn in range(8):
            with spool("s3://lanes/v1", shard) as root:
                here = shard.within(root)
                here.open()
                here.write_part(turn * 4 + number, {"txt": str(number).encode()})
                if turn % 3:
                    for path in here.parts().values():
                        put[number][path.name] = path.read_bytes()
                        path.unlink()
            spooled("s3://lanes/v1", "train", "recipe")

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(run, range(4)))
    with spool("s3://lanes/v1", shard) as root:
        left = {path.name: path.read_bytes() for path in shard.within(root).parts().values()}
    assert len({name for found in [*put, left] for name in found}) == 32


def test_logs_of_killed_runs_that_several_runs_put_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SPOOL, str(tmp_path / "spool"))
    url = (tmp_path / "store").as_uri()

    def run(number: int) -> None:
        for turn in range(10):
            with Destination(url).log(f"{number}-{turn}.jsonl") as log:
                log.write(f"{number} {turn}\n".encode())
                if turn % 2:
                    assert log.save(is_last=True) == ""

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(run, range(4)))
    lines = {path.name: path.read_text() for path in (tmp_path / "store" / "logs").iterdir()}
    assert lines == {f"{number}-{turn}.jsonl": f"{number} {turn}\n" for number in range(4) for turn in range(10)}
