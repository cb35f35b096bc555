"""Cosmos: what `verify` finds in tables and videos; depth and edges by other implementations; what is refused."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats import cosmos as of_tables
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.cosmos import FOLDERS, ClipFiles, CosmosClip, fitted, video_problems
from synth3dlanes.formats.cosmos_videos import (
    Scenario,
    depth_picture,
    edges,
    lane_map_picture,
    nearness_span,
    scenario,
)
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.imaging.video import mp4, open_video
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import replacing
from synth3dlanes.world.world import resolve
from tests import fake_samples
from tests.formats import closed_form as cf
from tests.formats.planting import other, problems
from tests.thorough import first

FRONT, REAR = "camera_front_wide_120fov", "camera_rear_left_70fov"
PASSES = ("depth", "semantic", "instance")
CHANGES = (
    "road.topology=1", "road.n_lanes=3", "symbols.crosswalks=1", "symbols.stop_lines=1", "symbols.arrow_rows=1",
    "cars.n=5", "roadside.exit_signs=true", "trees.n=0",
)  # fmt: skip


def two_cameras(folder: Path) -> Any:
    """One camera ahead, of an odd width, and one to the rear left."""
    lens = {"fx": 150, "fy": 150, "cy": 50}
    place = {"right_m": 0, "forward_m": 0.4, "height_m": 1.5, "pitch_deg": 3, "roll_deg": 1}
    ahead = {**lens, **place, "cx": 90, "width_px": 181, "height_px": 100, "yaw_deg": 0}
    rear = {**ahead, "cx": 80, "width_px": 160, "yaw_deg": 150, "right_m": -0.8}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump({FRONT: ahead, REAR: rear}, sort_keys=False))
    return load_rig(str(path))


def made(root: Path, n: int, shots: Shots, passes: tuple[str, ...] = PASSES) -> Path:
    recipe = Recipe(
        Scenes(load_params("streets", CHANGES), 5, "test", shots=shots), RenderSettings(passes=passes), "jpg"
    )
    assert not generate(Plan(str(root), n, recipe, workers=1, maker=fake_samples.make_with_passes), print).problem
    return root


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of three frames by two cameras, with passes that were drawn."""
    root = tmp_path_factory.mktemp("clips")
    return made(root / "data", 6, Shots(frames=3, fps=5, cameras=two_cameras(root)))


@pytest.fixture(scope="module")
def exported(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cosmos") / "out"
    Export(str(clips), out, "cosmos").write()
    return out


@pytest.fixture
def copy(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "out", symlinks=True))


def found_in_tables(out: Path, clips: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is found wrong in the tables of a clip, without a look at its videos."""
    monkeypatch.setattr(of_tables, "video_problems", lambda *_: ())
    return problems(clips, out, "cosmos")


def found_in_videos(out: Path, clips: Path, kind: str) -> list[str]:
    """What is found wrong in the videos of a kind of the front camera."""
    clip, reader = CosmosClip(out, ClipFiles("test", "test-00000000")), Reader(f"{clips}/test")
    pictures = [SourceSample(reader, place) for place in reader.clip(0, 0)]
    return list(video_problems(clip, FRONT, pictures, around_of(pictures), (kind,)))


def around_of(pictures: list[SourceSample]) -> Scenario:
    first = pictures[0]
    return scenario(resolve(first.scene), first.labels, (picture.labels for picture in pictures))


def found_in_any(out: Path, clips: Path) -> None:
    """Read the times, the spans and a video."""
    assert CosmosClip(out, ClipFiles("test", "test-00000000")).times
    found_in_videos(out, clips, "seg")


def table(out: Path, name: str) -> Path:
    return next(out.glob(f"test/clipgt/*/*.{name}.parquet"))


def rows(out: Path, name: str) -> list[dict[str, Any]]:
    return [row[name] | row["key"] for row in parquet.read_table(table(out, name)).to_pylist()]


def test_a_clip_is_as_its_labels_say(exported: Path, clips: Path) -> None:
    (result,) = verify(Export(str(clips), exported, "cosmos"))
    assert result.problems == ()
    worst = {measure.unit: measure.worst for measure in result.measures}
    assert worst["m"] < 0.02
    assert worst["px"] < 0.01
    assert result.n > 60
    for name in ("lane", "lane_line", "road_boundary", "crosswalk", "wait_line", "road_marking", "traffic_sign"):
        assert rows(exported, name), name
    for folder in FOLDERS.values():
        assert {path.parent.name for path in exported.glob(f"test/{folder}/*/*.mp4")} == {
            f"ftheta_{FRONT}",
            f"ftheta_{REAR}",
        }


def test_places_reach_pixels_by_the_readers_formulas(exported: Path, clips: Path) -> None:
    """World, rig, camera, f-theta: written down from docs of ClipGT, with SciPy's rotations."""
    reader = Reader(f"{clips}/test")
    sensors = json.loads(rows(exported, "calibration_estimate")[0]["rig_json"])["rig"]["sensors"]
    lines = {row["map_id"]: np.array([[*point.values()] for point in row["line_rail"]]) for row in
             rows(exported, "lane_line")}  # fmt: skip
    n_seen = 0
    for index in range(6):
        labels, sensor = reader.labels(index), sensors[index % 2]
        pose, place, lens = rows(exported, "egomotion_estimate")[index // 2], sensor["nominalSensor2Rig_FLU"], sensor
        turn = Rotation.from_euler("xyz", place["roll-pitch-yaw"], degrees=True)
        rig = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"])
        at = np.array([pose["location"][axis] for axis in "xyz"])
        properties = lens["properties"]
        factors = [float(text) for text in properties["polynomial"].split()]
        for lane in labels.lanes:
            if lane.id in lines and lane.in_image.sum() > 2:
                ours = labels.camera.project(lane.xyz_cam[lane.in_image])
                points = turn.inv().apply(rig.inv().apply(lines[lane.id] - at) - place["t"])
                x, y, z = points[points[:, 0] > 1].T
                radius = sum(factor * np.arctan2(np.hypot(y, z), x) ** i for i, factor in enumerate(factors))
                u = float(properties["cx"]) - float(properties["linear-c"]) * radius * y / np.hypot(y, z)
                v = float(properties["cy"]) - radius * z / np.hypot(y, z)
                apart = np.linalg.norm(ours[:, None] - np.column_stack([u, v]), axis=2).min(axis=1)
                assert np.median(apart) < 2.5, "points are half a metre apart, so pixels lie between"
                n_seen += 1
    assert n_seen > 6
    assert np.allclose([*rows(exported, "egomotion_estimate")[0]["location"].values()], 0, atol=1e-9)


def edit(out: Path, name: str, change: Callable[[list[dict[str, Any]]], object]) -> None:
    """Change the elements of a table."""

    def of_elements(found: list[dict[str, Any]]) -> None:
        change([row[name] for row in found])

    other(f"test/clipgt/*/*.{name}.parquet", of_elements)(out)


def each_point(change: Callable[[dict[str, float]], object]) -> Callable[[list[dict[str, Any]]], None]:
    def plant(found: list[dict[str, Any]]) -> None:
        for row in found:
            for point in row["line_rail"]:
                change(point)

    return plant


def swapped(key: str) -> Callable[[list[dict[str, Any]]], None]:
    def plant(found: list[dict[str, Any]]) -> None:
        found[0][key], found[1][key] = found[1][key], found[0][key]

    return plant


def turned(found: list[dict[str, Any]]) -> None:
    """The first car turns by two degrees."""
    way = found[0]["orientation"]
    more = Rotation.from_euler("z", 2, degrees=True) * Rotation.from_quat([way[axis] for axis in "xyzw"])
    way.update(zip("xyzw", more.as_quat().tolist(), strict=True))


def rig(change: Callable[[dict[str, Any]], object]) -> Callable[[list[dict[str, Any]]], None]:
    def plant(found: list[dict[str, Any]]) -> None:
        document = json.loads(found[0]["rig_json"])
        change(document["rig"]["sensors"][0])
        found[0]["rig_json"] = json.dumps(document)

    return plant


# Table, what is changed, and what is told.
FAULTS: dict[str, tuple[str, Callable[[list[dict[str, Any]]], object], str]] = {
    "mirrored": ("lane_line", each_point(lambda p: p.update(y=-p["y"])), r"main_line_\d: expected .* m off"),
    "shifted": ("lane_line", each_point(lambda p: p.update(y=p["y"] - 0.3)), r"main_line_\d: .* got it 0.\d+ m off"),
    "swapped": ("lane_line", swapped("line_rail"), r"main_line_\d: expected .* m off"),
    "reordered": ("lane_line", lambda f: f[0]["line_rail"].reverse(), r"line \w+: .* got them \d+(\.\d+)? m back"),
    "paint": ("lane_line", lambda f: f[0].update(colors=["BLUE"] * len(f[0]["colors"])), r"line \w+: .*BLUE"),
    "lanes": ("lane", swapped("left_rail"), r"lane main_\d: .* m away|rails of as many points"),
    "turned car": ("obstacle", turned, r"object \d+: expected it as in the labels, got it 0\.\d+ m off"),
    "moved car": ("obstacle", lambda f: f[0]["center"].update(x=f[0]["center"]["x"] + 0.1), r"object \d+: .* 0.1 m"),
    "swapped cars": ("obstacle", swapped("trackline_id"), r"object \d+: expected the id \d+, got \d+"),
    "class": ("obstacle", lambda f: f[0].update(category="person"), r"object \d+: expected the class \w+, got person"),
    "size": ("obstacle", lambda f: f[0]["size"].update(x=f[0]["size"]["x"] + 0.2), r"object \d+: .* m off"),
    "lens": ("calibration_estimate", rig(lambda s: s["properties"].update(cx="93")), r"camera .*: .* got it 3 px off"),
    "camera's place": (
        "calibration_estimate", rig(lambda s: s["nominalSensor2Rig_FLU"].update(t=[0, 0.2, 1.5])), r"line_\d: .* m off",
    ),
    "poses": ("egomotion_estimate", swapped("location"), r"object \d+: expected .* m off"),
    "sign": ("traffic_sign", lambda f: f[0]["center"].update(z=9.0), r"traffic sign \d+: .* m off"),
    "crosswalk": ("crosswalk", lambda f: f[0]["location"][0].update(x=0.0), "crosswalk: expected one on a crosswalk"),
}  # fmt: skip


@pytest.mark.parametrize("fault", first(1, FAULTS))
def test_a_fault_in_a_table_is_found(copy: Path, clips: Path, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, change, told = FAULTS[fault]
    edit(copy, name, change)
    found = found_in_tables(copy, clips, monkeypatch)
    assert any(re.search(told, problem) for problem in found), found


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("lane_line", r"line \w+: expected it in lane_line, got none nearer than \d\S* m"),
        ("obstacle", r"expected \w+ \d+, got it in no row"),
        ("egomotion_estimate", "expected poses at .* microseconds"),
        ("crosswalk", "crosswalk: expected 1 as in the labels, got 0"),
    ],
)
def test_a_dropped_row_is_found(copy: Path, clips: Path, name: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = table(copy, name)
    parquet.write_table(parquet.read_table(path)[1:], path)
    found = found_in_tables(copy, clips, monkeypatch)
    assert any(re.search(told, problem) for problem in found), found


def video_fault(path: Path, change: Callable[[list[np.ndarray]], list[np.ndarray]], rate_hz: float = 5.0) -> None:
    with open_video(path) as video:
        frames = change(list(video.frames))
    with replacing(path) as stream, mp4(str(path), stream, rate_hz, 5) as out:
        for frame in frames:
            out.add(np.ascontiguousarray(frame))


VIDEO_FAULTS: dict[str, Callable[[list[np.ndarray]], list[np.ndarray]]] = {
    "mirrored": lambda frames: [frame[:, ::-1] for frame in frames],
    "shifted": lambda frames: [np.roll(frame, 6, axis=1) for frame in frames],
    "dropped": lambda frames: frames[:-1],
    "doubled": lambda frames: [*frames, frames[-1]],
    "black": lambda frames: [0 * frame for frame in frames],
}


# The drawn wall is level.
UNSEEN = {("mirrored", "depth"), ("shifted", "depth")}
VIDEO_CASES = [(fault, kind) for fault in VIDEO_FAULTS for kind in FOLDERS if (fault, kind) not in UNSEEN]


@pytest.mark.parametrize(("fault", "kind"), first(8, VIDEO_CASES))
def test_a_fault_in_a_video_is_found(copy: Path, clips: Path, fault: str, kind: str) -> None:
    path = next(copy.glob(f"test/{FOLDERS[kind]}/ftheta_{FRONT}/*.mp4"))
    video_fault(path, VIDEO_FAULTS[fault])
    found = found_in_videos(copy, clips, kind)
    assert any(FOLDERS[kind] in problem and "frame" in problem for problem in found), found


@pytest.mark.thorough
def test_a_video_of_another_rate_or_kind_is_found(copy: Path, clips: Path) -> None:
    path = next(copy.glob(f"test/depth/ftheta_{FRONT}/*.mp4"))
    whole = path.read_bytes()
    video_fault(path, lambda frames: frames, 10.0)
    with pytest.raises(FormatError, match="expected 5 frames a second, got 10"):
        found_in_videos(copy, clips, "depth")
    path.write_bytes(next(copy.glob(f"test/seg/ftheta_{FRONT}/*.mp4")).read_bytes())
    assert any("/depth/" in problem for problem in found_in_videos(copy, clips, "depth"))
    path.write_bytes(whole)
    times = next(copy.glob("test/clipgt/*/*.camera_front_wide_120fov.json"))
    times.write_text(times.read_text().replace("200000", "210000"))
    assert any("expected times at" in problem for problem in problems(clips, copy, "cosmos"))


@pytest.mark.parametrize("damage", first(1, [b"PAR1" * 30, b"", b"\0" * 100, b"[1]"]))
def test_damaged_files_end_in_one_line(copy: Path, clips: Path, damage: bytes) -> None:
    for path in (
        *(table(copy, name) for name in ("lane_line", "egomotion_estimate", "calibration_estimate")),
        *copy.glob("test/clipgt/*/*.json"),
        next(copy.glob(f"test/seg/ftheta_{FRONT}/*.mp4")),
    ):
        whole = path.read_bytes()
        path.write_bytes(damage)
        with pytest.raises(FormatError, match=re.escape(path.name)) as problem:
            problems(clips, copy, "cosmos") if path.suffix == ".parquet" else found_in_any(copy, clips)
        assert len(str(problem.value)) < 400
        path.write_bytes(whole)


@pytest.mark.thorough
def test_a_camera_alone_is_the_front_one_and_a_view_may_be_chosen(clips: Path, tmp_path: Path) -> None:
    summary = Export(str(clips), tmp_path / "rear", "cosmos", cameras=(REAR,)).write()
    assert sum(summary.n_frames.values()) == 1
    assert {path.parent.name for path in (tmp_path / "rear").glob("test/videos/*/*.mp4")} == {f"ftheta_{REAR}"}
    assert not [p for r in verify(Export(str(clips), tmp_path / "rear", "cosmos", cameras=(REAR,))) for p in r.problems]


@pytest.mark.thorough
@pytest.mark.render
def test_a_rendered_clip_is_as_its_passes_say(
    made_once: Callable[[str, Callable[[Path], object]], Path], tmp_path: Path
) -> None:
    """Hills hide lines, cars stand before them, and edges are where the picture has some."""
    params = load_params("streets", [*CHANGES, "camera.width_px=192", "camera.height_px=128"])
    recipe = Recipe(Scenes(params, 3, "train", shots=Shots(frames=2)), RenderSettings(samples=1, passes=PASSES), "jpg")

    def make(root: Path) -> None:
        assert generate(Plan(root, 2, recipe, workers=1), lambda event: None).exit_code == 0

    data = made_once("cosmos", make)
    job = Export(str(data), tmp_path / "out", "cosmos")
    job.write()
    assert [problem for result in verify(job) for problem in result.problems] == []
    for kind in FOLDERS:
        path = next(job.out.glob(f"train/{FOLDERS[kind]}/*/*.mp4"))
        video_fault(path, VIDEO_FAULTS["mirrored"], 10.0)
    found = [problem for result in verify(job) for problem in result.problems]
    assert {kind for kind, folder in FOLDERS.items() if any(f"/{folder}/" in problem for problem in found)} == {
        *FOLDERS
    }


def test_painted_lines_and_cars_are_in_the_lane_map_where_the_labels_have_them(clips: Path) -> None:
    reader = Reader(f"{clips}/test")
    pictures = [SourceSample(reader, place) for place in reader.clip(0, 0)]
    for picture in pictures:
        camera, light = picture.labels.camera, lane_map_picture(picture, around_of(pictures)).max(axis=2)
        solid = [lane for lane in picture.labels.lanes if lane.marking == "solid"]
        points = np.concatenate([lane.xyz_cam[lane.in_image & lane.terrain_visible] for lane in solid])
        cars = [item.center_cam for item in picture.labels.objects if camera.shows(item.center_cam[None])[0]]
        for places, aside_px in ((points[points[:, 1] < 30], 6), (np.array(cars).reshape(-1, 3), None)):
            column, row = np.floor(camera.project(places)).astype(int).T
            assert len(row)
            assert np.mean(light[row.clip(0, 99), column.clip(0, 180)] > 60) > 0.9
            if aside_px:
                asides = [light[row.clip(0, 99), (column + to).clip(0, 180)].mean() for to in (-aside_px, aside_px)]
                assert light[row.clip(0, 99), column.clip(0, 180)].mean() > 1.2 * max(asides)


def test_f_theta_follows_pinholes_and_refuses_what_it_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = cf.camera_label()
    with monkeypatch.context() as patched:
        patched.setattr(of_tables, "LIMIT_PX", 0.2)
        fitted(camera, "a")
    bent = Lens(model="opencv", coefficients=(0.0, 0.0, 0.05, 0.05, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="a: expected a camera that an f-theta polynomial follows within 1 px"):
        fitted(replace(camera, lens=bent), "a")


def test_edges_by_the_definition() -> None:
    """A step has one line of edges on its brighter or darker side, a faint step none, a faint one beside a strong one
    is kept where they meet."""
    image = np.full((40, 60, 3), 60, np.uint8)
    image[:, 30:] = 200
    found = edges(image)
    assert found[5:-5].sum(axis=1).tolist() == [1] * 30
    assert {29, 30} >= set(np.nonzero(found[20])[0].tolist())
    faint = np.full((40, 60, 3), 60, np.uint8)
    faint[:, 30:] = 80
    assert not edges(faint).any()


def test_what_is_beside_and_behind_a_fisheye_does_not_darken_its_depth_video() -> None:
    depth_m = np.array([[-4.0, 1e-4, 0.5, 1.0, 4.0, np.inf]], np.float32)
    passes = {"depth": depth_m, "semantic": np.ones(depth_m.shape, np.uint8)}
    span = nearness_span(passes)
    assert span == (0.0, 1.0)
    assert depth_picture(passes, span)[0, :, 0].tolist() == [255, 255, 255, 255, 64, 0]
