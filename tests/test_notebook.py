"""The notebook of examples/ runs from an empty folder: its cell that installs is replaced by what the tests run in."""

import json
import os
import sys
import tomllib
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "examples/first_steps.ipynb"
SMALLEST = {
    "install": f'RENDERER = "{sys.executable} -m synth3dlanes"',
    "sizes": "N_TRAIN, N_VAL, EPOCHS = 4, 2, 1",
}


def replaced(cells: dict[str, str]) -> Any:
    """The notebook with the contents of its cells of some tags replaced."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    for cell in notebook.cells:
        for tag in cell.metadata.get("tags", []):
            cell.source = cells.get(tag, cell.source)
    return notebook


def execute(notebook: Any, folder: Path) -> None:
    """Run it in a folder; raise where a cell fails."""
    NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(folder)}}).execute()


@pytest.mark.thorough
@pytest.mark.render
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("default")
def test_it_runs_from_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    folder = tmp_path / "empty"
    folder.mkdir()
    notebook = replaced(SMALLEST)
    execute(notebook, folder)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = "".join(output.get("text", "") for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
    for words in (
        "centerline none",
        "4 of 4 samples",
        "2 of 2 samples",
        "all right",
        "2 images; errors in cm",
        "lane3d_1000",
    ):
        assert words in printed, words


def test_it_is_stored_without_outputs_and_asks_for_no_file_of_the_repository() -> None:
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    assert {tag for cell in cells for tag in cell["metadata"].get("tags", [])} == set(SMALLEST)
    nbformat.validate(nbformat.read(NOTEBOOK, as_version=4))


def test_the_badge_and_the_first_cell_lead_to_the_repository() -> None:
    address = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Repository"]
    place = address.removeprefix("https://github.com/")
    colab = f"https://colab.research.google.com/github/{place}/blob/main/examples/first_steps.ipynb"
    assert f"[![Open in Colab](docs/pictures/colab.svg)]({colab})" in (ROOT / "README.md").read_text()
    (install,) = ("".join(c.source) for c in replaced({}).cells if "install" in c.metadata.get("tags", []))
    assert f"synth3dlanes @ git+{address}" in install
