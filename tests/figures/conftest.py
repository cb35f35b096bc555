"""Scenes, labels and images for the tests of figures."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures.page import report_page
from synth3dlanes.figures.stats import label_statistics, scene_statistics
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.scene import Car, Scene, Tree
from synth3dlanes.truth.ground_truth import ground_truth
from tests.browser import browser as browser
from tests.browser import open_page as open_page
from tests.scenes import FLAT, changed, hill

CARS = (
    Car(model=2, scale=1.0, color=(0.8, 0.1, 0.1), gloss=0.5, lane="main_1", s_m=-20.0),
    Car(model=6, scale=1.0, color=(0.2, 0.3, 0.9), gloss=0.5, lane="main_2", s_m=30.0),
)
TREES = (Tree(model=1, x_m=14.0, y_m=0.0, yaw_rad=0.0, scale=1.0),)


@pytest.fixture
def flat_scene() -> Scene:
    """A straight, flat road with two cars and a tree."""
    return FLAT.model_copy(update={"cars": CARS, "trees": TREES})


@pytest.fixture
def exit_scene() -> Scene:
    """A hilly, curved road onto which two lanes merge from the left, over a ramp."""
    road = {"topology": 4, "flip_lateral": True, "flip_longitudinal": True, "offset_p50_m": 4.0, "offset_p100_m": 7.0}
    hills = (hill(20, 30, 9, 40), hill(-60, -40, -12, 60))
    scene = changed(FLAT, road=road, terrain={"gaussians": hills})
    # Its second lane ends where the ramp is.
    cars = (CARS[0], CARS[1].model_copy(update={"s_m": -10.0}))
    return scene.model_copy(update={"cars": cars, "trees": TREES})


@pytest.fixture
def gray_image() -> np.ndarray:
    return np.full((360, 480, 3), 120, dtype=np.uint8)


@pytest.fixture(scope="session")
def report() -> str:
    """The page of a set of two samples."""
    params = load_params("appendix_i", ["trees.n=5", "cars.n=3"])
    scenes = [sample_scene(Scenes(params, 1, "train"), index) for index in range(2)]
    labels = [ground_truth(scene) for scene in scenes]
    image = np.full((360, 480, 3), 120, dtype=np.uint8)
    samples = [(f"train:{scene.index:08d}", scene, one, image) for scene, one in zip(scenes, labels, strict=True)]
    declared = load_params("appendix_i", ["trees.n=5", "cars.n=3", "camera.height_m=[1.0, 1.1]"])
    return report_page("a <set>", samples, scene_statistics(scenes, declared), label_statistics(labels))
