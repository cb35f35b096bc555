"""YAML of plain values, mutated, is read or refused in lines; small files that would take gigabytes are refused too."""

import io
import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import feather

from synth3dlanes.dataset.index import read_index
from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params, presets_folder
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.production.benchmarks import load_benchmark
from synth3dlanes.production.given_scenes import given_scenes
from synth3dlanes.recorded.drives.described import read_described
from synth3dlanes.recorded.drives.lines import read_lines_of
from synth3dlanes.recorded.drives.tables import read_feather
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.system.columnar import DAMAGED, TableBounds, read_arrow, read_parquet
from synth3dlanes.system.errors import FormatError, InputError, Synth3dlanesError
from synth3dlanes.system.yaml_text import MAX_BYTES, read_yaml, text_of, value_of
from tests.hostile import HOSTILE, LEAKED, damaged, files, mutated, refused_or_read

READERS = {
    "streets.yaml": load_params, "cameras/kitti_raw.yaml": load_camera, "rigs/nuscenes.yaml": load_rig,
    "lidars/hdl_32e.yaml": load_lidar, "benchmarks/weather.yaml": load_benchmark,
}  # fmt: skip
VALUE = re.compile(rb"(?<=[:\[, ])[\w.+-]+(?=[,\]\n }])")
# Anchors, tags, documents and characters of YAML.
YAML = [
    b"&a [*a]", b"!!python/object:os.system x", b"<<: ", b"\t", b"---\n", b"*a", b".inf", b"1:59:59", b"\0",
    b"\x07",
]  # fmt: skip


@st.composite
def edited_yaml(draw, data):
    """A value replaced, or a piece of syntax put somewhere."""
    if draw(st.booleans()):
        at = draw(st.integers(0, len(data)))
        return data[:at] + draw(st.sampled_from(YAML)) + data[at:]
    value = draw(st.sampled_from(list(VALUE.finditer(data))))
    other = draw(st.sampled_from([text for text in HOSTILE if len(text) < 1000]))
    return data[: value.start()] + other.encode() + data[value.end() :]


@pytest.mark.parametrize("name", READERS)
@given(data=st.data())
@files
def test_settings(tmp_path_factory, name, data):
    whole = (presets_folder() / name).read_bytes()
    path = tmp_path_factory.getbasetemp() / "x.yaml"
    path.write_bytes(data.draw(st.one_of(edited_yaml(whole), damaged(whole))))
    problems = ""
    try:
        READERS[name](str(path))
    except InputError as error:
        problems = str(error)
    assert all("x.yaml" in line for line in problems.splitlines()), problems
    assert not LEAKED.search(problems), problems


SCORES = json.dumps({"source": "nowhere/test", "samples": [{"key": "00000001"}, {"key": "00000002"}]})


@given(st.one_of(mutated(SCORES.encode(), is_json=True), st.sampled_from(HOSTILE).map(str.encode)))
@files
def test_given_scenes(tmp_path_factory, data):
    path: Path = tmp_path_factory.getbasetemp() / "scores.json"
    path.write_bytes(data)
    params = load_params("appendix_i")
    refused_or_read(lambda: given_scenes(path, params, Assets()), f"like {path}", error=Synth3dlanesError)


PLAIN = "expected plain values (null, true, false, numbers, text, lists and mappings), got the tag "


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("null", None), ("~", None), ("", None), ("true", True), ("False", False), ("yes", "yes"), ("off", "off"),
        ("12", 12), ("-7", -7), ("010", 10), ("0o17", 15), ("0x1F", 31), ("1_000", "1_000"), ("1:59:59", "1:59:59"),
        ("1e-3", 0.001), ("1.", 1.0), ("-.5E+02", -50.0), (".inf", float("inf")), ("-.Inf", float("-inf")),
        ("2001-01-01", "2001-01-01"), ("=", "="), ("!!str 3", "3"), ("!!int '3'", 3), ("!!float 3", 3.0),
        ("'3'", "3"), ("{<<: {a: 1}}", {"<<": {"a": 1}}), ("{a: &x [1, 2], b: *x}", {"a": [1, 2], "b": [1, 2]}),
    ],
)  # fmt: skip
def test_the_core_schema(text: str, value: object) -> None:
    assert repr(read_yaml(text, "f")) == repr((value, []))
    if not set(text) & set("!{'"):
        assert repr(value_of(text)) == repr(value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("!!int ''", "expected a whole number, got ''"),
        ("!!bool foo", "expected true or false, got 'foo'"),
        ("!!float x", "expected a number, got 'x'"),
        ("!!null x", "expected null, got 'x'"),
        ("!!timestamp foo", PLAIN + "'!!timestamp'"),
        ("!!opencv-matrix {rows: 1}", PLAIN + "'!!opencv-matrix'"),
        ("!!python/object/apply:os.system [x]", PLAIN + "'!!python/object/apply:os.system'"),
        ("!foo x", PLAIN + "'!foo'"),
        ("[" * 5000, "expected at most 20 lists and mappings in each other, got more"),
        ("9" * 5000, "expected a number of at most 40 digits, got 5000"),
        ("&a [*a]", "expected no alias within what it stands for, got *a"),
        ("[" + "0," * 30_000 + "0]", "expected at most 20000 values, got more"),
        ("{a: 1, a: 2}", "key 'a' is given twice"),
        ("{[1]: 2}", "not YAML: found unhashable key"),
    ],
)
def test_all_else_is_refused_in_a_line(text: str, problem: str) -> None:
    _, problems = read_yaml(f"\n{text}", "f")
    assert problems == [f"f: line 2: {problem}"]


def test_what_aliases_repeat_counts() -> None:
    """Nine anchors, each of which stands for ten of the one before."""
    lines = ["- &a0 [x]", *(f"- &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10))]
    assert read_yaml("\n".join(lines), "f") == (None, ["f: line 5: expected at most 20000 values, got more"])


def test_calibrations_have_matrices() -> None:
    text = "%YAML:1.0\n---\nm: !!opencv-matrix\n  rows: 1\n  data: [ 1., 2.5e+02 ]"
    assert read_yaml(text, "f", is_calibration=True) == ({"m": {"rows": 1, "data": [1.0, 250.0]}}, [])
    assert read_yaml("!!opencv-matrix [1]", "f", is_calibration=True)[1] == [
        "f: line 1: not YAML: expected a mapping node, but found sequence"
    ]


def test_long_texts_are_refused_unread(tmp_path: Path) -> None:
    assert read_yaml("#" * (MAX_BYTES + 1), "f")[1] == ["f: expected at most 1,048,576 characters, got 1,048,577"]
    (tmp_path / "x.yaml").write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(InputError, match=r"^f: expected at most 1,048,576 bytes, got 1,048,577$"):
        text_of(tmp_path / "x.yaml", "f")


MOST_MB, LIMIT_BYTES = 900, 6 << 30
LARGE, MANY = "x" * (4 << 20), 20_000_000
BOUNDS = TableBounds(most_rows=1_000_000, row_bytes=2048)


def parquet(columns: dict[str, object], **options: object) -> bytes:
    stream = io.BytesIO()
    pq.write_table(pa.table(columns), stream, **options)  # type: ignore[arg-type]
    return stream.getvalue()


def arrow(columns: dict[str, object], **options: object) -> bytes:
    stream = io.BytesIO()
    feather.write_feather(pa.table(columns), stream, **options)  # type: ignore[arg-type]
    return stream.getvalue()


def zeros(n: int, kind: type = np.uint8) -> pa.Array:
    return pa.array(np.zeros(n, kind))


def repeated(text: str, n: int) -> pa.Array:
    """Made without the memory that it would take."""
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, np.int32)), pa.array([text]))


def json_lines(lines: list[list[list[int]]]) -> bytes:
    return json.dumps({"format": "synth3dlanes.lines", "version": 1, "images": {"1.jpg": lines}}).encode()


def of_file(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def reading(data: bytes, folder: Path) -> object:
        (folder / name).write_bytes(data)
        return read(folder / name)

    return reading


def index(data: bytes, _: Path) -> object:
    return read_index(data, "train/00000.parquet")


POINTS = of_file("a.feather", lambda path: read_feather(path, "xyz"))
LINES = of_file("a.json", lambda path: read_lines_of(path).of(Path("1.jpg")))
XYZ = ("x", "y", "z")
# The bytes, and what reads them.
CASES: dict[str, tuple[Callable[[], bytes], Callable[[bytes, Path], object]]] = {
    "a value of 4 MB in 1,000 rows": (lambda: parquet({"key": repeated(LARGE, 1000)}), index),
    "one of 900 KB": (lambda: parquet({"key": repeated(LARGE[:900_000], 1000)}), index),
    "continued texts": (
        lambda: parquet(
            {"key": [LARGE] * 20}, use_dictionary=False, column_encoding={"key": "DELTA_BYTE_ARRAY"}
        ),
        index,
    ),
    "a compressed page": (
        lambda: parquet({"key": [LARGE * 10]}, use_dictionary=False, compression="zstd", store_schema=False), index,
    ),
    "many columns": (lambda: parquet({f"c{i}": zeros(30_000) for i in range(400)}), index),
    "lists": (lambda: parquet({"key": [[0] * 3_000_000]}), index),
    "rows of nothing": (lambda: parquet({"key": pa.nulls(1_000_001)}), index),
    "millions of rows": (lambda: arrow(dict.fromkeys(XYZ, zeros(MANY)), compression="zstd", chunksize=MANY), POINTS),
    "rows without values": (lambda: arrow(dict.fromkeys(XYZ, pa.nulls(300_000_000)), chunksize=300_000_000), POINTS),
    "a column beside": (
        lambda: arrow({**dict.fromkeys(XYZ, zeros(9)), "w": [LARGE * 10] + [""] * 8}, compression="zstd"), POINTS,
    ),
    "a dictionary": (lambda: arrow(dict.fromkeys(XYZ, repeated(LARGE[: 1 << 20], 10_000))), POINTS),
    "200,000 lines": (lambda: json_lines([[[0, 0], [1, 1]]] * 200_000), LINES),
    "a line of 3,000,000 points": (lambda: json_lines([[[0, 0]] * 1_500_000]), LINES),
    "short arrays": (lambda: json_lines([[[0, 0], [1, 1]]] * 1_500_000), LINES),
    "problems": (lambda: json_lines([[["", ""]] * 900_000]), LINES),  # type: ignore[list-item]
}  # fmt: skip


def peak_mb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10


def read_all(folder: Path) -> None:
    """Read the files of the cases that another process has made; print what each says and takes."""
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    for number, (name, (_, read)) in enumerate(CASES.items()):
        if not (folder / str(number)).exists():
            continue
        data, before = (folder / str(number)).read_bytes(), peak_mb()
        try:
            read(data, folder)
            said = "read"
        except FormatError as error:
            said = str(error)
        print(json.dumps([name, len(data) >> 10, peak_mb() - before, said]), flush=True)  # noqa: T201


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.thorough)])
def test_small_files_are_refused_before_they_take_gigabytes(tmp_path: Path, every: int) -> None:
    asked = [*enumerate(CASES)][::every]
    for number, name in asked:
        make, _ = CASES[name]
        pid = os.fork()  # what takes much to make is gone afterwards
        if not pid:
            (tmp_path / str(number)).write_bytes(make())
            os._exit(0)
        assert os.waitpid(pid, 0)[1] == 0
    script = (
        f"from pathlib import Path; from tests.test_hostile_settings import read_all; read_all(Path({str(tmp_path)!r}))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=240)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row[0] for row in rows] == [name for _, name in asked], done.stderr[-2000:]
    for name, _, taken_mb, said in rows:
        assert taken_mb < MOST_MB, (name, taken_mb, said)
        assert "\n" not in said
        assert len(said) < 300
        assert said != "read", name


def test_ten_times_any_folder_is_no_pattern(tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(
        f"images: {{files: '{'**/' * 10}*.jpg', camera: c.yaml}}\nposes: {{file: poses.txt}}\n"
    )
    with pytest.raises(InputError, match=r"expected \*\* at most once in a pattern of files"):
        read_described(tmp_path / "drive.yaml")


@pytest.mark.parametrize("compression", ["snappy", "zstd", "none"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("page_bytes", [64, 1 << 20])
def test_tables_are_read_as_pyarrow_reads_them(
    rng: np.random.Generator, compression: str, version: str, page_bytes: int
) -> None:
    words = np.array(["", "a", "night"])[rng.integers(0, 3, 500)]
    columns = {"key": words, "x": rng.random(500), "n": rng.integers(0, 9, 500), "is": rng.random(500) > 0.5}
    columns["gaps"] = pa.array([None if n else 1.0 for n in rng.integers(0, 2, 500)])
    table = pa.table(columns)
    pages = {"data_page_version": version, "data_page_size": page_bytes, "row_group_size": 150}
    data = parquet(columns, compression=compression, **pages)
    assert read_parquet(data, "t", BOUNDS).equals(table)
    assert read_parquet(data, "t", BOUNDS, ["x", "key", "none"]).equals(table.select(["x", "key"]))
    of_arrow = {"snappy": "lz4", "none": "uncompressed"}.get(compression, compression)
    data = arrow(columns, compression=of_arrow, chunksize=77)
    assert read_arrow(data, "t", BOUNDS, ["key", "x", "none"]).equals(table.select(["key", "x"]))


def test_damaged_tables_raise_what_readers_translate(rng: np.random.Generator) -> None:
    table = {"key": [f"{i:08d}" for i in range(50)], "x": rng.random(50)}
    for data, read in (
        (parquet(table), lambda data: read_parquet(data, "t", BOUNDS)),
        (arrow(table), lambda data: read_arrow(data, "t", BOUNDS, ["key", "x"])),
    ):
        for at in rng.integers(0, len(data), 300).tolist():
            damaged = bytearray(data)
            damaged[at] ^= int(rng.integers(1, 256))
            try:
                read(bytes(damaged))
            except (FormatError, *DAMAGED):
                continue
