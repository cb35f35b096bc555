"""Every example of docs/loaders.md runs on a dataset of ours and finds its last sample; all samples of a data set have
one schema."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import ground_truth
from tests import fake_samples
from tests.thorough import first

PAGE = Path(__file__).parents[2] / "docs/loaders.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def run(example, dataset, home):
    # In a process of its own: the foreign libraries' warnings are not ours.
    environment = {"HF_HOME": str(home), "HF_HUB_OFFLINE": "1", "PATH": "/usr/bin:/bin", "HOME": str(home)}
    command = [sys.executable, "-c", example.replace("DIR", str(dataset))]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=PAGE.parents[1], check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


NAMES = ("webdataset", "datasets", "datasets, Json", "croissant")


@pytest.mark.parametrize("example", first(1, EXAMPLES[:4]), ids=NAMES)
def test_streams_end_at_our_last_sample(example, dataset, tmp_path):
    last = Reader(f"{dataset}/train")[-1]
    assert run(example, dataset, tmp_path) == [f"{last.key} {last.image.shape} {len(last.labels.lanes)}"]


@pytest.mark.thorough
def test_torch_sees_every_sample_once(dataset, tmp_path):
    # Seven samples in batches of two.
    assert run(EXAMPLES[4], dataset, tmp_path) == ["(2, 360, 480, 3)"] * 3 + ["(1, 360, 480, 3)"]


def keys_of(document, path=""):
    """Every object's keys by its path; those of a list's objects must be equal."""
    if isinstance(document, list):
        for item in document:
            yield from keys_of(item, f"{path}.*")
    elif isinstance(document, dict):
        yield path, tuple(document)
        for key, value in document.items():
            yield from keys_of(value, f"{path}.{key}")


SMALL = ("camera.width_px=48", "camera.height_px=32")
RIG = tuple(load_rig("nuscenes")[:2])


def test_scenes_and_labels_of_all_recipes_have_one_schema():
    found = {}
    recipes = [(name, Shots()) for name in ("streets", "appendix_i", "realistic", "tiny")]
    recipes += [("streets", clips(3, 10)), ("streets", Shots(cameras=RIG, lidar=load_lidar("vlp_32c")))]
    for preset, shots in recipes:
        for index in range(3):
            scene = sample_scene(Scenes(load_params(preset), 1, "train", shots=shots), index)
            for text in (scene_file.to_json(scene), label_file.to_json(ground_truth(scene))):
                document = json.loads(text)
                for path, keys in keys_of(document, document["format"]):
                    # Of the graph's segments, by their names.
                    if not path.endswith(".successors"):
                        assert found.setdefault(path, keys) == keys, (preset, path)
    assert {path.rpartition(".")[2] for path in found} >= {"weather", "roadside", "shot", "lidar", "lens", "camera"}


@pytest.mark.thorough
@pytest.mark.parametrize("shots", [Shots(), Shots(cameras=RIG)], ids=["streets", "rig"])
def test_tars_of_streets_become_arrow_tables(tmp_path, shots):
    # The page says that what the first five samples lack is refused: signs and signals are seldom in all of them.
    params = load_params("streets", (*SMALL, "roadside.exit_signs=false", "roadside.lane_signals=false"))
    recipe = Recipe(Scenes(params, 1, "train", shots=shots), RenderSettings(), "jpg")
    generate(Plan(str(tmp_path / "data"), 16, recipe, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    columns = EXAMPLES[1].replace(", streaming=True", "")
    reader = Reader(str(tmp_path / "data/train"))
    expected = f"{reader.key(15)} {reader[15].image.shape} {len(reader.labels(15).lanes)}"
    assert run(columns, tmp_path / "data", tmp_path) == [expected]
