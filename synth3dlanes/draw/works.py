"""Road works on the paper's road: where they are and what they close, and the cones, barrels and barricades there."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.works import WorksLanes
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import PaperRoad, Scene, Thing
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.scene.works import RoadWorks
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.ground import Ground

# Lines that would move by less do not, and on narrower shoulders there is no room for works.
LEAST_MOVE_M, LEAST_SHOULDER_M = 0.3, 1.2
# What is left of a shoulder beside lanes that are shifted onto it.
SHOULDER_LEFT_M = 0.3
# From the inner edge of the closed area to a cone or barrel; these stand twice as close in tapers.
ASIDE_M, IN_TAPERS = 0.25, 0.5
# Barricades behind the taper: their distance from it and from cones, and the length of the road that each takes.
BEHIND_TAPER_M, FROM_CONES_M, BARRICADE_M, MOST_BARRICADES = 2.0, 0.3, 1.8, 2
# Steps along the road by which distances are measured.
ROW_STEP_M = 0.1


def with_works(road: PaperRoad, camera: HostCamera, draw: Draw) -> tuple[PaperRoad, HostCamera]:
    """The road with the works that are drawn, if it has room for them, and the host, whose lane stays open."""
    drawn = {key: draw(key) for key in type(draw.group).model_fields}
    if not drawn["present"] or road.topology != 1:
        return road, camera
    kinds = ("lane_closed", "lanes_shifted", "lanes_narrowed", "shoulder_closed")
    for kind in kinds[kinds.index(drawn["kind"]) :]:
        for inner in (True, False) if drawn["side"] == "inner" else (False, True):
            works = _of_kind(road, kind, inner, drawn, camera)
            if works is not None:
                found = PaperRoad.model_validate({**road.model_dump(), "works": works.model_dump()})
                return found, _numbered(found, camera)
    return road, camera


def _of_kind(road: PaperRoad, kind: str, inner: bool, drawn: dict[str, Any], camera: HostCamera) -> RoadWorks | None:
    """Road works of a kind; None where the road has no room for them."""
    closes, taken_m, shift_m = kind == "lane_closed", 0.0, 0.0
    start_m = round(camera.y_m + drawn["ahead_m"], SCENE_DECIMALS)
    length_m = max(drawn["length_m"], drawn["taper_m"] + drawn["end_taper_m"])
    lines = "yellow" if drawn["lines"] == "as_before" and not closes else drawn["lines"]
    if kind == "lane_closed":
        if road.n_lanes < 2 or camera.lane == closed_lane(road, inner):
            return None
        taken_m = 0.0 if lines == "as_before" else road.lane_width_m
    elif kind == "lanes_shifted":
        shift_m = min(drawn["moved_m"], road.shoulder_factor * road.lane_width_m - SHOULDER_LEFT_M)
        # Cars may use little of the shoulder in a median.
        if shift_m < LEAST_MOVE_M or (road.n_oncoming and not inner):
            return None
        taken_m = shift_m
    elif kind == "lanes_narrowed":
        taken_m = min(drawn["moved_m"], road.n_lanes * (road.lane_width_m - drawn["least_lane_m"]))
        if taken_m < LEAST_MOVE_M:
            return None
    else:
        lines = "as_before"
    works = RoadWorks(
        start_m=start_m,
        end_m=round(start_m + length_m, SCENE_DECIMALS),
        taper_m=drawn["taper_m"],
        end_taper_m=drawn["end_taper_m"],
        inner=inner,
        closes_lane=closes,
        taken_m=round(taken_m, SCENE_DECIMALS),
        shift_m=round(shift_m, SCENE_DECIMALS),
        lines=lines,
        line_width_m=drawn["line_width_m"],
        removed=drawn["removed"],
    )
    has_shoulder = WorksLanes(road, works).shoulder_m >= LEAST_SHOULDER_M or kind != "shoulder_closed"
    return None if (inner and road.is_divided_by_line) or not has_shoulder else works


def closed_lane(road: PaperRoad, inner: bool) -> int:
    """The number of the outermost lane on a side, counted from the host's left."""
    return road.n_lanes if inner == road.flip_longitudinal else 1


def _numbered(road: PaperRoad, camera: HostCamera) -> HostCamera:
    """The host in its lane: along works, lanes left of it may be missing."""
    works = road.works
    assert works is not None, "asked only of roads with works"
    is_along = works.start_m <= camera.y_m < works.end_m
    if works.closes_lane and is_along and closed_lane(road, works.inner) < camera.lane:
        return camera.model_copy(update={"lane": camera.lane - 1})
    return camera


def draw_devices(scene: Scene, ground: Ground, of: DrawsOf) -> Iterator[Thing]:
    """The cones or barrels along road works, and the barricades behind their front."""
    works, network, own = scene.roads.works, ground.network, of("works", "works_devices")
    if works is None:
        return
    lanes, road, kind, spacing_m = WorksLanes(scene.paper_road, works), network.main, own("devices"), own("spacing_m")
    models, has_barricade = scene.assets.thing_models(kind), own("barricade")
    number = 1 + int(own.rng.random() * len(models))
    aside_m = lanes.outward * (ASIDE_M + models[number - 1].width_m / 2)
    low_m, high_m = lanes.span_m
    s = np.linspace(low_m, high_m, 2 + int((high_m - low_m) / ROW_STEP_M))[:: int(network.onwards)]
    t = lanes.closed_from(s) + aside_m
    at = _spaced(lengths_along(road.xy(s, t)), lanes.share(s) < 1, spacing_m)
    yield from _things(road, s[at], t[at], kind, number, network.onwards)
    if has_barricade:
        yield from _barricades(scene, lanes, road, aside_m, network.onwards)


def _spaced(lengths_m: Scalars, in_taper: np.ndarray, spacing_m: float) -> np.ndarray:
    """Which points of a row have a device: the first, then each point that is at least a spacing behind the last
    device."""
    found = [0]
    needed_m = np.where(in_taper, IN_TAPERS, 1.0) * spacing_m
    while True:
        behind = np.flatnonzero(lengths_m - lengths_m[found[-1]] >= needed_m - 1e-9)
        if not len(behind):
            return np.array(found)
        found.append(int(behind[0]))


def _barricades(scene: Scene, lanes: WorksLanes, road: Road, aside_m: float, onwards: float) -> Iterator[Thing]:
    """The barricades that fit between the cones and the edge of the pavement."""
    works = lanes.works
    s = onwards * np.array([works.start_m + works.taper_m + BEHIND_TAPER_M])
    first_m = float(lanes.closed_from(s)[0]) + 2 * aside_m + lanes.outward * FROM_CONES_M
    room_m = lanes.outward * (lanes.pavement_m - first_m)
    count = min(int(room_m / BARRICADE_M), MOST_BARRICADES)
    t = first_m + lanes.outward * BARRICADE_M * (0.5 + np.arange(count))
    yield from _things(road, np.repeat(s, count), t, "barricade", 1, onwards)


def _things(road: Road, s: Scalars, t: Scalars, kind: ThingKind, model: int, onwards: float) -> Iterator[Thing]:
    """Things at places of a road that face the host's traffic."""
    steps = road.xy(s + onwards * ROW_STEP_M, t) - road.xy(s, t)
    yaws = np.arctan2(steps[:, 0], -steps[:, 1])
    for (x_m, y_m), yaw_rad in zip(road.xy(s, t).tolist(), yaws.tolist(), strict=True):
        place = {
            name: round(value, SCENE_DECIMALS) for name, value in (("x_m", x_m), ("y_m", y_m), ("yaw_rad", yaw_rad))
        }
        yield Thing(kind=kind, model=model, **place)
