"""Safe YAML that reports every problem: repeated keys are errors, and 1e-3 is a number, as in YAML 1.2.

No side effects.
"""

import re
from collections.abc import Hashable
from typing import Any

import yaml


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with two fixes: it silently keeps the last of two equal keys and reads 1e-3 as text."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.repeated: list[str] = []

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                self.repeated.append(f"line {key_node.start_mark.line + 1}: key {key!r} is given twice")
            seen.add(key if isinstance(key, Hashable) else repr(key))
        return super().construct_mapping(node, deep)

    def opencv_matrix(self, node: Any) -> dict[Hashable, Any]:
        return self.construct_mapping(node, deep=True)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
# OpenCV's files: an object with rows, cols, dt and data.
_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _Loader.opencv_matrix)


def read_yaml(text: str, where: str) -> tuple[Any, list[str]]:
    """The document and its problems, one line each, beginning with `where`. The document is None if it is not YAML."""
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        return None, [f"{where}: not YAML: character {error.character:#04x} at {error.position} is not text"]
    try:
        document = loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        place = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        return None, [f"{where}: {place}not YAML: {error.problem}"]
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        return None, [f"{where}: not YAML: {' '.join(str(error).split())}"]
    finally:
        loader.dispose()
    return document, [f"{where}: {problem}" for problem in loader.repeated]
