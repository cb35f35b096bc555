"""`dataset.json` that people have edited: every fault is named by its key, and no command meets a traceback."""

import json
from collections.abc import Callable

import pytest

from synth3dlanes.dataset.description import parse_description, recipe_text, updated_description
from synth3dlanes.system.errors import FormatError
from tests import fake_samples

RECIPE = {**fake_samples.recipe().description(), "shard_size": 10}
TEXT = updated_description(None, RECIPE, "train", 5, "dataset.json")


@pytest.mark.parametrize("text", [b"[]", b'{"format": "synth3dlanes.dataset", "version": 2}', b'{"version": 1}'])
def test_another_version_is_refused(text):
    with pytest.raises(FormatError, match="version 1, got"):
        parse_description(text, "dataset.json")


def test_what_is_written_is_read_and_written_again():
    assert parse_description(TEXT, "x")["splits"] == {"train": {"n": 5}}
    assert updated_description(TEXT, RECIPE, "train", 3, "x") == TEXT
    assert recipe_text(parse_description(TEXT, "x")) == recipe_text(RECIPE)


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
    for read in (parse_description, lambda text, name: updated_description(text, RECIPE, "train", 5, name)):
        with pytest.raises(FormatError, match=rf"^a/dataset\.json: {line}"):
            read(text, "a/dataset.json")
