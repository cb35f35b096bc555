"""What training and detection write: through no link, on a full disk, and after a power cut."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.checkpoint import SHIPPED, detector
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.data import CameraImage, intrinsics_of
from synth3dlanes_baseline.lanes import write_predictions
from synth3dlanes_baseline.loading import annotation_file
from synth3dlanes_baseline.overlay import save_pictures
from synth3dlanes_baseline.predict import PredictConfig, predict
from synth3dlanes_baseline.progress import TrainingLog

from synth3dlanes.imaging.video import mp4
from synth3dlanes.system.errors import LinkError
from tests.baseline import roads
from tests.power_cut import survive
from tests.small_files import withstands
from tests.thorough import first


def writers(out: Path):
    labels = roads.labels([lambda y: (0 * y, 0 * y)])
    prediction = roads.as_prediction(labels)
    image = CameraImage("0", np.zeros((360, 480, 3), np.uint8), intrinsics_of(labels), labels)
    state = checkpoint.Checkpoint(train_config("nano", {}), {}, {"weight": torch.zeros(1)}, None)

    def pictures() -> None:
        save_pictures(out / "00000000", image, prediction)

    def log() -> None:
        with TrainingLog(out, 1, 1, 0, 1, is_shown=True) as history:
            history.step(1, 0.1, {"total": torch.zeros(())})

    return {
        "last.pt": lambda: checkpoint.save(out / "last.pt", state),
        "best.pt": lambda: checkpoint.save(out / "best.pt", state),
        "annotations.cache": lambda: annotation_file(out / "annotations.cache", "here"),
        "predictions.jsonl": lambda: write_predictions(out / "predictions.jsonl", [prediction]),
        "00000000.png": pictures,
        "00000000.overlay.jpg": pictures,
        "history.jsonl": log,
        "tensorboard": log,
    }


@pytest.mark.parametrize("name", writers(Path()))
@pytest.mark.parametrize("is_hard", [False, True])
def test_a_link_in_the_way_stays_and_what_it_points_to(tmp_path, name, is_hard):
    out, document = tmp_path / "out", tmp_path / "thesis.tex"
    out.mkdir()
    document.write_text("years of work")
    write = writers(out)[name]
    if name == "tensorboard":
        pytest.importorskip("tensorboard")
        (out / name).symlink_to(tmp_path)
    elif is_hard:
        (out / name).hardlink_to(document)
    else:
        (out / name).symlink_to(document)
    # A name of a file that is replaced whole may be another's too; one that is written in place may not.
    if is_hard and name not in ("annotations.cache", "history.jsonl", "tensorboard"):
        write()
    else:
        with pytest.raises(LinkError, match=re.escape(str(out / name))):
            write()
    assert document.read_text() == "years of work"
    assert {path.name for path in tmp_path.iterdir()} == {"out", "thesis.tex"}
    assert not [path for path in out.iterdir() if path.suffix == ".tmp"]


def test_what_killed_runs_left_of_a_checkpoint_goes(tmp_path):
    (tmp_path / ".last.pt.0123456789abcdef.tmp").write_text("half")
    (tmp_path / "last.pt.tmp").symlink_to(tmp_path / "elsewhere")
    writers(tmp_path)["last.pt"]()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["last.pt", "last.pt.tmp"]


@pytest.fixture(scope="module")
def source(tmp_path_factory):
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
