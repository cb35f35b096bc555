"""Small files that would take gigabytes are refused in a line before anything of them is decoded."""

import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

from synth3dlanes.dataset.index import read_index
from synth3dlanes.recorded.drives.described import read_described
from synth3dlanes.recorded.drives.lines import read_lines_of
from synth3dlanes.recorded.drives.tables import read_feather
from synth3dlanes.system.columnar import DAMAGED, TableBounds, read_arrow, read_parquet
from synth3dlanes.system.errors import FormatError, InputError

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
        f"from pathlib import Path; from tests.test_bounded_reading import read_all; read_all(Path({str(tmp_path)!r}))"
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
    table = pa.table({"key": words, "x": rng.random(500), "n": rng.integers(0, 9, 500), "is": rng.random(500) > 0.5})
    table = table.append_column("gaps", pa.array([None if n else 1.0 for n in rng.integers(0, 2, 500)]))
    stream = io.BytesIO()
    pq.write_table(
        table, stream, compression=compression, data_page_version=version, data_page_size=page_bytes, row_group_size=150
    )
    assert read_parquet(stream.getvalue(), "t", BOUNDS).equals(table)
    assert read_parquet(stream.getvalue(), "t", BOUNDS, ["x", "key", "none"]).equals(table.select(["x", "key"]))
    stream = io.BytesIO()
    feather.write_feather(
        table, stream, compression={"snappy": "lz4", "none": "uncompressed"}.get(compression, compression), chunksize=77
    )
    assert read_arrow(stream.getvalue(), "t", BOUNDS, ["key", "x", "none"]).equals(table.select(["key", "x"]))


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
