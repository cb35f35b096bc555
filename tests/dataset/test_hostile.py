"""Files from outside, mutated: each is read, or refused by a FormatError whose lines name it. Nothing else happens.

`pytest --hypothesis-profile long tests/dataset/test_hostile.py` tries thousands of others.
"""

import io
import json
import re
import shutil
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.dataset.description import parse_description, updated_description
from synth3dlanes.dataset.format import decode_image, encode_image, read_passes, tar_bytes, tar_members, write_passes
from synth3dlanes.dataset.index import read_index, read_indices
from synth3dlanes.dataset.info import dataset_info
from synth3dlanes.dataset.rearrange import merge
from synth3dlanes.dataset.splits import readers
from synth3dlanes.dataset.write import Shard, scan
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.system.errors import FormatError, Synth3dlanesError
from tests import fake_samples
from tests.hostile import WHERE, files, mutated, refused_or_read

GOLDEN = Path(__file__).parents[1] / "golden"


@cache
def golden(name: str) -> str:
    return (GOLDEN / name).read_text()


DESCRIPTION = updated_description(
    None, {**fake_samples.recipe().description(), "shard_size": 10}, "train", 4, "dataset.json"
)
PASSES = write_passes(
    {
        "depth": np.ones((16, 24), np.float32),
        "semantic": np.ones((16, 24), np.uint8),
        "normal": np.zeros((16, 24, 3), np.float32),
    }
)
JPG, PNG = (encode_image(fake_samples.image(1), image_format) for image_format in ("jpg", "png"))


@given(mutated(golden("split.labels.json").encode(), is_json=True))
def test_labels(data):
    labels = refused_or_read(lambda: labels_module.from_json(data, WHERE))
    if labels:
        # What is read is finite and whole: it can be written, and read again.
        assert labels_module.from_json(labels_module.to_json(labels), WHERE).graph == labels.graph
        assert all(len(lane.visible) == len(lane.xyz_cam) for lane in labels.lanes)


@given(mutated(golden("split.scene.json").encode(), is_json=True))
def test_scenes(data):
    scene = refused_or_read(lambda: scene_module.from_json(data, WHERE))
    if scene:
        assert scene_module.from_json(scene_module.to_json(scene), WHERE) == scene


@given(mutated(DESCRIPTION, is_json=True))
def test_descriptions(data):
    description = refused_or_read(lambda: parse_description(data, WHERE))
    if description:
        assert b"NaN" not in json.dumps(description).encode()


@given(st.one_of(mutated(JPG), mutated(PNG)), st.sampled_from([None, (24, 16)]))
def test_images(data, size_px):
    image = refused_or_read(lambda: decode_image(data, WHERE, size_px))
    assert image is None or size_px is None or image.shape == (16, 24, 3)


@given(mutated(PASSES))
def test_passes(data):
    # The library tells of damaged files on stdout.
    refused_or_read(lambda: read_passes(data, WHERE, (24, 16)))


@pytest.mark.parametrize("size_px", [None, (24, 16)])
def test_a_picture_of_too_many_pixels_is_refused_before_they_are_decoded(size_px):
    """PNG's header: width and height are the eight bytes after its name (RFC 2083, 4.1.1)."""
    at = PNG.index(b"IHDR") + 4
    for width, height in ((30_000, 30_000), (12_000, 12_000), (9000, 1)):
        header = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + PNG[at + 8 : at + 13]
        bomb = PNG[: at - 4] + header + zlib.crc32(header).to_bytes(4, "big") + PNG[at + 17 :]
        with pytest.raises(FormatError, match=rf"^{WHERE}: expected .* pixels, got (more|{width}x{height})"):
            decode_image(bomb, WHERE, size_px)
    with pytest.raises(FormatError, match=r"expected 24x16 pixels, got 600x300"):
        read_passes(write_passes({"depth": np.ones((300, 600), np.float32)}), WHERE, (24, 16))


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "1e7"])
def test_numbers_that_are_not_finite_or_too_large_are_refused_in_labels(number):
    for key in ('"xyz_cam":[[', '"height_m":', '"world_from_cam":[['):
        text = re.sub(rf"({re.escape(key)})[-\d.e]+", rf"\g<1>{number}", golden("plain.labels.json"), count=1)
        assert number in text
        with pytest.raises(FormatError, match=rf"^{WHERE}: (camera|lanes\.0)\..*expected"):
            labels_module.from_json(text, WHERE)


SIZE = slice(124, 136)


@given(
    mutated(tar_bytes("00000003", fake_samples.make(fake_samples.recipe(), 3).members)),
    st.sampled_from([None, b"\xff" * 12, b"\x80" + b"\xff" * 11, b"77777777777\0", b"-0000000001\0", b"00000000000\0"]),
)
@files
def test_tars(tmp_path_factory, data, size):
    """A header's size is octal text, or with a first byte of 0x80 or 0xff a number of two's complement (GNU tar)."""
    if size:
        data = data[: SIZE.start] + size + data[SIZE.stop :]
    members = refused_or_read(lambda: list(tar_members(io.BytesIO(data), len(data))), "expected")
    assert all(offset + length <= len(data) for _, offset, length in members or [])
    path = tmp_path_factory.getbasetemp() / "x.tar"
    path.write_bytes(data)
    places, _ = scan(path, fake_samples.recipe().names)
    assert all(place.end <= len(data) for place in places.values())


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of four samples."""
    return fake_samples.data_set(tmp_path_factory.mktemp("small") / "d", range(4), 4, 10)


def use(root: Path) -> None:
    """What people do with a data set; each step must end, by itself or by an error of ours."""
    for step in (
        lambda: dataset_info(str(root)),
        lambda: [list(reader) for reader in readers(str(root))],
        lambda: [reader.image(i) for reader in readers(str(root)) for i in range(min(2, len(reader)))],
        lambda: merge([str(root)], str(root.parent / "merged")),
        lambda: resume(root),
    ):
        with suppress(Synth3dlanesError):
            step()
    shutil.rmtree(root.parent / "merged", ignore_errors=True)


def resume(root: Path) -> None:
    recipe = fake_samples.recipe()
    shard = Shard(root / "train", 0, 10, recipe.names)
    shard.missing(4)
    if shard.needs_join(4):
        shard.join(4)


@given(st.data())
@files
def test_a_data_set_with_a_file_damaged(tmp_path_factory, small, data):
    root = tmp_path_factory.getbasetemp() / "damaged" / "d"
    shutil.rmtree(root.parent, ignore_errors=True)
    shutil.copytree(small, root)
    name = data.draw(st.sampled_from(["dataset.json", "train/00000.parquet", "train/00000.tar"]))
    whole = (root / name).read_bytes()
    (root / name).write_bytes(data.draw(mutated(whole, is_json=name.endswith("json"))))
    if data.draw(st.booleans()):
        (root / "train/00000.parquet").unlink()
    use(root)


def test_reading_an_index_leaves_no_thread_that_holds_it(small):
    """Arrow's threads that still hold a Python object when the interpreter ends abort the process."""
    data = (small / "train/00000.parquet").read_bytes()
    holders = sys.getrefcount(data)
    damaged = bytes([*data[:4], *b"\xff" * 60, *data[64:]])
    for _ in range(20):
        assert read_indices(data, WHERE) == {0, 1, 2, 3}
        with pytest.raises(FormatError, match=f"^{WHERE}: expected the index of a shard"):
            read_index(damaged, WHERE)
        assert (sys.getrefcount(data), sys.getrefcount(damaged)) == (holders, holders)


BIG = 2**63 - 1


@given(st.data())
@files
def test_a_data_set_whose_index_lies(tmp_path_factory, small, data):
    """The index is a parquet as it should be; its numbers, types, rows or columns are not."""
    root = tmp_path_factory.getbasetemp() / "lying" / "d"
    shutil.rmtree(root.parent, ignore_errors=True)
    shutil.copytree(small, root)
    path = root / "train/00000.parquet"
    table = pq.read_table(path)
    column = data.draw(
        st.sampled_from(["key", "index", "image_offset", "image_size", "scene_offset", "labels_size", "n_lanes"])
    )
    values, n = table[column].to_pylist(), len(table)
    numbers = [-1, 0, 1, 511, 513, 2**31, 2**62, BIG, -BIG]
    wrong = data.draw(
        st.sampled_from(["", "1", "00000009", "../../x", "\0", "x" * 100_000] if column == "key" else numbers)
    )
    columns = [
        *[pa.array([values[0], wrong, *values[2:]])] * 3,
        *(pa.array(map(kind, values)) for kind in (str, lambda value: [value], bool, lambda _: float("nan"))),
        *(pa.array([other] * n) for other in (b"\xff\xfe", {"a": 1})),
        pa.array([values[0], None, *values[2:]], table[column].type),
    ]
    tables = [
        *(table.set_column(table.column_names.index(column), column, values) for values in columns),
        *(table[:0], pa.concat_tables([table] * 2), pa.concat_tables([table] * 3), table.drop_columns([column])),
        table.append_column(column, table[column]),
    ]
    pq.write_table(tables[data.draw(st.integers(0, len(tables) - 1))], path)
    use(root)
