"""YAML of plain values: YAML 1.2's core schema, and lines that name the place for all else."""

from pathlib import Path

import pytest

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.yaml_text import MAX_BYTES, read_yaml, text_of, value_of

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
