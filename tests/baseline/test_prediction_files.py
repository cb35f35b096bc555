"""Predictions, pictures and videos on a disk that fills up, and after a power cut."""

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline.checkpoint import SHIPPED, detector
from synth3dlanes_baseline.predict import PredictConfig, predict

from synth3dlanes.imaging.video import mp4
from tests.power_cut import survive
from tests.small_files import withstands
from tests.thorough import first


@pytest.fixture(scope="module")
def source(roads, tmp_path_factory):
    """Drawn pictures, in a folder and as a video."""
    folder = tmp_path_factory.mktemp("source")
    (folder / "pictures").mkdir()
    with (folder / "drive.mp4").open("w+b") as stream, mp4("drive.mp4", stream, 10.0) as video:
        for number, sample in enumerate(roads.samples(np.random.default_rng(4), 3, (320, 240))):
            Image.fromarray(sample.image).save(folder / f"pictures/{number}.png")
            video.add(sample.image)
    return folder


@pytest.mark.parametrize("name", first(1, ["pictures", "drive.mp4"]))
def test_a_full_disk(source, tmp_path, name):
    from synth3dlanes_cli.main import main

    words = ["predict", str(source / name), "--out", str(tmp_path / "out"), "--device", "cpu"]
    (tmp_path / "out").mkdir()
    withstands(lambda: CliRunner().invoke(main, words), tmp_path / "out")


@pytest.mark.parametrize("name", first(1, ["pictures", "drive.mp4"]))
def test_a_power_cut(source, tmp_path, name):
    network = detector(SHIPPED, torch.device("cpu"))
    survive(lambda out: predict(network, source / name, out, PredictConfig()), tmp_path, 4)
