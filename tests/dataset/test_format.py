"""Sample <-> members <-> tar bytes; `dataset.json` that people have edited: every fault is named by its key."""

import io
import json
import tarfile
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.dataset.description import parse_description, recipe_text, updated_description
from synth3dlanes.dataset.format import decode_image, encode_image, read_passes, tar_bytes, tar_end, write_passes
from synth3dlanes.system.errors import FormatError
from tests import fake_samples


@given(st.lists(st.binary(max_size=2000), min_size=1, max_size=5))
def test_pieces_joined_are_a_tar_that_tarfile_reads(blobs):
    pieces = b"".join(tar_bytes(f"{i:08d}", {"jpg": blob, "scene.json": blob[::-1]}) for i, blob in enumerate(blobs))
    whole = pieces + tar_end(len(pieces))
    assert len(whole) % tarfile.RECORDSIZE == 0
    with tarfile.open(fileobj=io.BytesIO(whole), mode="r:") as tar:
        assert tar.getnames() == [f"{i:08d}.{name}" for i in range(len(blobs)) for name in ("jpg", "scene.json")]
        for i, blob in enumerate(blobs):
            assert tar.extractfile(f"{i:08d}.jpg").read() == blob
        assert {(m.mtime, m.uid, m.gid, m.uname) for m in tar.getmembers()} == {(0, 0, 0, "")}


def passes(rng, max_instance):
    depth = rng.uniform(0.1, 200, (12, 20)).astype(np.float32)
    depth[0] = np.inf
    normal = rng.normal(size=(12, 20, 3))
    normal = (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)
    semantic = rng.integers(0, 7, (12, 20)).astype(np.uint8)
    instance = rng.integers(0, max_instance + 1, (12, 20)).astype(np.uint16)
    instance[0, 0] = max_instance
    return {"depth": depth, "normal": normal, "semantic": semantic, "instance": instance}


@pytest.mark.parametrize("max_instance", [0, 2048, 65535])
def test_passes_come_back_exactly_and_normals_to_half_precision(max_instance):
    before = passes(np.random.default_rng(1), max_instance)
    data = write_passes(before)
    assert data == write_passes(before)
    after = read_passes(data, "x.exr")
    assert set(after) == set(before)
    for name in ("depth", "semantic", "instance"):
        np.testing.assert_array_equal(after[name], before[name])
        assert after[name].dtype == before[name].dtype
    assert np.abs(after["normal"] - before["normal"]).max() < 1e-3


def test_png_is_exact_and_jpg_is_close():
    rows, columns = np.mgrid[:48, :64]
    image = np.stack([rows * 4, columns * 3, rows + columns], axis=-1).astype(np.uint8)
    np.testing.assert_array_equal(decode_image(encode_image(image, "png"), "x"), image)
    assert np.abs(decode_image(encode_image(image, "jpg"), "x").astype(int) - image).mean() < 2


DESCRIPTION = {**fake_samples.recipe().description(), "shard_size": 10}
TEXT = updated_description(None, DESCRIPTION, "train", 5, "dataset.json")


@pytest.mark.parametrize("text", [b"[]", b'{"format": "synth3dlanes.dataset", "version": 2}', b'{"version": 1}'])
def test_another_version_is_refused(text):
    with pytest.raises(FormatError, match="version 1, got"):
        parse_description(text, "dataset.json")


def test_what_is_written_is_read_and_written_again():
    assert parse_description(TEXT, "x")["splits"] == {"train": {"n": 5}}
    assert updated_description(TEXT, DESCRIPTION, "train", 3, "x") == TEXT
    assert recipe_text(parse_description(TEXT, "x")) == recipe_text(DESCRIPTION)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda d: d["splits"].update(train=5), "splits.train: expected an object, got 5"),
        (lambda d: d["splits"].update(train={"n": -1}), "splits.train.n: .*, got -1"),
        (lambda d: d.pop("splits"), "splits: missing"),
        (lambda d: d.update(image_format="gif"), "image_format: .*, got 'gif'"),
        (lambda d: d["render"].pop("passes"), "render.passes: missing"),
        (lambda d: d["render"].update(passes=["smell"]), "render.passes.0: .*, got 'smell'"),
        (lambda d: d.update(shard_size=0), "shard_size: .*, got 0"),
        (lambda d: d.update(sede=1), "sede: unknown key"),
    ],
)
def test_an_edited_key_is_named(change: Callable, line: str):
    document = json.loads(TEXT)
    change(document)
    text = json.dumps(document).encode()
    for read in (parse_description, lambda text, name: updated_description(text, DESCRIPTION, "train", 5, name)):
        with pytest.raises(FormatError, match=rf"^a/dataset\.json: {line}"):
            read(text, "a/dataset.json")
