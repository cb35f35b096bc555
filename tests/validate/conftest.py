"""A small real dataset, rendered once; `sealing.py` changes copies of it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

N = 4
# Bright paint, so that every line shows in the image; objects enough to hide something.
CHANGES = ["markings.grayscale=0.9", "cars.n=16", "trees.n=80"]
# What the labels must hold against beyond the paper.
CHANGES += ["camera.roll_deg=[-2, 2]", "camera.principal_offset_px=[-8, 8]", "markings.left_double={true: 1, false: 1}"]
CHANGES += ["markings.left_yellow={true: 1, false: 1}", "markings.wear=[0, 0.5]", "surface.wetness={0: 1, 0.8: 1}"]


@pytest.fixture(scope="session")
def rendered(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    from synth3dlanes.draw.sample import Scenes
    from synth3dlanes.params.params import load_params
    from synth3dlanes.production.plan import Plan
    from synth3dlanes.production.recipe import Recipe
    from synth3dlanes.production.run import generate
    from synth3dlanes.scene.settings import RenderSettings

    settings = RenderSettings(samples=2, passes=("depth", "normal", "semantic", "instance", "height"), device="cpu")
    recipe = Recipe(Scenes(load_params("appendix_i", CHANGES), 4, "train"), settings, "jpg")

    def make(root: Path) -> None:
        assert generate(Plan(root, N, recipe, workers=1), lambda event: None).exit_code == 0

    return made_once("validate", make)


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Have `validate` in this process look at samples by these checks alone, and at files as always."""
    from synth3dlanes.validate.checks import CHECKS

    def limit(*names: str) -> None:
        asked = tuple(check for check in CHECKS if check.name in names)
        assert len(asked) == len(names)
        monkeypatch.setattr("synth3dlanes.validate.run.CHECKS", asked)

    return limit


@pytest.fixture
def dataset(rendered: Path, tmp_path: Path) -> Path:
    """A copy of the dataset, free to be spoilt."""
    return Path(shutil.copytree(rendered, tmp_path / "data"))
