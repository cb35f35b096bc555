"""Arguments of another type, or empty, are refused by name: no function of the library shows a raw error."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import synth3dlanes as s3d
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

FUNCTIONS = {name: found for name in s3d.__all__ if inspect.isfunction(found := getattr(s3d, name))}
READER = ("__getitem__", "image", "labels", "objects", "key", "raw", "member", "position", "clip", "taken_by")
METHODS = {
    "Reader": s3d.Reader,
    "Renderer": s3d.Renderer,
    **{f"Reader.{name}": getattr(s3d.Reader, name) for name in READER},
    "Renderer.render": s3d.Renderer.render,
    "Rendered.save": s3d.Rendered.save,
}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A data set of three samples without real images."""
    out = tmp_path_factory.mktemp("arguments") / "d"
    generate(Plan(out, 3, fake_samples.recipe(), workers=1, maker=fake_samples.make), lambda event: None)
    return str(out)


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_an_argument_of_another_type_is_named(name: str) -> None:
    function: Callable[..., Any] = (FUNCTIONS | METHODS)[name]
    known = inspect.signature(function).parameters.values()
    parameters = [each.name for each in known if each.name != "self" and each.kind != each.VAR_KEYWORD]
    of_object = {"self": None} if "." in name else {}
    with pytest.raises(s3d.InputError) as caught:
        function(**of_object, **dict.fromkeys(parameters, object()))
    assert [line.partition(": expected ")[0] for line in caught.value.problems] == parameters


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("seed", (1.5, True, "1", float("nan"), -1, 2**129)),
        ("index", (1.5, "0", -1, 10**13)),
        ("split", ("a/b", "", "a b", "\0", 3)),
        ("frames", (0, 1.5, "2", 10**9)),
        ("fps", (0.0, -1, float("nan"), float("inf"), "10")),
        ("rig", (3, "", {})),
        ("params", (3, "", [])),
    ],
)
def test_values_that_no_scene_has(kind: str, wrong: tuple[object, ...]) -> None:
    arguments = {"params": s3d.load_params("tiny"), "frames": 2}
    for value in wrong:
        with pytest.raises(s3d.InputError, match=f"^{kind}: expected "):
            s3d.sample_scene(**{**arguments, kind: value})


def test_numbers_of_numpy_are_numbers() -> None:
    params = s3d.load_params("tiny")
    assert s3d.sample_scene(params, seed=np.int64(3), frames=np.uint8(2), fps=np.float32(5)) == s3d.sample_scene(
        params, seed=3, frames=2, fps=5
    )


def test_nothing_to_split_or_merge_and_no_single_sample(source: str, tmp_path: Path) -> None:
    for shares in ({}, {"a": 0.0}, {"a": -1.0, "b": 2.0}, {"a/b": 1.0}, {"": 1.0}, {"a": float("nan")}):
        with pytest.raises(s3d.InputError, match=r"^shares: expected "):
            s3d.split_dataset(source, tmp_path / "out", shares)
    with pytest.raises(s3d.InputError, match=r"^sources: expected the data sets to merge, got none"):
        s3d.merge_datasets([], tmp_path / "out")
    with pytest.raises(s3d.InputError, match=r"^sources: expected a sequence of "):
        s3d.merge_datasets(source, tmp_path / "out")
    reader = s3d.open_dataset(source)
    for wrong in (slice(0, 2), 1.5, "0", None, True):
        with pytest.raises(s3d.InputError, match=r"^i: expected a whole number, got "):
            reader[wrong]
    assert reader[np.int64(-1)].key == reader[2].key == "00000002"
    with pytest.raises(s3d.InputError, match=r"^path: expected the path of a file, got ''"):
        s3d.save_scene(s3d.sample_scene(s3d.load_params("tiny")), "")
    assert not (tmp_path / "out").exists()
