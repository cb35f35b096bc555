"""A folder and a store are written by the same calls, and end up with the same bytes."""

import subprocess
import sys
from pathlib import Path

import pytest

from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.write import Shard
from synth3dlanes.system.errors import MissingPackageError
from tests import fake_samples
from tests.power_cut import contents

RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": 4}
SHARDS = [Shard(Path("train"), number, 4, RECIPE.names, recipe_text(DESCRIPTION)) for number in range(2)]


def extend(destination: Destination, n: int) -> None:
    """Make what is missing of the first `n` samples."""
    with destination.claim(DESCRIPTION, "train", n, range(2)):
        for shard in SHARDS:
            missing = destination.missing(shard, n)
            if missing:
                with destination.working_copy(shard) as here:
                    for index in missing:
                        here.write_part(index, fake_samples.make(RECIPE, index).members)
                    here.join(n)


def test_a_store_gets_the_bytes_of_a_folder(tmp_path):
    for name, place in (("here", tmp_path / "here"), ("store", (tmp_path / "store").as_uri())):
        for n in (3, 6):
            extend(Destination(place), n)
        assert [Destination(place).missing(shard, 7) for shard in SHARDS] == [[], [6]], name
    assert contents(tmp_path / "here") == contents(tmp_path / "store")


def test_a_shard_that_has_not_changed_is_not_written_again(tmp_path):
    store = Destination(tmp_path.as_uri())
    extend(store, 6)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.tar")}
    with store.working_copy(SHARDS[0]) as here:
        (here.folder.parent / "failed/train/00000003").mkdir(parents=True)
        (here.folder.parent / "failed/train/00000003/stderr.txt").write_text("why")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.tar")} == before
    assert (tmp_path / "failed/train/00000003/stderr.txt").read_text() == "why"


def test_shards_are_locked_one_by_one_and_a_driver_leaves_its_own_to_others(tmp_path):
    """Locks are those of a process, so the other run is another process."""
    code = (
        "import sys\nfrom synth3dlanes.system.errors import ClaimedError\n"
        "from tests.dataset.test_destination import *\n"
        "for line in sys.stdin:\n"
        "    who, number = line.split()\n"
        "    try:\n"
        "        with Destination(sys.argv[1]).claim(DESCRIPTION, 'train', 3, [int(number)], who == 'driver'):\n"
        "            print('free', flush=True)\n"
        "    except ClaimedError as error: print(error, flush=True)"
    )
    destination = Destination(tmp_path)
    locked = [f"out {tmp_path}: shard {number} is locked by another run" for number in range(3)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], **pipes) as other:

        def told() -> list[str]:
            """What the other process is told of shard 0 as a driver, and of each otherwise."""
            other.stdin.write("driver 0\nother 0\nother 1\nother 2\n")
            other.stdin.flush()
            return [other.stdout.readline().strip() for _ in range(4)]

        with destination.claim(DESCRIPTION, "train", 3, [0, 2]):
            assert told() == [locked[0], locked[0], "free", locked[2]]
        with destination.claim(DESCRIPTION, "train", 3, [0], is_driver=True):
            assert told() == [locked[0], "free", "free", "free"]


def test_an_address_whose_package_is_missing_says_so(monkeypatch):
    def refuse(url: str):
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr("fsspec.core.url_to_fs", refuse)
    with pytest.raises(MissingPackageError, match="s3://a: Install s3fs"):
        Destination("s3://a").missing(SHARDS[0], 3)
