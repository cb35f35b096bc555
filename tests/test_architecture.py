"""What modules load, write and are called, by their sources."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

HEAVY = ("bpy", "matplotlib", "pyarrow", "ray", "scipy.interpolate", "scipy.ndimage", "scipy.spatial", "torch")
PROBE = "import sys, {}; print(*sorted({} & set(sys.modules)))"


# Those that load none of the heavy packages, and those that load pyarrow alone.
LIGHT = ("", "_cli.main", ".roads.network", ".draw.sample", ".truth.ground_truth", ".formats.apollo")
WITH_TABLES = (".api", ".dataset.read", ".formats.export", ".dataset.scenes", ".production.run")


@pytest.mark.parametrize(("modules", "allowed"), [(LIGHT, set()), (WITH_TABLES, {"pyarrow"})], ids=["light", "tables"])
def test_importing_does_not_load(modules: tuple[str, ...], allowed: set[str]) -> None:
    """What all of them load together."""
    command = [sys.executable, "-c", PROBE.format(", ".join(f"synth3dlanes{name}" for name in modules), {*HEAVY})]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout.split()
    assert set(loaded) <= allowed


ROOT = Path(__file__).parents[1]


def programs() -> list[str]:
    folders = ("synth3dlanes", "cli", "baseline_model")
    return sorted(str(path.relative_to(ROOT)) for folder in folders for path in (ROOT / folder).rglob("*.py"))


@cache
def parsed(program: str) -> ast.Module:
    return ast.parse((ROOT / program).read_text(encoding="utf-8"))


def _types(program):
    """The public classes and type aliases of a module, with what they stand for; type variables are local."""
    for node in parsed(program).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"class in {program}"
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name, value = node.targets[0].id, ast.unparse(node.value)
            if re.fullmatch(r"[A-Z]\w*[a-z]\w*", name) and not value.startswith("TypeVar("):
                yield name, value


def test_no_two_classes_or_types_share_a_name():
    meanings = defaultdict(set)
    for path in programs():
        for name, meaning in _types(path):
            meanings[name].add(meaning)
    assert {name: found for name, found in meanings.items() if len(found) > 1} == {}


# Calls that write, replace or remove by a path. Figures and pictures are written into streams that files.py opened.
WRITERS = {"write_text", "write_bytes", "unlink", "mkdir", "rmdir", "rmtree", "symlink_to", "hardlink_to", "touch"}
WRITERS |= {"rename", "makedirs", "copyfile", "copytree", "copy2", "move", "mkdtemp", "mkstemp", "truncate"}
WRITERS |= {"TemporaryDirectory", "NamedTemporaryFile"}
WRITERS_OF_OS = {"replace", "remove", "link", "symlink", "removedirs", "renames"}
MODES_OF_WRITING = set("wax+")
# What libraries call that encodes into a stream or a file: of Pillow, matplotlib, torch and numpy; of pyarrow; of json
# and pickle, OpenEXR, ElementTree and others.
OF_LIBRARIES = {"save", "savez", "savez_compressed", "savetxt", "savefig", "imsave", "imwrite", "tofile"}
OF_LIBRARIES |= {"write_table", "write_feather", "write_parquet", "write_csv", "to_parquet", "to_csv"}
OF_LIBRARIES |= {"json.dump", "pickle.dump", "writePixels", "writestr", "save_file", "save_model", "write_image"}
# Our own functions of these names, and Blender, which writes into a folder of its own process.
OWN = {
    "baseline_model/train.py": {"checkpoints.save", "save"},
    "baseline_model/run_state.py": {"checkpoints.save"},
    "synth3dlanes/production/tally.py": {"self._log.save"},
    "synth3dlanes/blender/example_assets.py": {"save", "image.save"},
}
# These write in folders of this process alone, which `scratch` made, or in one that is made anew by the command.
ALLOWED = {
    "synth3dlanes/system/files.py": "the one that may",
    "synth3dlanes/system/scratch.py": "makes the folder of this process",
    "synth3dlanes/blender/__init__.py": "Blender's own temporary folder",
    "synth3dlanes/blender/example_assets.py": "a folder that was not there before",
    "synth3dlanes/production/workers.py": "what workers print, in the folder of this process, and locks in that of all",
    "synth3dlanes/imaging/video.py": "PyAV writes into a stream of the caller, whose writes are checked",
    "cli/main.py": "/dev/null",
    "synth3dlanes/production/signals.py": "/dev/null",
    "synth3dlanes/validate/contents.py": "/dev/null",
    "synth3dlanes/dataset/stores.py": "files of stores, and copies in the folder of this process",
}


def writing_calls(program: str) -> list[str]:
    """The calls in a program that write by a path, as "LINE: CALL"."""
    found = []
    for node in ast.walk(parsed(program)):
        if isinstance(node, ast.Call):
            attribute = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = attribute or (node.func.id if isinstance(node.func, ast.Name) else "")
            is_of_os = isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) == "os"
            texts = [*node.args, *(keyword.value for keyword in node.keywords if keyword.arg == "mode")]
            modes = {text.value for text in texts if isinstance(text, ast.Constant) and isinstance(text.value, str)}
            is_write_mode = any(len(mode) <= 3 and set(mode) & MODES_OF_WRITING for mode in modes)
            opens = name == "open" and (is_of_os or is_write_mode)
            if name in WRITERS or opens or (is_of_os and name in WRITERS_OF_OS):
                found.append(f"{node.lineno}: {ast.unparse(node)[:80]}")
    return found


def library_calls(program: str) -> list[str]:
    """The calls of libraries that may write to a file, as "LINE: CALL": all but those into a `BytesIO` of the same
    function, and those in an argument of `encoded`."""
    source = (ROOT / program).read_text(encoding="utf-8")
    if not any(f"{word}(" in source for word in OF_LIBRARIES):
        return []
    tree, found = parsed(program), []
    safe = {id(node) for call in _calls(tree) if _name(call) == "encoded" for node in ast.walk(call)}
    for scope in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        streams = {
            target.id
            for node in ast.walk(scope)
            if isinstance(node, ast.Assign) and ast.unparse(node.value) in ("io.BytesIO()", "BytesIO()")
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        safe |= {id(call) for call in _calls(scope) if any(ast.unparse(word) in streams for word in call.args)}
    for call in _calls(tree):
        if {_name(call), ast.unparse(call.func)} & OF_LIBRARIES and id(call) not in safe:
            found.append(f"{call.lineno}: {ast.unparse(call.func)}")
    return found


def _calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def test_nothing_else_writes_by_a_path() -> None:
    found = {name: writing_calls(name) for name in programs()}
    assert {name: calls for name, calls in found.items() if calls and name not in ALLOWED} == {}
    assert [name for name in ALLOWED if not found[name]] == []


def test_libraries_write_into_memory() -> None:
    found = {
        name: [call for call in library_calls(name) if call.partition(": ")[2] not in OWN.get(name, ())]
        for name in programs()
    }
    assert {name: calls for name, calls in found.items() if calls} == {}
