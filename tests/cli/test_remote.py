"""Data sets in an S3 store."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import s3fs
from click.testing import Result

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples, store_server
from tests.thorough import first

Run = Callable[..., Result]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment in which `s3://lanes` is there."""
    with store_server.server(tmp_path_factory.mktemp("server") / "log") as environment:
        yield environment


@pytest.fixture
def store(server: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Iterator[s3fs.S3FileSystem]:
    """The store as the library sees it, and as it is in fact: nothing is remembered."""
    for name, value in server.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    yield s3fs.S3FileSystem(use_listings_cache=False)
    s3fs.S3FileSystem.clear_instance_cache()


def files_at(store: s3fs.S3FileSystem, place: str) -> dict[str, bytes]:
    return {name.removeprefix(f"{place}/"): store.cat_file(name) for name in store.find(place)}


def files_in(folder: Path) -> dict[str, bytes]:
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_generate_continues_in_a_store_and_makes_the_same_bytes(store: s3fs.S3FileSystem, tmp_path: Path) -> None:
    def go(out: str, n: int) -> int:
        plan = Plan(out, n, fake_samples.recipe(), workers=1, shard_size=4, maker=fake_samples.make)
        report = generate(plan, events.append)
        assert (report.exit_code, report.done, report.asked) == (0, n, n)
        return report.made

    events: list = []
    assert go(str(tmp_path / "here"), 6) == 6
    url = "s3://lanes/generated"
    assert [go(url, n) for n in (3, 6, 6)] == [3, 3, 0]
    assert [(event.done, event.asked) for event in events if event.kind == "sample"][-3:] == [(4, 6), (5, 6), (6, 6)]
    made = {name: data for name, data in files_at(store, "lanes/generated").items() if not name.startswith("logs/")}
    expected = {name: data for name, data in files_in(tmp_path / "here").items() if not name.startswith("logs/")}
    assert made == expected
    # A shard without its index is not there: whatever stopped its upload, it is made again.
    store.rm_file("lanes/generated/train/00001.parquet")
    store.pipe_file("lanes/generated/train/00001.tar", b"half a tar")
    assert go(url, 6) == 2
    assert store.cat_file("lanes/generated/train/00001.tar") == expected["train/00001.tar"]


def test_every_command_that_reads_reads_a_store(store: s3fs.S3FileSystem, run: Run, folder: Path) -> None:
    url = "s3://lanes/read"
    assert run("merge", folder, "--out", url).stdout == f"{url}/train: 12 samples\n"
    assert files_at(store, "lanes/read") == files_in(folder)
    for command in (("info", "PLACE", "--json"), ("stats", "PLACE", "--json", "--n", 4), ("evaluate", "PLACE/train")):
        told = []
        for place in (str(folder), url):
            result = run(*(str(word).replace("PLACE", place) for word in command))
            assert result.exit_code == 0, result.output
            told.append(result.stdout.replace(place, "PLACE"))
        assert told[0] == told[1], command
    for command in (
        ("inspect", f"{url}/train:00000003", "--html", "page.html"),
        ("gallery", url, "--where", "n_lanes = 3", "--columns", 2, "--out", "gallery.png"),
        ("export", url, "--format", "tusimple", "--out", "exported"),
    ):
        result = run(*command)
        assert result.exit_code == 0, (command, result.output)
    assert len(list(Path("exported/clips").glob("train/*/20.jpg"))) == 12


@pytest.mark.thorough
def test_validate_finds_in_a_store_what_it_finds_in_a_folder(store: s3fs.S3FileSystem, run: Run, folder: Path) -> None:
    shutil.copytree(folder, "here")
    url = "s3://lanes/validated"
    assert run("merge", folder, "--out", url).exit_code == 0
    Path("here/train/00001.parquet").unlink()
    store.rm_file("lanes/validated/train/00001.parquet")
    told = {}
    for workers, place in ((1, "here"), (1, url), (2, url)):
        result = run("validate", place, "--json", "--workers", workers, "--limit", 2)
        assert result.exit_code == 1, result.output
        told[workers, place] = json.loads(result.stdout)
    assert told[1, "here"] == told[1, url] == told[2, url]
    failed = told[1, url]["failed"]
    assert {"train", "train/00001.parquet", "train:00000000"} <= set(failed)
    assert files_at(store, "lanes/validated/validation") == files_in(Path("here/validation")) != {}
    result = run("validate", "s3://lanes/nowhere")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "s3://lanes/nowhere: expected a data set or one of its splits, got no folder\n" in result.stderr


@pytest.mark.thorough
def test_split_and_merge_write_to_a_store(store: s3fs.S3FileSystem, run: Run, folder: Path) -> None:
    shares = ("--into", "train=2,val=1")
    assert run("split", f"{folder}/train", *shares, "--out", "parts").exit_code == 0
    for _ in range(2):
        result = run("split", f"{folder}/train", *shares, "--out", "s3://lanes/parts")
        assert result.stdout == "s3://lanes/parts/train: 8 samples\ns3://lanes/parts/val: 4 samples\n", result.output
        assert files_at(store, "lanes/parts") == files_in(Path("parts"))
        store.rm("lanes/parts/train", recursive=True)
    assert run("split", f"{folder}/train", *shares, "--out", "s3://lanes/parts").exit_code == 0
    assert run("merge", "s3://lanes/parts", "--out", "s3://lanes/merged").exit_code == 0
    assert files_at(store, "lanes/merged") == files_in(Path("parts"))
    assert run("merge", "s3://lanes/merged", "--out", "here").exit_code == 0
    assert files_in(Path("here")) == files_in(Path("parts"))
    result = run("split", f"{folder}/train", *shares, "--seed", 1, "--out", "s3://lanes/parts")
    assert result.exit_code == 2
    assert "s3://lanes/parts/dataset.json: derived.seed: expected 0 as in this dataset, got 1" in result.stderr


@pytest.mark.parametrize("fault", first(2, ["no such bucket", "no server", "wrong keys", "no keys"]))
def test_a_store_that_refuses_is_named(
    store: s3fs.S3FileSystem, run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    if fault == "wrong keys":
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAIOSFODNN7EXAMPLE")
    elif fault == "no keys":
        monkeypatch.delenv("AWS_ACCESS_KEY_ID")
        monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
        monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    elif fault == "no server":
        monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
        monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    place = f"s3://{'nowhere' if fault == 'no such bucket' else 'lanes'}/v1"
    generate = ("generate", "--n", 1, "--params", "tiny", "--device", "cpu", "--out", place)
    for command in (("info", place), ("stats", place), ("merge", folder, "--out", place), generate):
        s3fs.S3FileSystem.clear_instance_cache()
        result = run(*command)
        # Running again helps only where the server may come back.
        assert (result.exit_code, result.stdout) == (1 if fault == "no server" else 2, ""), result.output
        assert result.stderr.startswith(place)
        assert result.stderr.count("\n") == 1


def test_an_address_that_nothing_opens_is_named(run: Run, folder: Path) -> None:
    for command in (("info", "lake://a/b"), ("merge", folder, "--out", "lake://a/b")):
        result = run(*command)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert result.stderr.startswith("lake://a/b: expected a folder or an address that fsspec can open")
