"""The command as a user runs it, in this process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result


@pytest.fixture
def run(in_tmp_path: object) -> Callable[..., Result]:
    """`run("sample", "--n", 3)` in an empty working directory."""
    from synth3dlanes_cli.main import main

    return lambda *arguments: CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="session")
def folder(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """A data set of 12 scenes of Appendix I, labelled, on images without contents."""
    from synth3dlanes.dataset.folder import claim
    from synth3dlanes.dataset.format import Picture, encode
    from synth3dlanes.dataset.write import Shard
    from synth3dlanes.draw.sample import Scenes, sample_scene
    from synth3dlanes.params.params import load_params
    from synth3dlanes.production.recipe import Recipe
    from synth3dlanes.scene import scene as scene_module
    from synth3dlanes.scene.settings import RenderSettings
    from synth3dlanes.truth.ground_truth import ground_truth

    params = load_params("appendix_i", ["trees.n=5", "cars.n=3"])
    recipe = Recipe(Scenes(params), RenderSettings(), "png")

    def make(made: Path) -> None:
        with claim(made / "d", {**recipe.description(), "shard_size": 5}, "train", 12, range(3)) as split:
            for number in range(3):
                shard = Shard(split, number, 5, recipe.names)
                for index in shard.indices(12):
                    scene = sample_scene(Scenes(params), index)
                    image = np.full((360, 480, 3), 20 * index, np.uint8)
                    members = encode(Picture(image, ground_truth(scene)), scene_module.to_json(scene), "png")
                    shard.write_part(index, members)
                shard.join(12)

    return made_once("cli", make) / "d"
