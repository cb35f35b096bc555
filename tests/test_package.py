"""What is released works away from the checkout: sdist -> wheel -> an empty environment, in an empty folder."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import numpy
import pytest

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[1]
NOT_COPIED = (".git", ".venv", ".*_cache", ".hypothesis", "demo", "build", "dist", "*.egg-info")
BUILD = "import sys; from setuptools import build_meta; print(getattr(build_meta, f'build_{sys.argv[1]}')(sys.argv[2]))"
LOADED = """
import sys
print(synth3dlanes.__file__)
print(*sorted({"bpy", "torch"} & set(sys.modules)))
"""


# The folders of the checkout by the names under which they are installed.
PACKAGES = {
    "synth3dlanes": "synth3dlanes",
    "synth3dlanes_cli": "cli",
    "synth3dlanes_baseline": "baseline_model",
    "synth3dlanes/_params": "params",
    "synth3dlanes/_assets": "blender_assets",
}


def output(words: list[str | Path], folder: Path) -> str:
    """What a program prints in a folder, where nothing leads to the checkout."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def built(kind: str, source: Path, out: Path) -> Path:
    return out / output([sys.executable, "-c", BUILD, kind, out], source).splitlines()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of the checkout, caches included."""
    source, out = tmp_path_factory.mktemp("checkout") / "it", tmp_path_factory.mktemp("sdist")
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*NOT_COPIED))
    (source / "synth3dlanes" / "__pycache__").mkdir(exist_ok=True)
    (source / "synth3dlanes" / "__pycache__" / "stale.cpython-311.pyc").write_bytes(b"")
    return built("sdist", source, out)


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the sdist alone."""
    folder, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return built("wheel", folder / sdist.name.removesuffix(".tar.gz"), out)


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of an environment with the wheel and the packages that it depends on, taken from this environment."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check"]
    output([*pip, "install", "--quiet", "--no-index", "--no-deps", "--no-compile", wheel], folder)
    (site_packages,) = folder.glob("lib/*/site-packages")
    (site_packages / "dependencies.pth").write_text(f"{Path(numpy.__file__).parents[1]}\n")
    return python


def test_the_sdist_has_the_sources_and_no_caches(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "constraints.txt", "cli/main.py", "params/tiny.yaml"} <= names
    assert not [name for name in names if re.search(r"__pycache__|\.pyc$|^\.|^tests/.", name)]


def test_the_wheel_has_packages_of_our_names_alone(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {name.split("/")[0] for name in PACKAGES}
    assert {"synth3dlanes/py.typed", "synth3dlanes/_assets/assets.blend", "synth3dlanes/_assets/LICENSE"} <= set(names)
    assert "\nLicense-Expression: MIT\n" in metadata
    assert any(name.endswith("/licenses/LICENSE") for name in names)
    assert not [name for name in names if "__pycache__" in name]
    for installed, folder in PACKAGES.items():
        files = [path for path in (ROOT / folder).rglob("*.*") if "__pycache__" not in path.parts]
        needed = [path for path in files if folder == "synth3dlanes" or path.suffix in (".py", ".yaml")]
        assert {f"{installed}/{path.relative_to(ROOT / folder)}" for path in needed} - {*names} == set()


def test_commands_run(python: Path, tmp_path: Path) -> None:
    from synth3dlanes.params.params import load_params
    from synth3dlanes.params.params_text import params_yaml

    shown = params_yaml(load_params("appendix_i"))
    assert output([python, "-m", "synth3dlanes", "params", "show"], tmp_path) == shown
    assert output([python.with_name("synth3dlanes"), "params", "show"], tmp_path) == shown


@pytest.mark.render
def test_the_ten_lines_run(python: Path, tmp_path: Path) -> None:
    """Those of docs/api.md; Blender is in the process that renders and in no other."""
    page = (ROOT / "docs" / "api.md").read_text()
    lines, printed = re.search(r"```python\n(.*?)```\n\n```text\n(.*?)```", page, re.DOTALL).groups()  # type: ignore[union-attr]
    assert len([line for line in lines.splitlines() if line]) <= 10
    told = output([python, "-c", lines + "import synth3dlanes" + LOADED], tmp_path)
    package = python.parents[1].resolve()
    assert told == f"{printed}{next(package.glob('lib/*/site-packages'))}/synth3dlanes/__init__.py\n\n"
    assert (tmp_path / "scene.png").stat().st_size > 50_000
