"""Rendered images, exported: read by each format's own convention alone, the lines lie on the paint of the image.

The conventions are written down anew here from the formats note, in other words than in `synth3dlanes.formats`.
"""

import json

import numpy as np
import pytest
from PIL import Image

N = 1
# Of the exported image's width: beside the paint, which is at most half as wide as this near the camera.
ASIDE = 0.035


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A rendered scene without cars; its dashes are long."""
    from synth3dlanes.dataset.folder import claim
    from synth3dlanes.dataset.write import Shard
    from synth3dlanes.draw.sample import Scenes
    from synth3dlanes.params.params import load_params
    from synth3dlanes.production.recipe import Recipe, make_sample
    from synth3dlanes.scene.settings import RenderSettings

    changes = ["cars.n=0", "trees.n=0", "markings.dash_fraction=0.7", "markings.grayscale=0.9", "road.topology=1"]
    recipe = Recipe(
        Scenes(load_params("appendix_i", changes), 5, "train"), RenderSettings(samples=2, device="cpu"), "jpg"
    )
    root = tmp_path_factory.mktemp("rendered") / "d"
    with claim(root, {**recipe.description(), "shard_size": N}, "train", N, [0]) as folder:
        shard = Shard(folder, 0, N, recipe.names)
        for index in range(N):
            shard.write_part(index, make_sample(recipe, index).members)
        shard.join(N)
    return root


def apollo(out):
    """Ground frame x right, y forward, z up; the camera at (0, h sin p, h cos p), pitched down by p."""
    for text in (out / "data_splits/standard/train.json").read_text().splitlines():
        label = json.loads(text)
        c, s, h = np.cos(label["cam_pitch"]), np.sin(label["cam_pitch"]), label["cam_height"]
        lines = []
        for points, visible in zip(label["laneLines"], label["laneLines_visibility"], strict=True):
            x, y, z = (np.array(points)[np.array(visible) > 0] - [0, h * s, h * c]).T
            lines.append(2015 * np.stack([x, -s * y - c * z]) / (c * y - s * z) + [[960], [540]])
        yield out / "Apollo_Sim_3D_Lane_Release" / label["raw_file"], lines


def openlane(out):
    """Camera frame x forward, y left, z up, and the intrinsics of the frame."""
    for path in sorted((out / "lane3d_1000/training").glob("*/*.json")):
        label = json.loads(path.read_text())
        (fx, _, cx), (_, fy, cy), _ = label["intrinsic"]
        lines = []
        for line in label["lane_lines"]:
            forward, left, up = np.array(line["xyz"])[:, np.array(line["visibility"]) > 0]
            lines.append(np.stack([cx - fx * left / forward, cy - fy * up / forward]))
            assert np.allclose(lines[-1], line["uv"], atol=0.02)
        yield out / "images" / label["file_path"], lines


def once(out):
    """Camera frame x right, y down, z forward, and a 3x4 matrix."""
    for path in sorted((out / "ONCE_3DLanes/train").glob("*/cam01/*.json")):
        label = json.loads(path.read_text())
        projected = [
            np.array(label["calibration"]) @ np.c_[points, np.ones(len(points))].T for points in label["lanes"]
        ]
        image = str(path).replace("ONCE_3DLanes/train", "ONCE_3DLanes/data").replace(".json", ".jpg")
        yield image, [line[:2] / line[2] for line in projected]


def tusimple(out):
    """Columns by row, -2 where there is none."""
    for text in (out / "label_data_0313.json").read_text().splitlines():
        label = json.loads(text)
        found = [np.stack([columns, label["h_samples"]]).astype(float) for columns in label["lanes"]]
        yield out / label["raw_file"], [line[:, line[0] >= 0] for line in found]


def culane(out):
    """Columns and rows in turn, one line of text per line."""
    for path in (out / "list/train.txt").read_text().splitlines():
        image = out / path.lstrip("/")
        lines = image.with_suffix(".lines.txt").read_text().splitlines()
        yield image, [np.array(line.split(), dtype=float).reshape(-1, 2).T for line in lines]


def curvelanes(out):
    """Points with x and y as text."""
    for path in sorted((out / "train/labels").glob("*.json")):
        lines = json.loads(path.read_text())["Lines"]
        image = out / "train/images" / path.name.replace(".lines.json", ".jpg")
        yield image, [np.array([[point["x"], point["y"]] for point in line], dtype=float).T for line in lines]


@pytest.mark.render
@pytest.mark.parametrize("read", [apollo, openlane, once, tusimple, culane, curvelanes])
def test_exported_lines_lie_on_paint(rendered, tmp_path, read):
    from synth3dlanes.formats.export import Export

    Export(str(rendered), tmp_path, read.__name__).write()
    frames = list(read(tmp_path))
    assert len(frames) == N
    for path, lines in frames:
        image = np.asarray(Image.open(path).convert("L")).astype(float)
        aside_px = round(ASIDE * image.shape[1])
        on, off = ([], [])
        for u_px, v_px in lines:
            # Rows of the lowest quarter, where paint is some pixels wide; sampled along the line as it would be drawn.
            rows = np.arange(int(0.75 * image.shape[0]), image.shape[0])
            order = np.argsort(v_px)
            columns = np.interp(rows, v_px[order], u_px[order], left=-1e6, right=-1e6)
            inside = (columns > 2 * aside_px) & (columns < image.shape[1] - 2 * aside_px)
            rows, columns = rows[inside], columns[inside].astype(int)
            here, left, right = (image[rows, columns + shift] for shift in (0, -aside_px, aside_px))
            on += list(here > np.maximum(left, right) + 15)
            left, here, right = (image[rows, columns + shift] for shift in (0, aside_px, 2 * aside_px))
            off += list(here > np.maximum(left, right) + 15)
        assert len(on) > 100, f"{path}: lines cross the foreground"
        assert np.mean(on) > 0.6, f"{path}: paint under the line"
        assert np.mean(off) < 0.1, f"{path}: none beside it"
