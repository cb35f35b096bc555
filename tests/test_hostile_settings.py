"""Parameters, cameras, rigs, lidars, given scenes: YAML of plain values; mutated ones are read, or refused in lines."""

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
from synth3dlanes.system.yaml_text import MAX_BYTES, read_yaml, text_of, value_of
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


PLAIN = "expected plain values (null, true, false, numbers, text, lists and mappings), got the tag "


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("null", None),
        ("~", None),
        ("", None),
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("off", "off"),
        ("12", 12),
        ("-7", -7),
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        ("1_000", "1_000"),
        ("1:59:59", "1:59:59"),
        ("1e-3", 0.001),
        ("1.", 1.0),
        ("-.5E+02", -50.0),
        (".inf", float("inf")),
        ("-.Inf", float("-inf")),
        ("2001-01-01", "2001-01-01"),
        ("=", "="),
        ("!!str 3", "3"),
        ("!!int '3'", 3),
        ("!!float 3", 3.0),
        ("'3'", "3"),
        ("{<<: {a: 1}}", {"<<": {"a": 1}}),
        ("{a: &x [1, 2], b: *x}", {"a": [1, 2], "b": [1, 2]}),
    ],
)
def test_the_core_schema(text: str, value: object) -> None:
    assert repr(read_yaml(text, "f")) == repr((value, []))
    if not set(text) & set("!{'"):
        assert repr(value_of(text)) == repr(value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("!!int ''", "expected a whole number, got ''"),
        ("!!bool foo", "expected true or false, got 'foo'"),
        ("!!float x", "expected a number, got 'x'"),
        ("!!null x", "expected null, got 'x'"),
        ("!!timestamp foo", PLAIN + "'!!timestamp'"),
        ("!!opencv-matrix {rows: 1}", PLAIN + "'!!opencv-matrix'"),
        ("!!python/object/apply:os.system [x]", PLAIN + "'!!python/object/apply:os.system'"),
        ("!foo x", PLAIN + "'!foo'"),
        ("[" * 5000, "expected at most 20 lists and mappings in each other, got more"),
        ("9" * 5000, "expected a number of at most 40 digits, got 5000"),
        ("&a [*a]", "expected no alias within what it stands for, got *a"),
        ("[" + "0," * 30_000 + "0]", "expected at most 20000 values, got more"),
        ("{a: 1, a: 2}", "key 'a' is given twice"),
        ("{[1]: 2}", "not YAML: found unhashable key"),
    ],
)
def test_all_else_is_refused_in_a_line(text: str, problem: str) -> None:
    _, problems = read_yaml(f"\n{text}", "f")
    assert problems == [f"f: line 2: {problem}"]


def test_what_aliases_repeat_counts() -> None:
    """Nine anchors, each of which stands for ten of the one before."""
    lines = ["- &a0 [x]", *(f"- &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10))]
    assert read_yaml("\n".join(lines), "f") == (None, ["f: line 5: expected at most 20000 values, got more"])


def test_calibrations_have_matrices() -> None:
    text = "%YAML:1.0\n---\nm: !!opencv-matrix\n  rows: 1\n  data: [ 1., 2.5e+02 ]"
    assert read_yaml(text, "f", is_calibration=True) == ({"m": {"rows": 1, "data": [1.0, 250.0]}}, [])
    assert read_yaml("!!opencv-matrix [1]", "f", is_calibration=True)[1] == [
        "f: line 1: not YAML: expected a mapping node, but found sequence"
    ]


def test_long_texts_are_refused_unread(tmp_path: Path) -> None:
    assert read_yaml("#" * (MAX_BYTES + 1), "f")[1] == ["f: expected at most 1,048,576 characters, got 1,048,577"]
    (tmp_path / "x.yaml").write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(InputError, match=r"^f: expected at most 1,048,576 bytes, got 1,048,577$"):
        text_of(tmp_path / "x.yaml", "f")
