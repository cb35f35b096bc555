"""Each scene is the one that dataset.json draws, and each shard was made from what dataset.json says."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from synth3dlanes import __version__
from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import SCENE, Picture, encode
from synth3dlanes.dataset.index import read_recipe
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.findings import Problem
from synth3dlanes.validate.origin import Origin, drawn_otherwise
from tests import fake_samples
from tests.thorough import presets
from tests.validate import examining
from tests.validate.sealing import check, describe, seal

N, SEED = 4, 7
RECIPE = Recipe(Scenes(load_params("tiny"), SEED, "train"), RenderSettings(), "png")


def seen(scene: Scene) -> Labels:
    """The labels of a scene in which nothing hides anything."""
    return examining.seen(ground_truth(scene)).with_seen_shares((1.0,) * len(scene.cars))


def draw(root: Path, recipe: Recipe = RECIPE, n: int = N) -> Path:
    """A data set of scenes that were never rendered. Of images of another size than the camera's no pixel is asked."""
    description = {**recipe.description(), "shard_size": 1000}
    with claim(root, description, recipe.scenes.split, n, [0]) as folder:
        shard = Shard(folder, 0, 1000, recipe.names, recipe_text(description))
        for index in range(n):
            scene = recipe.scene(index)
            text, image = scene_module.to_json(scene), np.full((8, 8, 3), 100, np.uint8)
            shard.write_part(index, encode(Picture(image, seen(scene)), text, "png"))
        shard.join(n)
    return root


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return draw(tmp_path_factory.mktemp("origin") / "data")


@pytest.fixture
def dataset(drawn: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(drawn, tmp_path / "data"))


def problems(root: Path) -> list[Problem]:
    """What is said about where samples come from; the images are another matter."""
    return [found for found in check(root).problems if "dataset.json" in (found.where, *found.reason.split(" "))]


def edit(root: Path, index: int, change: Callable[[dict], object], split: str = "train") -> None:
    """Change a sample's scene.json, and seal the data set again."""

    def apply(samples: dict[int, dict[str, bytes]]) -> None:
        document = json.loads(samples[index][SCENE])
        change(document)
        samples[index][SCENE] = json.dumps(document).encode()

    seal(root, apply, split)


@pytest.mark.parametrize("preset", presets("appendix_i", "streets"))
def test_scenes_are_those_drawn_again(preset: str) -> None:
    recipe = replace(RECIPE, scenes=replace(RECIPE.scenes, params=load_params(preset)))
    origin = Origin.model_validate(json.loads(json.dumps(recipe.description())))
    for index in range(3):
        scene = scene_module.from_json(scene_module.to_json(recipe.scene(index)), "")
        assert origin.fault(scene, "train", index) == ""
        assert origin.fault(scene, "train", index + 1).startswith(f"index: expected {index + 1}, got {index}; ")


def test_a_data_set_as_drawn_has_nothing_said_about_it(drawn: Path) -> None:
    assert problems(drawn) == []


def test_edited_scenes_are_named_with_what_was_edited(dataset: Path) -> None:
    paths, before = ("light.exposure", "trees.0.x_m", "camera.offset_m", "markings.wear"), []
    for index, path in enumerate(paths):
        scene = RECIPE.scene(index)
        changed = change_scene(scene, [f"{path}=0.25"]).model_dump(mode="json")
        edit(dataset, index, lambda document, changed=changed: document.update(changed))
        value: object = scene.model_dump(mode="json")
        for step in path.split("."):
            value = value[int(step)] if isinstance(value, list) else value[step]
        before.append(value)
    found = problems(dataset)
    assert [problem.where for problem in found] == [f"train:{index:08d}" for index in range(N)]
    for problem, path, value in zip(found, paths, before, strict=True):
        assert problem.reason.endswith(f"{path}: expected {value}, got 0.25")


@pytest.mark.parametrize("rewritten", [{"split": "test"}, {"split": "test", "seed": 8}, {"split": "test", "index": 0}])
def test_a_split_of_another_splits_scenes_is_found_whatever_numbers_they_have(dataset: Path, rewritten: dict) -> None:
    (dataset / "train").rename(dataset / "test")
    describe(dataset, lambda document: document.update(splits={"test": {"n": N}}, seed=rewritten.get("seed", SEED)))

    def change(samples: dict[int, dict[str, bytes]]) -> None:
        for index, members in samples.items():
            members[SCENE] = json.dumps({**json.loads(members[SCENE]), "index": index, **rewritten}).encode()

    seal(dataset, change, "test")
    found = problems(dataset)
    assert sorted(problem.where for problem in found) == [f"test:{index:08d}" for index in range(N)]
    assert all("not what dataset.json draws: " in problem.reason for problem in found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda document: document["params"]["light"].update(exposure=[5, 6]),
            "params.light.exposure.0: expected 1, got 5",
        ),
        (lambda document: document.update(generator="9.9"), f'generator: expected "{__version__}", got "9.9"'),
        (lambda document: document["render"].update(samples=5), "render.samples: expected 4, got 5"),
        (lambda document: document.update(seed=8), "seed: expected 7, got 8"),
        (lambda document: document.update(shard_size=999), "shard_size: expected 1000, got 999"),
        (lambda document: document.update(more=1), "more: "),
        (lambda document: document["params"]["light"].pop("exposure"), "params.light.exposure: missing"),
        (lambda document: document["params"]["light"].update(exposure=[6, 5]), "expected [low, high] with low <= high"),
        (lambda document: document["params"]["road"].update(flip_lateral={"[": 1}), "flip_lateral: expected true"),
        (lambda document: document["splits"].update(train=5), "splits.train: "),
        (lambda document: document.pop("render"), "render: missing"),
        (lambda document: document.update(splits=[]), "splits: "),
    ],
)
def test_an_edited_description_is_a_problem_of_dataset_json_alone(dataset: Path, change: Callable, words: str) -> None:
    describe(dataset, change)
    found = problems(dataset)
    assert {problem.where for problem in found} == {"dataset.json"}
    assert len(found) <= 2
    assert any(words in problem.reason for problem in found), found


def test_many_samples_that_fit_no_recipe_are_one_problem_of_an_edited_description() -> None:
    faults = {f"train:{index:08d}": "light.exposure: expected 1, got 2" for index in range(5)}
    for recipe, is_one in (("", False), ("{}", False), ("[]", True)):
        found = list(drawn_otherwise(faults, 9, __version__, {"train/00000": recipe}, "{}"))
        assert [problem.where for problem in found] == (["dataset.json"] if is_one else list(faults))


def test_scenes_of_another_version_are_one_problem_that_names_it() -> None:
    (found,) = drawn_otherwise({"train:00000003": "light.exposure: expected 1, got 2"}, 9, "0.0.1", {"0": "{}"}, "{}")
    assert found.where == "dataset.json"
    assert found.reason.startswith(
        f"made by version 0.0.1, which drew other scenes than this one, {__version__}, for 1 of 9"
    )
    assert list(drawn_otherwise({}, 9, "0.0.1", {"0": "{}"}, "{}")) == []


def test_params_that_draw_nothing_are_a_problem_of_dataset_json(dataset: Path) -> None:
    describe(dataset, lambda document: document["params"]["cars"].update(model=[900, 999]))
    assert any("cannot be drawn again: " in found.reason for found in problems(dataset))


def test_a_shard_of_another_recipe_than_the_others_is_named(dataset: Path, tmp_path: Path) -> None:
    describe(dataset, lambda document: document.update(splits={"train": {"n": 1002}}))
    made = {**RECIPE.description(), "shard_size": 1000, "seed": 8}
    other = Shard(dataset / "train", 1, 1000, RECIPE.names, recipe_text(made))
    raw = Reader(f"{dataset}/train").raw(0)
    for index in (1000, 1001):
        other.write_part(index, raw)
    other.join(1002)
    named = [found for found in problems(dataset) if found.where == "train/00001.parquet"]
    assert ["seed: expected 7, got 8" in found.reason for found in named] == [True]


def test_a_shard_that_does_not_say_its_recipe_is_accepted(dataset: Path) -> None:
    path = dataset / "train/00000.parquet"
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata(None), path)
    assert problems(dataset) == []


def recipes(root: Path) -> set[str]:
    return {read_recipe(path.read_bytes(), str(path)) for path in root.glob("*/*.parquet")}


def test_whoever_makes_a_shard_notes_the_same_recipe_in_it(tmp_path: Path) -> None:
    """On this machine and for a store; resumed; merged of parts; in the same bytes."""

    def made(name: str, n: int, part: tuple[int, int] = (1, 1), url: bool = False) -> Path:
        root = tmp_path / name
        out = root.as_uri() if url else root
        plan = Plan(out, n, fake_samples.recipe(), 1, part, shard_size=2, maker=fake_samples.make)
        assert generate(plan, lambda event: None).exit_code == 0
        return root

    whole = made("whole", 5)
    made("resumed", 3)
    merge([str(made("a", 5, (1, 2))), str(made("b", 5, (2, 2)))], str(tmp_path / "merged"))
    assert recipes(whole) == {recipe_text(json.loads((whole / "dataset.json").read_text()))}
    for other in (made("resumed", 5), made("store", 5, url=True), tmp_path / "merged"):
        for path in whole.glob("train/0*"):
            assert (other / "train" / path.name).read_bytes() == path.read_bytes(), other


def test_the_recipe_does_not_depend_on_how_numbers_are_written() -> None:
    description = RECIPE.description()
    read = json.loads(json.dumps(description))
    assert recipe_text({**read, "splits": {}, "seed": 7.0}) == recipe_text(description)
    assert recipe_text({**read, "seed": 7.5}) != recipe_text(description)


def test_dealt_and_varied_sets_are_drawn_again_too(drawn: Path, tmp_path: Path) -> None:
    """Also of each other: a cut of twins, twins of a cut, twins of twins."""
    split_dataset(Reader(f"{drawn}/train"), {"x": 1, "y": 1}, 0, str(tmp_path / "cut"))
    for source in (drawn / "train", tmp_path / "cut/x"):
        for recipe in twin_recipes(str(source), "light.exposure=1.25,2.25", "cpu"):
            draw(tmp_path / f"twins_of_{source.name}", recipe, len(Reader(str(source))))
    split_dataset(Reader(f"{tmp_path}/twins_of_train/twin_2"), {"all": 1}, 0, str(tmp_path / "cut_twins"))
    for recipe in twin_recipes(f"{tmp_path}/cut_twins/all", "camera.height_m=1.5", "cpu"):
        draw(tmp_path / "twins_twice", recipe)
    twice = scene_module.from_json(Reader(f"{tmp_path}/twins_twice/twin_1").raw(0)[SCENE], "")
    assert (twice.light.exposure, twice.camera.height_m) == (2.25, 1.5)
    for name in ("cut", "twins_of_train", "twins_of_x", "cut_twins", "twins_twice"):
        root = tmp_path / name
        assert problems(root) == [], name
        assert recipes(root) == {recipe_text(json.loads((root / "dataset.json").read_text()))}
        split = sorted(path.parent.name for path in root.glob("*/*.parquet"))[-1]
        edit(root, 0, lambda document: document["light"].update(exposure=9.75), split)
        (found,) = problems(root)
        assert found.where == f"{split}:00000000"
        assert "light.exposure: expected" in found.reason


def test_frames_of_clips_are_drawn_again_too(tmp_path: Path) -> None:
    """Also dealt, and with a factor varied; none is said to repeat another's world."""
    recipe = replace(RECIPE, scenes=replace(RECIPE.scenes, shots=clips(2, 10)))
    draw(tmp_path / "clips", recipe, 6)
    split_dataset(Reader(f"{tmp_path}/clips/train"), {"x": 2, "y": 1}, 0, str(tmp_path / "cut"))
    for twins in twin_recipes(f"{tmp_path}/cut/x", "light.exposure=1.25,2.25", "cpu"):
        draw(tmp_path / "twins", twins, 4)
    for name, split in (("clips", "train"), ("cut", "x"), ("twins", "twin_2")):
        report = check(tmp_path / name)
        assert [found for found in report.problems if "scene of its own" in found.reason] == []
        assert problems(tmp_path / name) == [], name
        edit(tmp_path / name, 1, lambda document: document["shot"].update(speed_m_s=9.75), split)
        (found,) = problems(tmp_path / name)
        assert found.where == f"{split}:00000001"
        assert "shot.speed_m_s: expected" in found.reason


def test_a_set_made_of_older_shards_does_not_say_more_than_they_do(dataset: Path, tmp_path: Path) -> None:
    path = dataset / "train/00000.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata(None), path)
    merge([str(dataset)], str(tmp_path / "merged"))
    split_dataset(Reader(f"{dataset}/train"), {"all": 1}, 0, str(tmp_path / "cut"))
    assert recipes(tmp_path / "merged") == recipes(tmp_path / "cut") == {""}
    assert problems(tmp_path / "merged") == problems(tmp_path / "cut") == []
