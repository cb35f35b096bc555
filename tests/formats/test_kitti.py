"""KITTI: its files against the labels by the devkit's own formulas, and what its self-check finds."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import ReadFrame, SampleFrame
from synth3dlanes.formats.kitti import kitti_object, occlusion, parse_line
from synth3dlanes.formats.kitti import verify as of_frame
from synth3dlanes.formats.kitti import write as annotate
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import as_seen
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.formats.test_damaged_exports import check_damaged_files
from tests.scenes import FLAT, changed

N = 5
FISHEYE = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))


def seen(*cars: Car, **camera: float) -> Labels:
    """Labels of a flat road with cars that are seen."""
    labels = ground_truth(changed(FLAT.model_copy(update={"cars": cars}), camera=camera))
    ids = np.arange(1, 1 + len(cars), dtype=np.uint16)[None]
    return replace(labels, objects=as_seen(labels.objects, ids)).with_seen_shares([1.0] * len(cars))


def car(lane: str, s_m: float, model: int = 2) -> Car:
    return Car(model=model, scale=1.0, color=(1, 0, 0), gloss=0.5, lane=lane, s_m=s_m)


def test_a_car_that_drives_ahead_on_a_level_road_has_the_devkits_numbers():
    """The devkit: rotation_y is -pi/2 where a car drives along z; corners are turned about y around the middle of the
    lower side; alpha is rotation_y less the direction of sight."""
    labels = seen(car("main_3", -20), pitch_rad=0)
    found = kitti_object(labels.camera, labels.objects[0])
    assert (found.type, found.truncated, found.occluded) == ("Car", 0, 0)
    assert found.rotation_y_rad == pytest.approx(-np.pi / 2)
    assert found.alpha_rad == pytest.approx(-np.pi / 2 - np.arctan2(3.5, 30))
    np.testing.assert_allclose(found.location_cv, (3.5, 1.6, 30), atol=1e-9)
    np.testing.assert_allclose(found.height_width_length_m, (1.45, 1.83, 4.75))
    height, width, length = found.height_width_length_m
    c, s = np.cos(found.rotation_y_rad), np.sin(found.rotation_y_rad)
    corners = np.array(
        [
            [length / 2, length / 2, -length / 2, -length / 2] * 2,
            [0] * 4 + [-height] * 4,
            [width / 2, -width / 2, -width / 2, width / 2] * 2,
        ]
    )
    corners = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ corners + found.location_cv[:, None]
    k = labels.camera.img_from_cam[:, [0, 2, 1]] * [1, -1, 1] - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    u, v, w = k @ corners
    np.testing.assert_allclose(found.box_px, ((u / w).min(), (v / w).min(), (u / w).max(), (v / w).max()), atol=1e-6)
    own = labels.objects[0].corners_cam[:, [0, 2, 1]] * [1, -1, 1]
    apart = np.linalg.norm(corners.T[:, None] - own[None], axis=2)
    assert apart.min(axis=1).max() < 1e-9


@pytest.mark.parametrize(("share", "level"), [(1.0, 0), (0.9, 0), (0.89, 1), (0.5, 1), (0.49, 2), (0.1, 2)])
def test_levels_of_occlusion(share, level):
    assert occlusion(share) == level


def test_types_and_regions():
    labels = seen(*(car("main_2", -20 + 20 * i, model) for i, model in enumerate((1, 5, 6, 10, 11))))
    found = [kitti_object(labels.camera, item) for item in labels.objects]
    assert [item.type for item in found] == ["Car", "Van", "Truck", "Truck", "Misc"]
    hardly = labels.with_seen_shares([0.01] * 5)
    region = kitti_object(hardly.camera, hardly.objects[0])
    words = region.line().split()
    assert words[:4] == ["DontCare", "-1.00", "-1", "-10.0000"]
    assert words[8:] == ["-1.0000"] * 3 + ["-1000.0000"] * 3 + ["-10.0000"]
    assert parse_line(region.line(), "").location_cv.tolist() == [-1000] * 3


def test_a_frame_without_cars_has_a_region_without_a_size_as_tools_fail_on_an_empty_file() -> None:
    labels = seen()
    frame = SampleFrame(
        split="train", key="00000000", number=0, part="train", parts=frozenset({"train"}), scene=FLAT, labels=labels,
        passes={}, image_format="jpg", cameras={},
    )  # fmt: skip
    text = annotate(frame).files["training/label_2/000000.txt"]
    assert str(text).split() == ["DontCare", "-1.00", "-1", "-10.0000", *["0.00"] * 4, *["-1.0000"] * 3,
                                 *["-1000.0000"] * 3, "-10.0000"]  # fmt: skip
    source = SourceSample.__new__(SourceSample)
    vars(source).update(labels=labels, sweep=None)
    calib = {"Tr_velo_to_cam": np.eye(4)[:3], "R0_rect": np.eye(3), "P2": np.eye(4)[:3]}
    region = parse_line(str(text), "")
    for objects, expected in (([region], []), ([], ["expected a line"]), ([region, region], [])):
        found = of_frame(ReadFrame("a", "a", None, (objects, calib, None)), source).problems
        assert [words.partition(",")[0] for words in found] == expected


@pytest.mark.parametrize("text", ["", "Car 0 0", "Car" + " x" * 14, "Car" + " nan" * 14, "Car" + " 1" * 15])
def test_lines_that_are_none(text):
    with pytest.raises(FormatError, match="label: expected a type and 14 numbers"):
        parse_line(text, "label")


@pytest.fixture(scope="module")
def data(made_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Five rendered samples with a lidar."""
    params = load_params("streets", ["cars.n=20", "camera.width_px=240", "camera.height_px=160"])
    lidar = load_lidar("hdl_32e").model_copy(update={"azimuths": 180})
    recipe = Recipe(
        Scenes(params, 4, "train", shots=Shots(lidar=lidar)), RenderSettings(samples=1, passes=("lidar",)), "jpg"
    )

    def make(root: Path) -> None:
        assert generate(Plan(root, N, recipe, workers=1), lambda event: None).exit_code == 0

    return made_once("kitti", make)


@pytest.fixture
def exported(data: Path, tmp_path: Path) -> Export:
    job = Export(str(data), tmp_path / "kitti", "kitti")
    job.write()
    return job


def problems(job: Export) -> str:
    return "\n".join(problem for result in verify(job) for problem in result.problems)


@pytest.mark.render
@pytest.mark.parametrize("every", [9, pytest.param(2, marks=pytest.mark.thorough)])
def test_damaged_files_are_told_in_lines(exported, every):
    check_damaged_files(exported, every)


@pytest.mark.render
def test_an_export_is_what_the_labels_say(exported, data):
    assert problems(exported) == ""
    results = {result.name: result for result in verify(exported)}
    assert {name: result.n_frames for name, result in results.items()} == {
        "train": 4,
        "val": 1,
        "test": 1,
        "trainval": 5,
    }
    worst = {measure.unit: measure.worst for measure in results["trainval"].measures}
    assert worst["m"] < 5e-4
    assert worst["px"] < 0.01
    reader = Reader(str(data / "train"))
    points = np.fromfile(exported.out / "training/velodyne/000002.bin", "<f4").reshape(-1, 4)
    rows = dict(line.split(": ") for line in (exported.out / "training/calib/000002.txt").read_text().splitlines())
    pose = np.vstack([np.array(rows["Tr_velo_to_cam"].split(), float).reshape(3, 4), [0, 0, 0, 1]])
    expected = reader.lidar(2).points().xyz_cam
    np.testing.assert_allclose(
        transform(pose, points[:, :3].astype(float)), expected[:, [0, 2, 1]] * [1, -1, 1], atol=1e-4
    )
    # Points in front of the car are so in KITTI's axes: x forward, y left.
    assert (points[np.abs(points[:, 1]) < 1, 0] > 0).any()


def edited(job: Export, path: str, change: Callable[[str], str]) -> None:
    for file in sorted(job.out.glob(path)):
        file.write_text(change(file.read_text()))


def fields(column: int, change: Callable[[float], float], decimals: int = 4) -> Callable[[str], str]:
    """Another number in a column of every object."""

    def of_line(line: str) -> str:
        words = line.split()
        if words and words[0] != "DontCare":
            words[column] = f"{change(float(words[column])):.{decimals}f}"
        return " ".join(words)

    return lambda text: "\n".join(map(of_line, text.splitlines()))


def numbers_of(name: str, column: int, more: float) -> Callable[[str], str]:
    """Another number in a matrix of the calibration."""

    def of_line(line: str) -> str:
        words = line.split()
        if words[0] == f"{name}:":
            words[1 + column] = str(float(words[1 + column]) + more)
        return " ".join(words)

    return lambda text: "\n".join(map(of_line, text.splitlines()))


FAULTS = {
    "10 cm aside": ("training/label_2/*", fields(11, lambda x: x + 0.1), "got it 0.1 m off"),
    "mirrored": ("training/label_2/*", fields(11, lambda x: -x), "expected"),
    "the middle of the box as its place": ("training/label_2/*", fields(12, lambda y: y - 0.7), "got it 0.7 m off"),
    "turned by 2 degrees": ("training/label_2/*", fields(14, lambda y: y + 0.035), "m off"),
    "turned the other way": ("training/label_2/*", fields(14, lambda y: -y), "m off"),
    "alpha as rotation_y": ("training/label_2/*", fields(3, lambda a: a + 0.3), "expected alpha as it is seen"),
    "5 % longer": ("training/label_2/*", fields(10, lambda x: 1.05 * x), "m off"),
    "pixels from the corner": ("training/label_2/*", fields(4, lambda u: u + 0.5), "px off"),
    "other occlusion": ("training/label_2/*", fields(2, lambda level: 1 - min(level, 1), 0), "expected the occlusion"),
    "another truncation": (
        "training/label_2/*",
        fields(1, lambda t: 0.5 if t < 0.4 else 0.0),
        "expected the truncation",
    ),
    "no objects": ("training/label_2/*", lambda text: "", "got it in no line"),
    "another type": ("training/label_2/*", lambda text: text.replace("Car", "Van"), "got"),
    "a principal point in pixels from the corner": ("training/calib/*", numbers_of("P2", 2, 0.5), "px off"),
    "a lidar 10 cm on": (
        "training/calib/*",
        numbers_of("Tr_velo_to_cam", 11, 0.1),
        "points of the lidar: expected it as in the labels, got it 0.1 m off",
    ),
}  # fmt: skip


@pytest.mark.render
@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_found(exported, name):
    path, change, words = FAULTS[name]
    edited(exported, path, change)
    assert words in problems(exported)


@pytest.mark.render
def test_points_that_are_missing_are_found(exported):
    file = exported.out / "training/velodyne/000001.bin"
    file.write_bytes(file.read_bytes()[:-16])
    assert "points of the lidar, got" in problems(exported)
