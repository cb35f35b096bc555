"""One word has one meaning: names of classes and types, and the table of docs/words.md."""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]


def _types(path):
    """The public classes and type aliases of a module, with what they stand for; type variables are local."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"class in {path.relative_to(ROOT)}"
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name, value = node.targets[0].id, ast.unparse(node.value)
            if re.fullmatch(r"[A-Z]\w*[a-z]\w*", name) and not value.startswith("TypeVar("):
                yield name, value


def test_no_two_classes_or_types_share_a_name():
    meanings = defaultdict(set)
    for package in ("synth3dlanes", "cli", "baseline_model"):
        for path in (ROOT / package).rglob("*.py"):
            for name, meaning in _types(path):
                meanings[name].add(meaning)
    assert {name: found for name, found in meanings.items() if len(found) > 1} == {}
