"""Strange files and texts in the place of every input of every command: each is refused in lines, in bounded time and
memory, and nothing in it is run."""

import os
import pickle
import resource
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

import psutil
import pytest
from click.testing import Result
from PIL import Image
from synth3dlanes_cli.entry import NO_MEMORY

from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.open import open_drive
from tests.drives import road as made
from tests.hostile import LEAKED

Run = Callable[..., Result]
MOST_S, MOST_BYTES = 120, 3 << 30
MARK = "executed"


class HungError(BaseException):
    """A command took too long."""


class Malice:
    """What runs a program when it is unpickled."""

    def __reduce__(self) -> object:
        return os.system, (f"touch {MARK}",)


def sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(20 << 30)


def unix_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)
        os.replace(path.name, path)


CONTENTS = {
    "empty": b"",
    "byte": b"{",
    "utf16": '{"a": 1}'.encode("utf-16"),
    "bom": b'\xef\xbb\xbf{"a": 1}',
    "nulls": bytes(4096),
    "bytes": bytes(range(256)) * 16,
    "no_text": b"\xff\xfe\xfd",
    "other": b'{"a": 1}',
    "nested": b"[" * 100_000,
    "digits": b"9" * 5000,
    "code": f"!!python/object/apply:os.system ['touch {MARK}']".encode(),
    "pickle": pickle.dumps(Malice()),
    "magic": b"PK\x03\x04PAR1\x89PNG\r\n\x1a\n",
}
KINDS: dict[str, Callable[[Path], object]] = {
    "pipe": os.mkfifo,
    "zero": lambda path: path.symlink_to("/dev/zero"),
    "null": lambda path: path.symlink_to("/dev/null"),
    "folder": Path.mkdir,
    "socket": unix_socket,
    "nowhere": lambda path: path.symlink_to("nowhere"),
    "itself": lambda path: path.symlink_to(path.name),
    "unreadable": lambda path: path.symlink_to("/proc/self/mem"),
    "sparse": sparse,
    **{name: partial(Path.write_bytes, data=data) for name, data in CONTENTS.items()},
}

# Commands by the input that is strange, {x}, with the files around it that are as they should be: a data set d, a scene
# s.json, an image i.png, a drive w.
COMMANDS = {
    "x.yaml": [
        "sample --params {x}",
        "params check {x}",
        "sample --camera {x}",
        "sample --rig {x}",
        "sample --camera own.yaml",
        "generate --n 1 --out e --dry-run --device cpu --params tiny --lidar {x}",
    ],
    "x.json": [
        "render {x}",
        "inspect {x}",
        "bench --against {x}",
        "generate --n 1 --out e --dry-run --device cpu --like {x}",
        "twins {x} --vary light.exposure=1 --out e",
        "predict {x} --out e",
        "evaluate {x} --predictions p.jsonl --intrinsics 400,400,240,180",
        "evaluate {x}",
        "train {x} --out e",
        "drive check w --lanes {x}",
        "lift w --out e --review {x}",
    ],
    "x.geojson": ["drive mark w --out m.html --marked {x}"],
    "w/poses.txt": ["drive check w", "lift w --out e"],
    "w/lidar/0001.npy": ["drive mark w --out m.html", "lift w --out e --unchecked"],
    "x.mp4": ["predict {x} --out e"],
    "d/dataset.json": [
        "info d",
        "stats d",
        "report d --html r.html",
        "gallery d --out g.png",
        "merge d --out e",
        "split d/train --out e --into a=1",
        "inspect d/train:3",
        "render d/train:3",
        "clip d/train:3",
        "twins d/train --vary light.exposure=1 --out e",
        "export d --format apollo --out e",
        "validate d --workers 1 --limit 0",
        "evaluate d/train",
        "predict d/train --out e",
        "train d --out e",
        "ablation d --out e",
        "generate --n 12 --out d --device cpu",
    ],
    "d/train/00001.parquet": [
        "info d",
        "stats d",
        "gallery d --out g.png",
        "merge d --out e",
        "split d/train --out e --into a=1",
        "inspect d/train:3",
        "export d --format apollo --out e",
        "validate d --workers 1 --limit 0",
        "evaluate d/train",
        "predict d/train --out e",
        "train d --out e",
    ],
    "d/train/00001.tar": [
        "inspect d/train:7",
        "clip d/train:7",
        "render d/train:7",
        "merge d --out e",
        "export d --format apollo --out e",
        "validate d --workers 1 --limit 0",
        "evaluate d/train",
        "predict d/train:7 --out e",
    ],
    "x.png": [
        "predict {x} --out e",
        "inspect s.json --image {x}",
        "evaluate images --lane-masks masks --checkpoint nano --intrinsics 400,400,240,180",
    ],
    "x.xodr": ["generate --n 1 --out e --dry-run --device cpu --params tiny --map {x}"],
    "drive.yaml": ["drive check {x}", "drive mark {x} --out m.html", "lift {x} --out e"],
    "x.txt": ["predict i.png --out e --intrinsics {x}"],
    "x.pt": [
        "predict {x} i.png --out e",
        "evaluate d/train --checkpoint {x}",
        "train d --out e --init {x}",
        "train d --out e --pretrained {x} --model paper",
        "onnx {x} o.onnx",
    ],
    "run/last.pt": ["train d --out run --model tiny --set device=cpu"],
    "x.jsonl": ["evaluate d/train --predictions {x}"],
}
# What has nothing wrong: predictions of no lane, and a folder that is no index.
MAY_PASS = {("x.jsonl", "evaluate"): {"empty"}, ("d/train/00001.parquet", "info"): {"folder"}}
CASES = [(name, command) for name, commands in COMMANDS.items() for command in commands]


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with nothing wrong."""
    road = made.road(4)
    road.world = road.world[::8]
    written = made.write_described(tmp_path_factory.mktemp("drive"), road)
    assert not drive_findings(open_drive(str(written)))
    return written


@pytest.fixture
def around(in_tmp_path: Path, folder: Path, drive: Path, run: Run) -> Path:
    """The files that are as they should be; those of the data set and the drive are other names of the same files."""
    for name, source in (("d", folder), ("w", drive)):
        for path in source.rglob("*"):
            (in_tmp_path / name / path.relative_to(source)).parent.mkdir(parents=True, exist_ok=True)
            if path.is_file():
                os.link(path, in_tmp_path / name / path.relative_to(source))
    (in_tmp_path / "s.json").write_text(run("sample", "--params", "tiny").stdout)
    Image.new("RGB", (96, 72)).save(in_tmp_path / "i.png")
    (in_tmp_path / "own.yaml").write_text("calibration: x.yaml\nheight_m: 1.5\npitch_deg: 3\n")
    (in_tmp_path / "p.jsonl").touch()
    for name, link in (("images", "um_000000.png"), ("masks", "um_lane_000000.png")):
        (in_tmp_path / name).mkdir()
        (in_tmp_path / name / link).symlink_to("../x.png")
    (in_tmp_path / "run").mkdir()
    return in_tmp_path


@contextmanager
def bounded() -> Iterator[None]:
    """So much more memory and so many seconds; what is beyond fails."""

    def hang(number: int, frame: FrameType | None) -> None:
        raise HungError

    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + MOST_BYTES, before[1]))
    handler = signal.signal(signal.SIGALRM, hang)
    signal.alarm(MOST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def fault(result: Result, codes: tuple[int, ...] = (1, 2)) -> str:
    """What is wrong with how a command was refused; "" if nothing is."""
    said = f"{result.stderr}{result.stdout if result.exit_code == 1 else ''}"
    lines = said.splitlines()
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"raised {result.exception!r:.300}"
    if result.exit_code not in codes:
        return f"ended with {result.exit_code}: {said:.300}"
    if not lines or (result.exit_code == 2 and (len(lines) > 20 or max(map(len, lines)) > 600)):
        return f"said {len(lines)} lines: {said:.300}"
    if LEAKED.search(result.stderr) or NO_MEMORY in said:
        return f"said {said:.300}"
    return "executed" if Path(MARK).exists() else ""


def listed(faults: dict[str, str]) -> str:
    return "\n".join(f"{case[:20]!r}: {wrong[:200]}" for case, wrong in faults.items())


def some(values: list[str], number: int, every: int) -> list[str]:
    """One in `every` values, other ones for the next number."""
    return values[number % every :: every]


# Quick: each command meets some of the values, and each value some of the commands.
at_both_sizes = pytest.mark.parametrize("every", [9, pytest.param(1, marks=pytest.mark.thorough)])


@at_both_sizes
@pytest.mark.parametrize(("name", "command"), CASES)
def test_strange_files(name: str, command: str, every: int, run: Run, around: Path) -> None:
    faults = {}
    place = around / name
    words = command.format(x=name).split()
    for kind in some(list(KINDS), CASES.index((name, command)), every):
        if place.is_dir() and not place.is_symlink():
            place.rmdir()
        place.unlink(missing_ok=True)
        KINDS[kind](place)
        with bounded():
            wrong = fault(run(*words))
        may_pass = wrong.startswith("ended with 0") and kind in MAY_PASS.get((name, words[0]), ())
        if wrong and not may_pass:
            faults[kind] = wrong
    assert not faults, listed(faults)


TEXTS = [
    *("!!int ''", "!!int x", "!!bool foo", "!!timestamp foo", "!!float x", "!!null x", "!!set {a}", "!!omap [a: 1]"),
    *("!!binary x", "!!pairs [a: 1]", "!!merge x", "!!value x", "!!opencv-matrix [1]", "!foo x", "!<tag:x> y"),
    *("!!map [1]", "!!seq {a: 1}", "!!str [1]", "[" * 5000, "{" * 5000, "9" * 5000, "9" * 4000, "-" + "9" * 5000),
    *("&a [*a]", "*a", "[[[[1]]]]", "{a: {b: {c: 1}}}", "{[1]: 2}", "? [1]", "a: b: c", "'", '"', "\t", "%", "@", "`"),
    *(".nan", ".inf", "1e999", "1e308", "-1e308", "0x" + "f" * 50, "1_000", "1:59:59", "2001-01-01", "null", "~", ""),
    *("true", "x" * 100_000, "\udcff", "[/bold]", "é" * 1000, f"!!python/object/apply:os.system ['touch {MARK}']"),
    *(
        "{" + "a: &a [1], " * 10 + "}",
        "[1, 2, 3]",
        "{1: -1}",
        "{1: 1e300, 2: 1e300}",
        "[5, 1]",
        "[" + "0," * 50_000 + "0]",
    ),
]
SETTERS = {
    "sample --set": ("light.exposure=", "road.n_lanes=", "weather.kind=", "terrain=", ""),
    "render s.json --set": ("light.sun_zenith_deg=", "cars=", "road.n_lanes=", "camera.width_px=", "cars.0.color=", ""),
    "train d --out e --dry-run --set": ("batch=", "model.grid.rows=", "learning_rate=", "batch.x=", "model=", ""),
    "twins s.json --out e --vary": ("light.exposure=", ""),
}
SET = [(command, key) for command, keys in SETTERS.items() for key in keys]


@at_both_sizes
@pytest.mark.parametrize(("command", "key"), SET)
def test_strange_values(command: str, key: str, every: int, run: Run, around: Path) -> None:
    del around
    faults = {}
    for text in some(TEXTS, SET.index((command, key)), every):
        with bounded():
            wrong = fault(run(*command.split(), f"{key}{text}"), (2,))
        # Some are values, of which the command makes what they say; a scene is not rendered in this process.
        if wrong and not wrong.startswith("ended with 0"):
            faults[text[:60]] = wrong
    assert not faults, listed(faults)


NUMBERS = ["-1", "9" * 30, "9" * 5000, "1e-5", "nan", "", "٣" * 5000, "0x1F", "\udcff"]
NUMBERED = [
    *("sample --index {}", "sample --n {}", "sample --seed {}", "sample --frames {}", "sample --fps {}"),
    *("generate --out e --dry-run --device cpu --n {}", "generate --n 1 --out e --dry-run --device cpu --workers {}"),
    *("generate --n 1 --out e --dry-run --device cpu --part {}/3", "generate --n 1 --out e --samples {}"),
    *("split d/train --out e --into a={}", "inspect d/train:{}", "render d/train:{}", "predict d/train:{} --out e"),
    *(
        "evaluate d/train --threshold {}",
        "predict i.png --out e --intrinsics {},1,1,1",
        "ablation d --out e --sizes {}",
    ),
    *("gallery d --n {}", "gallery d --out g.png --shuffle {}", "train d --out e --epochs {} --dry-run"),
    *(
        "export d --format apollo --out e --size {}x3",
        "validate d --workers 1 --limit {}",
        "train d --out e --batch {} --dry-run",
    ),
]


@at_both_sizes
@pytest.mark.parametrize("command", NUMBERED)
def test_strange_numbers(command: str, every: int, run: Run, around: Path) -> None:
    del around
    faults = {}
    for text in some(NUMBERS, NUMBERED.index(command), every):
        with bounded():
            wrong = fault(run(*(word.replace("{}", text) for word in command.split())))
        if wrong and not wrong.startswith("ended with 0"):
            faults[text[:60]] = wrong
    assert not faults, listed(faults)
