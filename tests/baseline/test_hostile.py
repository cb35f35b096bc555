"""Predictions, checkpoints, weights and calibrations of others, mutated: each is read, or refused by an error of ours
whose lines name it. Nothing in them is run."""

import io
import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.config import PAPER, train_config
from synth3dlanes_baseline.lanes import read_predictions, to_line
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.photographs import read_intrinsics
from synth3dlanes_baseline.pretrained import load_pretrained

from synth3dlanes.system.errors import FormatError, Synth3dlanesError
from tests.hostile import HOSTILE, edited_json, files, mutated, refused_or_read

PREDICTION = {
    "key": "00000000",
    "lanes": [
        {"kind": "delimiter", "score": 0.7, "xyz_cam": [[0, 5, -1.5], [0, 9, -1.4]], "visibility": [1, 0.2]},
        {"kind": "centerline", "score": 0.1, "xyz_cam": [[2, 5, -1.5], [2, 9, -1.4], [2, 20, -1]]},
    ],
    "pose": {"pitch_rad": 0.05, "height_m": 1.6},
}
CALIBRATION = "P0: 1 2\nP2: 7.0e+02 0 6.0e+02 4e+01 0 7.0e+02 1.8e+02 2e-01 0 0 1 2e-03\nTr: 1\n"


def read_or_refused(tmp_path_factory, data, read, name):
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(data)
    return refused_or_read(lambda: read(path), str(path), error=Synth3dlanesError)


@given(mutated(json.dumps(PREDICTION).encode(), is_json=True))
@files
def test_predictions(tmp_path_factory, data):
    found = read_or_refused(tmp_path_factory, data, lambda path: list(read_predictions(path)), "p.jsonl")
    for prediction in found or ():
        assert "NaN" not in to_line(prediction), "what is read is finite, and can be written"


@given(mutated(CALIBRATION.encode()))
@files
def test_calibrations(tmp_path_factory, data):
    found = read_or_refused(tmp_path_factory, data, read_intrinsics, "calib.txt")
    assert found is None or np.isfinite(found).all()


@pytest.fixture(scope="module")
def stored():
    """What a checkpoint of a network of a few weights holds."""
    config = train_config("tiny")
    network = checkpoint.network_of(config.model)
    about = {"train": {"n_images": 4, "focal_px": [138.6, 138.6, 1.0]}, "step": 3}
    head = {"format": checkpoint.FORMAT, "version": checkpoint.VERSION, "config": config.model_dump_json()}
    document = {**head, "about": about, "model": network.state_dict(), "resume": None}
    stream = io.BytesIO()
    torch.save(document, stream)
    return document, stream.getvalue()


def detect(path):
    return checkpoint.detector(path, torch.device("cpu"))


@given(st.data())
@files
def test_damaged_checkpoints(tmp_path_factory, stored, data):
    read_or_refused(tmp_path_factory, data.draw(mutated(stored[1])), checkpoint.load, "x.pt")


@given(st.data())
@files
def test_checkpoints_whose_settings_lie(tmp_path_factory, stored, data):
    config = data.draw(edited_json(stored[0]["config"])).decode("utf-8", "replace")
    path = tmp_path_factory.getbasetemp() / "lies.pt"
    torch.save({**stored[0], "config": config}, path)
    refused_or_read(lambda: detect(path), str(path), "checkpoint: expected weights", error=Synth3dlanesError)


@pytest.mark.parametrize("name", ["config", "about", "model", "resume", "version", "format"])
@pytest.mark.parametrize("value", [..., 2, "x", [], ["x"], {"train": 3}, {"train": {"focal_px": [1, -1, 1]}}, {"a": 1}])
def test_checkpoints_that_lie(tmp_path, stored, name, value):
    """A file as torch writes it; what is in it is not as it should be."""
    document = dict(stored[0])
    if value is ...:
        del document[name]
    else:
        document[name] = value
    path = tmp_path / "lies.pt"
    torch.save(document, path)
    found = refused_or_read(lambda: detect(path), str(path), error=Synth3dlanesError)
    # Whatever else is told of the training, and a state to resume from, are nothing to a detector.
    may_pass = {"about": [{"a": 1}], "resume": [{"train": 3}, {"train": {"focal_px": [1, -1, 1]}}, {"a": 1}]}
    assert (found is not None) == (value in may_pass.get(name, []))


def test_weights_of_another_network_are_named(tmp_path, stored):
    model = stored[0]["model"]
    first = next(iter(model))
    torch.save({**stored[0], "model": {**model, first: torch.zeros(2)}}, tmp_path / "x.pt")
    with pytest.raises(Synth3dlanesError, match=rf"^checkpoint: expected weights of .* first {first}: \(2,\) for"):
        detect(tmp_path / "x.pt")
    torch.save({**stored[0], "model": {**model, first: 3}}, tmp_path / "x.pt")
    with pytest.raises(FormatError, match=rf"x\.pt: model\.{first}: expected a Tensor, got 3"):
        detect(tmp_path / "x.pt")


@pytest.mark.parametrize("value", HOSTILE)
def test_sizes_of_networks_are_bounded(tmp_path, stored, value):
    """What is no size, or beyond any that is used, is refused before a network is built."""
    config = stored[0]["config"].replace('"rows":104', f'"rows":{value}')
    assert config != stored[0]["config"]
    torch.save({**stored[0], "config": config}, tmp_path / "x.pt")
    with pytest.raises(Synth3dlanesError):
        detect(tmp_path / "x.pt")


def test_files_that_are_no_state_dict(tmp_path):
    with torch.device("meta"):
        network = LaneNet(PAPER)
    path = tmp_path / "x.pth"
    for content in (b"", b"\x80\x04.", b"PK\x03\x04", b"[" * 1000):
        path.write_bytes(content)
        with pytest.raises(FormatError, match=r"x\.pth: expected a state dict, got other or damaged bytes"):
            load_pretrained(network, str(path))
    kernels = {f"features.{number}.weight": torch.zeros(8, 3, 3, 3) for number in range(13)}
    for document, problem in (
        ([1, 2], "expected a state dict, got list"),
        ({"features.0.weight": 3}, "expected a tensor at features.0.weight, got int"),
        ({}, "expected 13 kernels named features.N.weight .VGG16., got 0"),
        (kernels, "expected the weights of a vgg16 or vgg16_bn, got none named 'features.0.bias'"),
        (kernels | {f"features.{n}.bias": torch.zeros(7) for n in range(13)}, r"expected shape \(8,\), got \(7,\)"),
        ({f"features.x{name}": value for name, value in kernels.items()}, "expected kernels named features.N.weight"),
    ):
        torch.save(document, path)
        with pytest.raises(FormatError, match=rf"x\.pth: .*{problem}"):
            load_pretrained(network, str(path))
