"""Samples of all kinds, as they were made: `python -m tests.golden.frozen` writes frozen.json anew.

Of every sample are kept: the digest of its scene, its labels with long lists thinned, where and how large is what is
built and painted, the number of pixels of each instance and semantic id, and depths on a grid.
"""

import hashlib
import json
import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.roads.maps.part import read_place
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.world.solids import QuadCorners
from synth3dlanes.world.world import World
from tests.maps.files import PLAIN, TWO, lane, opendrive, plan, road, section

FILE = Path(__file__).parent / "frozen.json"
SETTINGS = RenderSettings(samples=1, passes=("depth", "instance", "semantic"))
# Longer lists are thinned to this many elements; depths are kept at this many rows and columns.
KEPT, GRID = 5, (9, 12)

OVER = ((0, 0, 0), (40, 0, 0.05), (160, 6, 0), (240, 6, -0.05), (360, 0, 0))
PROFILE = "".join(f'<elevation s="{s}" a="{a}" b="{b}" c="0" d="0"/>' for s, a, b in OVER)
BENDS = (
    '<planView><geometry s="0.0" x="0.0" y="0.0" hdg="0.0" length="150.0"><line/></geometry>'
    '<geometry s="150.0" x="149.99999999992403" y="0.0" hdg="0.0" length="120.0"><arc curvature="0.01"/></geometry>'
    '<geometry s="270.0" x="243.20390861062737" y="63.764224561897166" hdg="1.2" length="90.0">'
    '<spiral curvStart="0" curvEnd="-0.02"/></geometry></planView>'
)
BANKED = '<lateralProfile><superelevation s="0" a="0.05" b="0" c="0" d="0"/></lateralProfile>'
HILLY = '<elevationProfile><elevation s="0" a="12" b="0.03" c="-0.0001" d="0"/></elevationProfile>'
STREET = section(
    lane(3, PLAIN.replace("3.5", "2"), "sidewalk"),
    lane(2, PLAIN.replace("solid", "broken")),
    lane(1),
    lane(-1, '<width sOffset="0" a="3" b="0.002" c="0" d="0"/><roadMark sOffset="0" type="broken" color="yellow"/>'),
    lane(-2, PLAIN.replace("3.5", "0.5"), "shoulder"),
)
# All that paint, seams and what stands beside the road may have.
PAINT = (
    *("road.topology=4", "trees.n=0", "cars.n=0", "markings.left_double=true", "markings.left_pair=dashed_solid"),
    *("markings.dots=true", "markings.missing=0.3", "surface.tar=1", "surface.ghost_lines=1", "surface.joint=1"),
)
BESIDE = (
    *(
        "road.topology=2",
        "road.n_oncoming=2",
        "road.median_m=6",
        "roadside.outer=noise_wall",
        "roadside.inner=concrete",
    ),
    *("roadside.median=guardrail", "roadside.ramp_rail=true", "roadside.lamps=both", "roadside.delineators=true"),
    *("roadside.n_signs=9", "roadside.n_gantries=2", "roadside.n_bridges=1", "roadside.lane_signals=true", "trees.n=0"),
    *("roadside.n_houses=4", "roadside.n_halls=1", "roadside.n_blocks=1", "roadside.power_line=left", "cars.n=0"),
)
# Files of maps and the host's place in each.
MAPS = {
    "bridge": (
        "1:160:-1",
        road(plan(("<line/>", 400.0)), TWO, "1"),
        road(
            plan(("<line/>", 400.0), start=(200.0, -200.0, math.pi / 2)),
            TWO,
            "2",
            profile=f"<elevationProfile>{PROFILE}</elevationProfile>",
        ),
    ),
    "bends": ("1:40:-1", road(BENDS, STREET, "1", profile=HILLY + BANKED)),
}


class Row(NamedTuple):
    """How a sample is drawn."""

    preset: str = "appendix_i"
    index: int = 0
    shots: Shots = SINGLE
    map: str = ""
    changes: tuple[str, ...] = ()


def _rows() -> Iterator[tuple[str, Row]]:
    counts = {"appendix_i": 8, "diverse": 2, "realistic": 2, "openlane_camera": 1, "streets": 6, "town": 8}
    for preset, count in counts.items():
        for index in range(count):
            yield f"{preset} {index}", Row(preset, index)
    clip, rig = Shots(frames=6), Shots(cameras=load_rig("nuscenes"))
    yield "clip, frame 0", Row("streets", 6, clip)
    yield "clip, frame 5", Row("streets", 11, clip)
    yield "clip of a town, frame 5", Row("town", 5, clip)
    for name in ("CAM_FRONT_LEFT", "CAM_BACK"):
        at = [camera.name for camera in rig.cameras].index(name)
        yield f"rig, {name}", Row("streets", at, rig)
        yield f"rig in a town, {name}", Row("town", at + 2 * len(rig.cameras), rig)
    wide = CameraSpec(width_px=480, height_px=360, fx_px=150, model="fisheye", k1=-0.02)
    yield "fisheye", Row("streets", 2, Shots(cameras=(wide,)))
    yield "fisheye in a town", Row("town", 3, Shots(cameras=(wide,)))
    scanned = Shots(lidar=load_lidar("vlp_32c"))
    yield "lidar", Row("appendix_i", 1, scanned)
    yield "lidar in a town", Row("town", 6, scanned)
    for name in MAPS:
        yield f"map of {name}", Row("streets", 0, SINGLE, name)
    yield "clip on a map, frame 3", Row("streets", 3, clip, "bends")
    for index in (1, 2):
        yield f"works {index}", Row("streets", index, changes=("works.present=true", "road.topology=1"))
        yield f"paint {index}", Row("appendix_i", index, changes=PAINT)
        yield f"beside {index}", Row("streets", index, changes=BESIDE)
    yield "mountain", Row("mountain", 1, changes=("mountain.lay_by=true", "mountain.rail=guardrail"))


ROWS = dict(_rows())


@cache
def _place(name: str) -> MapPlace:
    place, *roads = MAPS[name]
    given = read_opendrive(opendrive(*roads), name, f"map {name}")
    return MapPlace(given, read_place(given, place))


def scenes_of(row: Row) -> Scenes:
    """What the row's sample is drawn from."""
    params = load_params(row.preset, row.changes)
    return Scenes(params, 58, "frozen", shots=row.shots, map=_place(row.map) if row.map else None)


def sample(name: str) -> dict[str, Any]:
    """What is kept of the sample of a row."""
    row = ROWS[name]
    world = sample_world(scenes_of(row), row.index)
    picture = take_picture(world, SETTINGS)
    depth_m = picture.passes["depth"]
    rows, columns = (np.linspace(0, n - 1, k).round().astype(int) for n, k in zip(depth_m.shape, GRID, strict=True))
    return {
        "scene": digest(world.scene),
        "labels": thinned(json.loads(label_file.to_json(picture.labels))),
        "built": built(world),
        "instance": counts(picture.passes["instance"]),
        "semantic": counts(picture.passes["semantic"]),
        "depth_m": np.where(np.isfinite(depth_m), depth_m, -1.0)[np.ix_(rows, columns)].round(3).tolist(),
    }


def built(world: World) -> dict[str, dict[str, Any]]:
    """Of all faces of each kind together, in whatever polygons: the middle; the square roots of their area and of what
    of it faces up; and the usual distance from the middle. Terrain is left out: the depths see it."""
    view = world.view
    found: dict[str, list[QuadCorners]] = {body.kind: [] for body in world.site.structures}
    for body in world.site.structures:
        found[body.kind].append(body.corners_world)
    seams = {"tar": world.tar(view), "ghosts": world.ghost_lines(view), "removed": world.removed_lines(view)}
    painted = [("paint", mesh) for mesh in world.paint(view).values()] + [("symbols", it) for it in world.symbols(view)]
    for name, mesh in [*painted, *((name, mesh) for name, mesh in seams.items() if mesh is not None)]:
        found.setdefault(name, []).append(mesh.vertices_world[mesh.faces])
    for mesh in world.site.surfaces.pavement:
        for slot in np.unique(mesh.material).tolist():
            found.setdefault(f"pavement {slot}", []).append(mesh.vertices_world[mesh.faces[mesh.material == slot]])
    if blades := world.grass(view):
        found["grass"] = [blades.corners_world[:, [0, 1, 2, 2]]]
    return {kind: _moments(np.concatenate(quads)) for kind, quads in sorted(found.items())}


def _moments(quads: QuadCorners) -> dict[str, Any]:
    a, b, c, d = quads.transpose(1, 0, 2)
    normals, middles = np.cross(c - a, d - b) / 2, quads.mean(axis=1)
    areas, up = np.linalg.norm(normals, axis=1), normals[:, 2].sum()
    middle = areas @ middles / areas.sum()
    away_m = np.sqrt(areas @ ((middles - middle) ** 2).sum(axis=1) / areas.sum())
    sizes = {"side_m": np.sqrt(areas.sum()), "up_m": np.sign(up) * np.sqrt(abs(up)), "away_m": away_m}
    return {"middle_world": middle.round(5).tolist(), **{name: round(float(at), 5) for name, at in sizes.items()}}


def digest(scene: Scene) -> str:
    """The first digits of that of its text."""
    return hashlib.sha256(scene_file.to_json(scene).encode()).hexdigest()[:16]


def counts(ids: np.ndarray) -> dict[str, int]:
    """The number of pixels of each id."""
    return {str(i): n for i, n in zip(*(part.tolist() for part in np.unique(ids, return_counts=True)), strict=True)}


def thinned(value: Any) -> Any:
    """A document whose long lists keep KEPT elements, from the first to the last, and their length. Floats are rounded
    to a hundredth of a millimetre."""
    if isinstance(value, dict):
        return {key: thinned(part) for key, part in value.items()}
    if isinstance(value, list):
        if len(value) > KEPT and not isinstance(value[0], dict):
            at = np.linspace(0, len(value) - 1, KEPT).round().astype(int).tolist()
            return [len(value), *(thinned(value[i]) for i in at)]
        return [thinned(part) for part in value]
    return round(value, 5) if isinstance(value, float) else value


def differences(expected: Any, found: Any, where: str = "") -> Iterator[str]:
    """Where two documents differ, numbers by more than 0.1 mm."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in expected | found:
            if key not in expected or key not in found:
                yield f"{where}.{key}: {'new' if key in found else 'gone'}"
            else:
                yield from differences(expected[key], found[key], f"{where}.{key}")
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for i, (a, b) in enumerate(zip(expected, found, strict=True)):
            yield from differences(a, b, f"{where}[{i}]")
    elif isinstance(expected, float) and isinstance(found, float | int):
        if abs(expected - found) > 1.01e-4:
            yield f"{where}: expected {expected}, got {found}"
    elif expected != found:
        yield f"{where}: expected {expected!s:.60}, got {found!s:.60}"


def main() -> None:
    """Write the file."""
    rows = []
    for name in ROWS:
        rows.append(f"{json.dumps(name)}: {json.dumps(sample(name), separators=(',', ':'))}")
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n")


if __name__ == "__main__":
    main()
