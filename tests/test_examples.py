"""The programs and the notebook of examples/ run at small sizes and do what they say."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image

import synth3dlanes as s3d

pytestmark = [pytest.mark.thorough, pytest.mark.render]

FOLDER = Path(__file__).parents[1] / "examples"


def loaded(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(name: str, *words: object) -> str:
    """What a program of examples/ prints, in the current folder."""
    command = [sys.executable, str(FOLDER / f"{name}.py"), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tiny") / "data"
    assert s3d.generate_dataset(s3d.load_params("tiny"), out, n=3, workers=1).done == 3
    return out


def test_the_loader_mirrors_images_and_lanes_alike(tiny: Path) -> None:
    """A mirrored point has the mirrored pixel, and batches depend on the seed alone."""
    lanes = loaded("torch_loader").Lanes(str(tiny))
    mirrored = 0
    for lanes.epoch in range(4):
        for i in range(len(lanes)):
            image, k, lines = lanes[i]
            sample = lanes.reader[i]
            expected = [lane for lane in sample.labels.lanes if lane.kind == "centerline"]
            is_mirrored = not np.allclose(lines[0], expected[0].xyz_cam[expected[0].visible], atol=1e-4)
            mirrored += is_mirrored
            for line, lane in zip(lines, expected, strict=True):
                projected = line.numpy() @ k.numpy().T
                u, v = (projected[:, :2] / projected[:, 2:]).T
                before = sample.labels.camera.project(lane.xyz_cam[lane.visible])
                assert np.allclose(u, image.shape[2] - before[:, 0] if is_mirrored else before[:, 0], atol=1e-3)
                assert np.allclose(v, before[:, 1], atol=1e-3)
            plain = np.moveaxis(image.numpy(), 0, -1)[:, :: -1 if is_mirrored else 1]
            assert np.corrcoef(plain.ravel(), sample.image.ravel())[0, 1] > 0.99
    assert 2 <= mirrored <= 10
    assert run("torch_loader", tiny, "--batch", 2).splitlines()[0].startswith("(2, 3, 72, 96) (2, 3, 3) [")


def test_twins_score_each_value(in_tmp_path: Path) -> None:
    words = ("--n", 2, "--params", "tiny", "--vary", "light.exposure=1,3")
    found = re.findall(r"^light.exposure = (\d): AP [\d.]+$", run("twins_of_one_factor", "out", *words), re.MULTILINE)
    assert found == ["1", "3"]


def test_the_fisheye_sees_wider_than_a_pinhole_could(in_tmp_path: Path) -> None:
    assert run("own_fisheye", "out", "--params", "tiny", "--width", 160) == "out/fisheye.png fisheye\n"
    camera = s3d.load_camera("out/fisheye.yaml")
    labels = s3d.label(s3d.sample_scene(s3d.load_params("tiny"), index=17, camera=camera))
    assert labels.camera.rays(np.array([[1.0, 60.0]]))[0, 1] < np.cos(np.radians(70))
    picture = np.asarray(Image.open("out/fisheye.png"))
    assert picture.shape == (120, 160, 3)
    assert (picture == (0, 191, 255)).all(axis=-1).sum() > 20, "centre lines are deepskyblue"


def test_hard_cases_are_near_the_worst(in_tmp_path: Path) -> None:
    printed = run("hard_cases", "out", "--n", 2, "--params", "tiny").splitlines()
    assert len(printed) == 3
    given = json.loads(Path("out/hard/dataset.json").read_text())["like"]["scenes"]
    assert [f"{index:08d}" for _, _, index in given] == [line.split()[0] for line in printed[:2]]
    assert len(s3d.open_dataset("out/hard")) == 2


def test_a_clip_becomes_a_video_of_its_frames(in_tmp_path: Path) -> None:
    run("clip_to_video", "out", "--frames", 3, "--params", "tiny")
    with Image.open("out/clip.gif") as video:
        assert video.n_frames == 3
        assert video.info["duration"] == 100


def test_the_host_is_on_a_road_of_the_map(in_tmp_path: Path) -> None:
    """Its place, in the map that was written, is in a lane of its own height and heading."""
    printed = run("map_to_simulator", "out", "--n", 1, "--params", "tiny")
    sample = s3d.open_dataset("out/data")[0]
    place = loaded("map_to_simulator").place_of_host(sample.labels)
    scene = s3d.read_scene(s3d.open_dataset("out/data"), 0)
    assert place["y"] == pytest.approx(scene.camera.y_m, abs=0.5)
    forward = sample.labels.camera.world_from_cam[:2, 1]
    assert np.array([np.cos(place["h"]), np.sin(place["h"])]) == pytest.approx(forward / np.linalg.norm(forward))
    assert re.search(r"road '\w+': [\d.]+ m, [1-9] driving lanes", printed)


NOTEBOOK = FOLDER / "first_steps.ipynb"
SMALLEST = {"install": f'RENDERER = "{sys.executable} -m synth3dlanes"', "sizes": "N_TRAIN, N_VAL, EPOCHS = 4, 2, 1"}


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("default")
def test_it_runs_from_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    folder = tmp_path / "empty"
    folder.mkdir()
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    for cell in notebook.cells:
        for tag in cell.metadata.get("tags", []):
            cell.source = SMALLEST.get(tag, cell.source)
    NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = "".join(output.get("text", "") for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
    said = ("centerline none", "4 of 4 samples", "2 of 2 samples", "all right", "2 images; errors in cm", "lane3d_1000")
    assert [words for words in said if words not in printed] == []


def test_it_is_stored_without_outputs_and_asks_for_no_file_of_the_repository() -> None:
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    assert {tag for cell in cells for tag in cell["metadata"].get("tags", [])} == set(SMALLEST)
    nbformat.validate(nbformat.read(NOTEBOOK, as_version=4))
