"""The golden scenes and labels: `python -m tests.golden.make` rewrites them (`make golden`)."""

from pathlib import Path

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.params import load_params
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.truth.ground_truth import ground_truth

# Name -> index of the scene in split "golden" of seed 0: a split, a merge from the left, and a plain road.
GOLDEN = {"split": 1, "left_merge": 20, "plain": 0}


def golden_text(name: str) -> tuple[str, str]:
    """scene.json and labels.json of a golden scene."""
    params = load_params("appendix_i", ["trees.n=40"])
    scene = sample_scene(Scenes(params, 0, "golden"), GOLDEN[name])
    return scene_file.to_json(scene) + "\n", label_file.to_json(ground_truth(scene)) + "\n"


if __name__ == "__main__":
    for name in GOLDEN:
        for kind, text in zip(("scene", "labels"), golden_text(name), strict=True):
            (Path(__file__).parent / f"{name}.{kind}.json").write_text(text)
