"""YAML of plain values, within bounds; every problem is a line that names the file and the line in it.

Plain values are YAML's core schema: null, true and false, numbers, text, lists and mappings. Repeated keys are errors.
Reading a file is the only side effect.
"""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any, NoReturn

import yaml

from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import read_bounded

# Limits of a file, far above ours: a preset takes 8 kB and has 400 values, 2 levels deep.
MAX_BYTES, MAX_VALUES, MAX_DEPTH = 1 << 20, 20_000, 20
# The most digits of an integer; seeds have up to 39.
MAX_DIGITS = 40
PLAIN = "null, true, false, numbers, text, lists and mappings"

NAMES = {"bool": "true or false", "int": "a whole number", "float": "a number"}
NULL = re.compile("null|Null|NULL|~|")
BOOL = re.compile("true|True|TRUE|false|False|FALSE")
INT = re.compile("[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
TAG = "tag:yaml.org,2002:"


class _RefusedError(yaml.MarkedYAMLError):
    """YAML that has a place here for none of its values."""


class _Loader(yaml.SafeLoader):
    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.repeated: list[str] = []
        self._depth = self._n_values = 0
        # The sizes of the parts with anchors, which aliases repeat.
        self._sizes: dict[int, int] = {}

    def resolve(self, kind: type[yaml.Node], value: Any, implicit: Any) -> str:
        if kind is not yaml.ScalarNode or not implicit[0]:
            return str(super().resolve(kind, value, implicit))  # type: ignore[no-untyped-call]
        return TAG + kind_of(value)

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        before = self._n_values
        self._n_values += 1
        self._depth += 1
        if self._depth > MAX_DEPTH:
            _refuse(f"expected at most {MAX_DEPTH} lists and mappings in each other, got more", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if id(node) not in self._sizes:
                _refuse(f"expected no alias within what it stands for, got *{event.anchor}", event)
            self._n_values += self._sizes[id(node)]
        else:
            self._sizes[id(node)] = self._n_values - before
        if self._n_values > MAX_VALUES:
            _refuse(f"expected at most {MAX_VALUES} values, got more", event)
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                self.repeated.append(f"line {key_node.start_mark.line + 1}: key {key!r} is given twice")
            seen.add(key if isinstance(key, Hashable) else repr(key))
        return super().construct_mapping(node, deep)

    def plain(self, node: Any) -> Any:
        """A scalar by its tag."""
        text, kind = self.construct_scalar(node), node.tag.removeprefix(TAG)
        if kind != "str" and kind_of(text) not in ({"int", "float"} if kind == "float" else {kind}):
            _refuse(f"expected {NAMES.get(kind, kind)}, got {text[:40]!r}", node)
        if kind == "int" and len(text) > MAX_DIGITS:
            _refuse(f"expected a number of at most {MAX_DIGITS} digits, got {len(text)}", node)
        return _value(kind, text)

    def unknown(self, node: yaml.Node) -> NoReturn:
        tag = node.tag.replace(TAG, "!!")
        _refuse(f"expected plain values ({PLAIN}), got the tag {tag[:40]!r}", node)

    def opencv_matrix(self, node: yaml.Node) -> dict[Hashable, Any]:
        return self.construct_mapping(node, deep=True)


_Loader.yaml_constructors = {
    **dict.fromkeys((f"{TAG}{kind}" for kind in ("null", "bool", "int", "float", "str")), _Loader.plain),
    f"{TAG}seq": yaml.SafeLoader.construct_yaml_seq,
    f"{TAG}map": yaml.SafeLoader.construct_yaml_map,
    None: _Loader.unknown,
}


class _CalibrationLoader(_Loader):
    """A loader that also reads the matrices of OpenCV's files: objects with rows, cols, dt and data."""


_CalibrationLoader.yaml_constructors = {
    **_Loader.yaml_constructors,
    f"{TAG}opencv-matrix": _CalibrationLoader.opencv_matrix,
}


def kind_of(text: str) -> str:
    """What a text without quotes is: null, bool, int, float or str."""
    kinds = {"null": NULL, "bool": BOOL, "int": INT, "float": FLOAT}
    return next((kind for kind, pattern in kinds.items() if pattern.fullmatch(text)), "str")


def value_of(text: str) -> Any:
    """What a text without quotes says; the text itself where it is no number, null, true or false."""
    kind = kind_of(text)
    return text if kind == "int" and len(text) > MAX_DIGITS else _value(kind, text)


def text_of(path: Path, where: str) -> str:
    """The text in a file for `read_yaml`; raise InputError, its message beginning with `where`."""
    try:
        return read_bounded(path, MAX_BYTES).decode()
    except FormatError as error:
        raise InputError(f"{where}: {str(error).removeprefix(f'{path}: ')}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{where}: cannot read: {getattr(error, 'strerror', None) or error}") from None


def read_yaml(text: str, where: str, *, is_calibration: bool = False) -> tuple[Any, list[str]]:
    """The document and its problems, one line each, beginning with `where`. The document is None if it cannot be read;
    a calibration may have OpenCV's matrices."""
    if len(text) > MAX_BYTES:
        return None, [f"{where}: expected at most {MAX_BYTES:,} characters, got {len(text):,}"]
    if is_calibration:
        # The first line that OpenCV writes is no valid YAML directive.
        text = re.sub(r"\A\s*%YAML:[\d.]+", "", text)
    try:
        loader = (_CalibrationLoader if is_calibration else _Loader)(text)
    except yaml.reader.ReaderError as error:
        return None, [f"{where}: not YAML: character {error.character:#04x} at {error.position} is not text"]
    try:
        document = loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        place = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        what = "" if isinstance(error, _RefusedError) else "not YAML: "
        return None, [f"{where}: {place}{what}{' '.join(str(error.problem).split())[:200]}"]
    except (yaml.YAMLError, ValueError) as error:
        return None, [f"{where}: not YAML: {' '.join(str(error).split())[:200]}"]
    finally:
        loader.dispose()
    return document, [f"{where}: {problem}" for problem in loader.repeated]


class _Dumper(yaml.SafeDumper):
    """Quotes text that would be read as another kind of value."""

    def text(self, value: str) -> yaml.ScalarNode:
        return self.represent_scalar(f"{TAG}str", value, style=None if kind_of(value) == "str" else "'")


_Dumper.add_representer(str, _Dumper.text)


def to_yaml(document: Any) -> str:
    """A document of plain values as text that `read_yaml` reads back."""
    text: str = yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10_000)
    return text


def _value(kind: str, text: str) -> Any:
    if kind == "null":
        return None
    if kind == "bool":
        return text.lower() == "true"
    if kind == "int":
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    return float(re.sub(r"\.(?=inf|nan)", "", text.lower())) if kind == "float" else text


def _refuse(problem: str, at: Any) -> NoReturn:
    raise _RefusedError(problem=problem, problem_mark=at.start_mark)
