"""Data sets in an S3 store, on a server of plain HTTP, and at addresses that name none."""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
import s3fs
from click.testing import Result

from synth3dlanes.dataset.address import translate_store_errors
from synth3dlanes.dataset.read import Reader
from synth3dlanes.system.errors import FormatError, InputError, OutageError, Synth3dlanesError
from tests import store_server
from tests.power_cut import contents
from tests.thorough import first

Run = Callable[..., Result]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment in which `s3://lanes` is there."""
    with store_server.server(tmp_path_factory.mktemp("server") / "log") as environment:
        yield environment


@pytest.fixture
def store(server: dict[str, str]) -> Iterator[s3fs.S3FileSystem]:
    """The store as the library sees it, and as it is in fact: nothing is remembered."""
    with store_server.seen_by_clients(server):
        yield s3fs.S3FileSystem(use_listings_cache=False)


def test_every_command_that_reads_reads_a_store(store: s3fs.S3FileSystem, run: Run, folder: Path) -> None:
    url = "s3://lanes/read"
    assert run("merge", folder, "--out", url).stdout == f"{url}/train: 12 samples\n"
    assert store_server.contents("lanes/read") == contents(folder)
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
    assert store_server.contents("lanes/validated/validation") == contents(Path("here/validation")) != {}
    result = run("validate", "s3://lanes/nowhere")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "s3://lanes/nowhere: expected a data set or one of its splits, got no folder\n" in result.stderr


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
        assert ("check the keys for this store" in result.stderr) == (fault in ("wrong keys", "no keys"))
        assert result.stderr.count("\n") == 1


class Plain(SimpleHTTPRequestHandler):
    """Files by their names, in one answer or in parts; no folder is listed. `sent` holds the sizes of all answers."""

    sent: list[int]
    has_ranges = True

    def do_GET(self) -> None:
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        data = path.read_bytes()
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", "")) if self.has_ranges else None
        part = data[int(asked[1]) : int(asked[2]) + 1] if asked else data
        self.send_response(HTTPStatus.PARTIAL_CONTENT if asked else HTTPStatus.OK)
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        if self.command != "HEAD":
            self.sent.append(len(part))
            self.wfile.write(part)

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class Whole(Plain):
    """The same without parts."""

    has_ranges = False


@contextmanager
def serving(folder: Path, kind: type[Plain] = Plain) -> Iterator[str]:
    kind.sent = []
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(kind, directory=str(folder))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_samples_are_read_at_random_without_their_shards(folder: Path) -> None:
    with serving(folder) as url:
        reader, expected = Reader(f"{url}/train"), Reader(str(folder / "train"))
        assert len(reader) == len(expected) == 12
        assert reader.index.equals(expected.index)
        Plain.sent.clear()
        for i in (11, 0, 7):
            assert reader.raw(i) == expected.raw(i)
        assert sum(Plain.sent) < 3 * (folder / "train/00000.tar").stat().st_size
        with pytest.raises(FormatError, match=r"expected a split of a data set, as DIR/train, got no .*dataset\.json"):
            Reader(f"{url}/elsewhere/train")
        with pytest.raises(FormatError, match="val: expected shards"):
            Reader(f"{url}/val")
    with pytest.raises(OutageError, match=r"^http://.*: cannot be reached: "):
        Reader(f"{url}/train")


def test_a_shard_that_is_not_made_yet_is_left_out(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "d")
    (tmp_path / "d/train/00001.parquet").unlink()
    with serving(tmp_path / "d") as url:
        assert [sample.key for sample in Reader(f"{url}/train")] == [f"{i:08d}" for i in (0, 1, 2, 3, 4, 10, 11)]


def test_a_server_that_sends_whole_files_alone_is_named(run: Run, folder: Path) -> None:
    with serving(folder, Whole) as url:
        result = run("stats", url)
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr == (
            f"{url}/dataset.json: expected a server that sends parts of files (range requests), got the whole file\n"
        )
        assert run("info", url).exit_code == 0


@pytest.mark.parametrize(
    "place",
    [
        *("reference://x", "data:,x", "jlab://", "jlab://x", "dbfs://", "dbfs://x", "generic://x", "http://[::1"),
        *("http://", "github://x", "zip://x", "tar://x", "blockcache://x", "dir://x"),
        *("asyncwrapper://x", "memory://x", "lake://x", "://", "a\0b", "arrow_hdfs://x"),
    ],
)
def test_an_address_that_is_none_is_one_line(run: Run, place: str) -> None:
    for command in (("info", place), ("stats", place)):
        result = run(*command)
        assert result.exit_code == 2, result.output
        # No shell passes a null character on: it is told by the library, with the name of its own argument.
        assert repr(place) in result.stderr if "\0" in place else result.stderr.startswith(place.rstrip("/"))
        assert result.stderr.count("\n") == 1
        assert not isinstance(result.exception, Synth3dlanesError)


def test_what_may_be_gone_in_a_minute_is_told_from_what_will_not() -> None:
    import socket

    class Answer(Exception):
        def __init__(self, status: int) -> None:
            self.status = status

    outages = (
        ConnectionRefusedError(),
        TimeoutError(),
        socket.gaierror(-2, "unknown"),
        OSError(16, "busy"),
        Answer(503),
    )
    refusals = (PermissionError(), FileNotFoundError(), ValueError(), NotImplementedError(), Answer(401), KeyError("x"))
    for kind, errors in ((OutageError, outages), (FormatError, refusals)):
        for error in errors:
            with pytest.raises(kind, match=r"^there: cannot be reached: "), translate_store_errors("there"):
                raise error
    with pytest.raises(InputError, match="mine"), translate_store_errors("there"):
        raise InputError("mine")
