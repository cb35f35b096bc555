"""Parameters, cameras, rigs, lidars and given scenes, mutated: each is read, or refused in lines that name it."""

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params, presets_folder
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.production.benchmarks import load_benchmark
from synth3dlanes.production.given_scenes import given_scenes
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.system.errors import InputError, Synth3dlanesError
from tests.hostile import HOSTILE, LEAKED, damaged, edited_json, files, refused_or_read

READERS = {
    "streets.yaml": load_params,
    "cameras/kitti_raw.yaml": load_camera,
    "rigs/nuscenes.yaml": load_rig,
    "lidars/hdl_32e.yaml": load_lidar,
    "benchmarks/weather.yaml": load_benchmark,
}
VALUE = re.compile(rb"(?<=[:\[, ])[\w.+-]+(?=[,\]\n }])")
# Anchors, tags, documents and characters of YAML.
YAML = [
    b"&a [*a]",
    b"!!python/object:os.system x",
    b"<<: ",
    b"\t",
    b"---\n",
    b"*a",
    b".inf",
    b"1:59:59",
    b"\0",
    b"\x07",
]


@st.composite
def edited_yaml(draw, data):
    """A value replaced, or a piece of syntax put somewhere."""
    if draw(st.booleans()):
        at = draw(st.integers(0, len(data)))
        return data[:at] + draw(st.sampled_from(YAML)) + data[at:]
    value = draw(st.sampled_from(list(VALUE.finditer(data))))
    other = draw(st.sampled_from([text for text in HOSTILE if len(text) < 1000]))
    return data[: value.start()] + other.encode() + data[value.end() :]


@pytest.mark.parametrize("name", READERS)
@given(data=st.data())
def test_settings(tmp_path_factory, name, data):
    whole = (presets_folder() / name).read_bytes()
    path = tmp_path_factory.getbasetemp() / "x.yaml"
    path.write_bytes(data.draw(st.one_of(edited_yaml(whole), damaged(whole))))
    problems = ""
    try:
        READERS[name](str(path))
    except InputError as error:
        problems = str(error)
    assert all("x.yaml" in line for line in problems.splitlines()), problems
    assert not LEAKED.search(problems), problems


@pytest.mark.parametrize("name", READERS)
def test_control_characters_are_no_text(tmp_path, name):
    """YAML 1.2, 5.1: of the characters below a space, only tab and line breaks may be in a document."""
    (tmp_path / "x.yaml").write_bytes((presets_folder() / name).read_bytes() + b"# \x07")
    with pytest.raises(InputError, match=r"x\.yaml.*: not YAML: character 0x07 at \d+ is not text$"):
        READERS[name](str(tmp_path / "x.yaml"))


SCORES = json.dumps({"source": "nowhere/test", "samples": [{"key": "00000001"}, {"key": "00000002"}]})


@st.composite
def scores(draw):
    """A result of `evaluate --json` with a value edited, damaged bytes, or another document."""
    other = draw(st.sampled_from(HOSTILE)).encode()
    return draw(st.sampled_from([draw(edited_json(SCORES)), draw(damaged(SCORES.encode())), other]))


@given(scores())
@files
def test_given_scenes(tmp_path_factory, data):
    path: Path = tmp_path_factory.getbasetemp() / "scores.json"
    path.write_bytes(data)
    params = load_params("appendix_i")
    refused_or_read(lambda: given_scenes(path, params, Assets()), f"like {path}", error=Synth3dlanesError)
