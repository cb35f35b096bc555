"""`--verify` of every format on data sets of every kind: an export is as its labels say, or refused with the reason."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats.comparing import back_along
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import PinholeFormat, format_names, open_format
from synth3dlanes.formats.verify import Verification, verify
from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from tests import fake_samples
from tests.maps import files
from tests.maps.test_round_trip import forks

Made = Callable[[str, Callable[[Path], object]], Path]
SMALL = ("camera.width_px=160", "camera.height_px=120", "camera.horizontal_fov_deg=60", "trees.n=0")
LENS = {"width_px": 160, "height_px": 120, "fx": 60, "fy": 60, "cx": 80, "cy": 60, "height_m": 1.5, "pitch_deg": 2}
TOWN = (
    "town.junction={crossing: 1, roundabout: 1}", "town.host_place=before", "town.host_m=15", "town.n_more=0",
    "town.traffic=0.2", "town.parked=0.8", "town.parking=true", "town.fronts=0", "trees.n=0",
    "camera.horizontal_fov_deg=60",
)  # fmt: skip
TWO_LANE_RINGS = ("town.junction=roundabout", "town.n_lanes=2", *TOWN[1:])
# Preset, changes, how it is seen, and how many samples.
KINDS: dict[str, tuple[str, tuple[str, ...], dict[str, Any], int]] = {
    "paper": ("appendix_i", SMALL, {}, 2),
    "streets": ("streets", SMALL, {}, 2),
    "night": ("streets", (*SMALL, "weather.daytime=night"), {}, 1),
    "town": ("town", (*SMALL, *TOWN), {}, 2),
    "roundabout": ("town", (*SMALL, *TWO_LANE_RINGS), {}, 1),
    "clip": ("streets", SMALL, {"frames": 3, "fps": 30}, 3),
    # The line between the lanes of this ring is a circle.
    "town clip": ("town", (*SMALL, "town.junction=roundabout_2", *TWO_LANE_RINGS[1:]), {"frames": 2, "fps": 30}, 2),
    "rig": ("streets", SMALL, {"cameras": ("CAM_FRONT", "CAM_BACK")}, 2),
    "town rig": ("town", (*SMALL, *TOWN), {"cameras": ("CAM_FRONT", "CAM_BACK")}, 2),
    "ring rig": ("streets", SMALL, {"cameras": ("ring_front_center", "ring_rear_left"), "lidar": "hdl_32e"}, 2),
    "lidar": ("streets", SMALL, {"lidar": "hdl_32e"}, 1),
    "given map": ("realistic", SMALL, {}, 2),
    "fisheye": ("streets", SMALL, {"cameras": ("fisheye",)}, 1),
}
ONE_PICTURE = KINDS.keys() - {"clip", "town clip"}
OF_PINHOLES = ("argoverse2", "kitti", "nuscenes", "openlane_v2")
REFUSED = (
    {("cosmos", kind): "expected a clip of two frames or more" for kind in ONE_PICTURE}
    | {(name, "fisheye"): "expected a camera without distortion" for name in OF_PINHOLES}
    | {("argoverse2", kind): "expected a rig with cameras of Argoverse 2" for kind in ("rig", "town rig")}
)
ALL = [(kind, name) for kind in KINDS for name in format_names()]
RESAMPLED = [name for name in format_names() if isinstance(open_format(name), PinholeFormat)]
# What differs most from other kinds; each format is in it.
QUICK = {
    *((kind, "openlane_v2") for kind in ("rig", "roundabout")),
    ("rig", "argoverse2"),
    ("paper", "cosmos"),
    *(("ring rig", name) for name in ("argoverse2", "kitti")),
    *((kind, name) for kind in ("paper", "town") for name in ("opendrive", *RESAMPLED)),
    ("town", "lanelet2"),
    *(("streets", name) for name in ("coco", "masks", "yolo")),
    ("clip", "cosmos"),
    ("town rig", "nuscenes"),
    ("fisheye", "kitti"),
}


def cameras_of(names: tuple[str, ...], folder: Path) -> tuple[CameraSpec, ...]:
    """A fisheye, or cameras of these names that look ahead and back."""
    path = folder / "cameras.yaml"
    if names == ("fisheye",):
        path.write_text(yaml.safe_dump({**LENS, "model": "fisheye", "k1": 0.02}))
        return (load_camera(str(path)),)
    path.write_text(
        yaml.safe_dump({name: {**LENS, "yaw_deg": 170 * i} for i, name in enumerate(names)}, sort_keys=False)
    )
    return load_rig(str(path))


@pytest.fixture(scope="module")
def made(made_once: Made) -> Callable[[str], Path]:
    """The data set of a kind, with drawn pictures and passes."""

    def data_set(kind: str) -> Path:
        preset, changes, seen, n = KINDS[kind]

        def make(root: Path) -> None:
            root.mkdir()
            seen_by = dict(seen)
            if "cameras" in seen:
                seen_by["cameras"] = cameras_of(seen["cameras"], root)
            if "lidar" in seen:
                seen_by["lidar"] = load_lidar(seen["lidar"]).model_copy(update={"azimuths": 90})
            scenes = Scenes(load_params(preset, changes), 3, "train", shots=Shots(**seen_by))
            if kind == "given map":
                given = read_opendrive(files.opendrive(*forks()), "forks.xodr", "map forks.xodr")
                scenes = replace(scenes, map=MapPlace(given))
            passes = ("depth", "semantic", "instance", *(["lidar"] if "lidar" in seen else []))
            recipe = Recipe(scenes, RenderSettings(passes=passes), "jpg")
            plan = Plan(str(root / "data"), n, recipe, workers=1, maker=fake_samples.make_with_passes)
            assert generate(plan, lambda event: None).exit_code == 0

        return made_once(f"table {kind}", make) / "data"

    return data_set


def verified(job: Export) -> tuple[Verification, ...]:
    """The comparison of an export that is made now."""
    summary = job.write()
    if not any(summary.n_frames.values()):
        raise InputError("; ".join(summary.left_out))
    return verify(job)


@pytest.mark.parametrize(
    ("kind", "name"), [pytest.param(*case, marks=[pytest.mark.thorough] * (case not in QUICK)) for case in ALL]
)
def test_an_export_is_as_in_the_labels_or_refused(
    kind: str, name: str, made: Callable[[str], Path], tmp_path: Path
) -> None:
    job = Export(str(made(kind)), tmp_path / "new" / "out", name)
    reason = REFUSED.get((name, kind))
    if reason is not None:
        with pytest.raises(InputError, match=reason):
            verified(job)
        assert not job.out.parent.exists(), "nothing is left of what was refused"
        return
    results = verified(job)
    assert [problem for result in results for problem in result.problems] == []
    assert all(of.n_matched == of.n for result in results for of in result.compared.values())
    assert sum(result.n for result in results) > 0


def test_a_lane_moved_aside_a_lost_link_and_other_paint_are_found_in_a_town(
    made: Callable[[str], Path], tmp_path: Path
) -> None:
    job = Export(str(made("town")), tmp_path / "out", "opendrive")
    job.write()
    path = next(job.out.glob("*/*.xodr"))
    text = path.read_text()
    for pattern, replacement, expected in (
        (r'(<laneOffset s="0" a=")[^"]*', r"\g<1>0.4", "within 0.15 m of the labels"),
        (r'(<lane id="-1".*?<successor id=")[^"]*', r"\g<1>-9", "to follow it, got none"),
        (r'type="broken"', 'type="solid"', "is painted, got solid"),
    ):
        path.write_text(re.sub(pattern, replacement, text, flags=re.DOTALL))
        found = [problem for result in verify(job) for problem in result.problems]
        assert any(expected in problem for problem in found), (pattern, found[:3])


X, ANGLE = np.arange(0.0, 80.0), np.linspace(0, 2 * np.pi, 90)
THERE_AND_BACK = [X[:40] - 40, X[:40] - 40], [X, 0 * X], [X[::-1], 0 * X + 0.01]


@pytest.mark.parametrize(
    "line",
    [
        np.concatenate([np.column_stack(part) for part in THERE_AND_BACK]),
        20 * np.column_stack([np.sin(ANGLE), np.cos(ANGLE), 0 * ANGLE]),
    ],
    ids=["in an image", "around a roundabout"],
)
def test_a_line_that_passes_a_place_twice_goes_back_only_where_its_points_do(line: np.ndarray) -> None:
    rounded = line[np.unique([*range(0, len(line), 8), len(line) - 1])] + 1e-5
    assert back_along(rounded, line, 0.05) == 0
    assert back_along(rounded[::-1], line, 0.05) > 40
