"""The architecture: modules that load nothing heavy, in fresh interpreters; and functions of few arguments."""

import ast
import subprocess
import sys
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


MOST_ARGUMENTS = 6


def test_no_function_of_the_library_takes_more_than_six_arguments():
    root, found = Path(__file__).parents[1], set()
    for package in ("synth3dlanes", "baseline_model"):
        for path in (root / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                    named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                    if sum(one.arg not in ("self", "cls") for one in named) > MOST_ARGUMENTS:
                        name = getattr(node, "name", "lambda")
                        found.add(f"{path.relative_to(root / package).as_posix()}: {name}")
    assert found == set()
