"""Scene: the full description of one world, and its JSON form (`scene.json`, docs/format.md).

World frame, metres and radians. Pure data: nothing here reads files or computes geometry. Fields with a default were
added later; older scenes can still be read and render as before. A field that is added now is left out where it has its
default, so that scenes of equal recipes keep their bytes.
"""

import math
import operator
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from synth3dlanes.scene.assets.catalogue import AssetKind, Assets
from synth3dlanes.scene.host import Bonnet, DrivenTrack, HostCamera, Lidar, Seconds, Shot
from synth3dlanes.scene.instance_ids import most_of
from synth3dlanes.scene.road_map import LaneName, MapJunction, MapPaint, RoadMap, Station
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.settings import JPEG_QUALITY, N_SCENE_NUMBERS
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.scene.town import Town
from synth3dlanes.scene.works import RoadWorks
from synth3dlanes.system.schema import (
    Color,
    DocumentPart,
    Metres,
    Name,
    Number,
    Positive,
    Seed,
    SymbolKind,
    Unit,
    is_empty,
    is_none,
    parse,
)
from synth3dlanes.system.streams import stream

SCENE_VERSION = 1
# The most models, textures or skies of one kind.
MAX_ASSETS = 9999
# A narrower median has no room for an edge line at each side, and no car fits into a narrower lane along road works.
MIN_MEDIAN_M, MIN_OPEN_M = 1.0, 2.2
MAX_SYMBOLS, MAX_THINGS = most_of("symbol"), most_of("thing")
# The most paints of a model of a thing.
MAX_PAINTS = 8
# The most rows and columns of a grid of heights.
MAX_GRID = 200
# The most lanes that messages name.
MOST_NAMED = 12
AssetNumber = Annotated[int, Field(ge=1, le=MAX_ASSETS)]


class Gaussian(DocumentPart):
    """One hill or hollow of the terrain (paper, Appendix I, Table 'Terrain 3D')."""

    center_m: tuple[Number, Number]
    magnitude_m: Metres
    sd_m: tuple[Positive, Positive]
    orientation_rad: Number


class HeightGrid(DocumentPart):
    """Smooth heights, by a bicubic B-spline: its coefficients (metres) in rows along x, the rows as y grows, `step_m`
    apart from `corner_m` on; beyond its outer coefficients it is constant."""

    corner_m: tuple[Number, Number]
    step_m: Annotated[float, Field(ge=1, le=1000)]
    rows: Annotated[
        tuple[Annotated[tuple[Number, ...], Field(min_length=8, max_length=MAX_GRID)], ...],
        Field(min_length=8, max_length=MAX_GRID),
    ]

    @cached_property
    def coefficients(self) -> Float[np.ndarray, "rows columns"]:
        """The rows as an array."""
        return np.array(self.rows)

    @model_validator(mode="after")
    def _is_rectangle(self) -> "HeightGrid":
        """Check that all rows are as long."""
        if len({len(row) for row in self.rows}) > 1:
            raise ValueError("rows: expected rows of one length")
        return self


class Terrain(DocumentPart):
    """A sum of Gaussians; of a given map with heights, over a ground that meets these."""

    gaussians: Annotated[tuple[Gaussian, ...], Field(max_length=100)]
    base: Annotated[HeightGrid | None, Field(exclude_if=is_none)] = None


class PaperRoad(DocumentPart):
    """Top view and ramp of the main road and its exit (Appendix I, Tables 'Topology' to 'Lane 3D').

    `n_oncoming` lanes of traffic the other way lie on the side opposite the exit, beyond a median of `median_m` between
    the edge lines, or without one beyond one line that divides the traffic (`divider_dashed` or solid). A road without
    exit may have road works.
    """

    topology: Annotated[int, Field(ge=1, le=4)]
    flip_longitudinal: bool
    flip_lateral: bool
    n_lanes: Annotated[int, Field(ge=1, le=8)]
    lane_width_m: Annotated[float, Field(gt=0, le=1000)]
    shoulder_factor: Annotated[float, Field(ge=0, le=1000)]
    offset_m100_m: Metres
    offset_m50_m: Metres
    offset_p50_m: Metres
    offset_p100_m: Metres
    exit_angle_rad: Annotated[float, Field(ge=0, lt=0.5)]
    exit_offset_m: Annotated[float, Field(ge=0, le=1000)]
    ramp_height_m: Annotated[float, Field(ge=0, le=1000)]
    ramp_slope: Positive
    n_oncoming: Annotated[int, Field(ge=0, le=8)] = 0
    median_m: Annotated[float, Field(ge=0, le=100)] = 0.0
    divider_dashed: bool = False
    works: Annotated[RoadWorks | None, Field(exclude_if=is_none)] = None
    # Only maps have these.
    source: ClassVar[str] = ""
    digest: ClassVar[str] = "none"
    paint: ClassVar[tuple[MapPaint, ...]] = ()
    junctions: ClassVar[tuple[MapJunction, ...]] = ()
    location: ClassVar[Literal["urban", "nonurban"]] = "nonurban"
    sides_are_hosts: ClassVar[bool] = True

    @model_validator(mode="after")
    def _has_room(self) -> "PaperRoad":
        """Check that there are enough lanes for the topology, that the exit opens, and room for the median."""
        if self.n_lanes < 2 and self.topology > 2:
            raise ValueError(f"n_lanes: expected at least 2 with topology {self.topology}, got {self.n_lanes}")
        if self.topology > 1 and self.exit_angle_rad == self.exit_offset_m == 0:
            raise ValueError(
                "exit_angle_rad: expected more than 0 where exit_offset_m is 0: the exit must leave the road"
            )
        if 0 < self.median_m < MIN_MEDIAN_M:
            raise ValueError(f"median_m: expected 0 or at least {MIN_MEDIAN_M:g}, got {self.median_m:g}")
        return self

    @model_validator(mode="after")
    def _has_room_for_works(self) -> "PaperRoad":
        """Check that the road has no exit beside works, and lanes, an edge and a shoulder that may move."""
        works = self.works
        if works is None:
            return self
        if self.topology != 1:
            raise ValueError(f"works: expected none on a road with an exit, got some with topology {self.topology}")
        n_open = self.n_lanes - works.closes_lane
        room_m = self.n_lanes * self.lane_width_m + works.shift_m - works.taken_m
        if not n_open or n_open * MIN_OPEN_M > room_m:
            raise ValueError(
                f"works: expected open lanes, each of {MIN_OPEN_M:g} m or more, got {n_open} in {room_m:.1f} m"
            )
        if self.is_divided_by_line and (works.inner or works.shift_m):
            raise ValueError(
                "works: expected the line between both directions to stay in place, got works that move it"
            )
        shoulder_m = self.shoulder_factor * self.lane_width_m
        if works.shift_m > shoulder_m:
            raise ValueError(f"works.shift_m: expected at most the shoulder's {shoulder_m:g} m, got {works.shift_m:g}")
        return self

    @property
    def junction_kind(self) -> str:
        """Where its exit is, as the host sees it: a split, a merge, or none."""
        return "none" if self.topology == 1 else "merge" if self.flip_lateral else "split"

    @property
    def exit_side(self) -> str:
        """The side of its exit as the host sees it."""
        return "none" if self.topology == 1 else "left" if self.flip_longitudinal else "right"

    @property
    def words(self) -> str:
        """Its topology as the host sees it: "merge from the left, two-lane exit"."""
        if self.topology == 1:
            return "one road, no exit"
        split, merge = {
            2: (
                "one-lane exit, its lane also stays on the main road",
                "one-lane exit, it joins the main road's outer lane",
            ),
            3: ("one-lane exit, the main road opens a new lane", "one-lane exit, the main road loses a lane"),
            4: (
                "two-lane exit, the main road keeps one of the two lanes",
                "two-lane exit, one of its lanes joins the main road's",
            ),
        }[self.topology]
        return (
            f"merge from the {self.exit_side}, {merge}"
            if self.flip_lateral
            else f"split to the {self.exit_side}, {split}"
        )

    @property
    def facts(self) -> dict[str, str]:
        """What a summary says of the road."""
        facts = {
            "topology": f"{self.topology}: {self.words}",
            "lanes": f"{self.n_lanes}, each {self.lane_width_m:.2f} m wide",
            "shoulder": f"{self.shoulder_factor * self.lane_width_m:.2f} m",
        }
        if self.n_oncoming:
            between = f"beyond a median of {self.median_m:.1f} m" if self.median_m else "without a median"
            facts["oncoming lanes"] = f"{self.n_oncoming}, {between}"
        if self.works is not None:
            facts["road works"] = self.works.words
        if self.topology > 1:
            angle, bend = f"{math.degrees(self.exit_angle_rad):.1f}°", f"{self.exit_offset_m:.1f} m of bend over 60 m"
            facts["exit"] = f"leaves at {angle}, {bend}"
            facts["ramp"] = f"{self.ramp_height_m:.1f} m high over {self.ramp_height_m * self.ramp_slope:.1f} m"
        return facts

    def boundary_m(self, j: int) -> float:
        """Offset in the plan of lane boundary j = 0..n of the host's lanes before the split, without road works."""
        return (j - self.n_lanes / 2) * self.lane_width_m

    @property
    def is_divided_by_line(self) -> bool:
        """Whether one line divides the host's lanes from oncoming ones."""
        return self.n_oncoming > 0 and self.median_m == 0

    @property
    def n_exit_lanes(self) -> int:
        """Lanes of the exit (Appendix I, Table 'Road and lane topology')."""
        return {1: 0, 2: 1, 3: 1, 4: 2}[self.topology]

    @property
    def n_main_after(self) -> int:
        """Main lanes behind the split (before the merge)."""
        return self.n_lanes - 1 if self.topology == 4 else self.n_lanes

    def segments_at(self, s_m: float) -> tuple[str, ...]:
        """The ids of the host's lane segments at a world station, from the left, the main road's first."""
        if self.works is not None and s_m >= self.works.start_m:
            is_past = s_m >= self.works.end_m
            n_lanes = self.n_lanes if is_past else self.n_lanes - self.works.closes_lane
            return tuple(f"{'after' if is_past else 'works'}_{lane}" for lane in range(1, n_lanes + 1))
        if self.topology > 1 and (-s_m if self.flip_lateral else s_m) < 0:
            return tuple(f"stem_{lane}" for lane in range(1, self.n_lanes + 1))
        main = (f"main_{lane}" for lane in range(1, self.n_main_after + 1))
        return (*main, *(f"exit_{lane}" for lane in range(1, self.n_exit_lanes + 1)))

    @property
    def segments(self) -> tuple[str, ...]:
        """The ids of all lane segments."""
        stations_m = (-1.0, 1.0) if self.works is None else (-np.inf, self.works.start_m, self.works.end_m)
        ends = (name for s_m in stations_m for name in self.segments_at(s_m))
        return tuple(dict.fromkeys((*ends, *self.oncoming_segments)))

    @property
    def driving_lanes(self) -> frozenset[str]:
        """The names of the lanes of traffic, which are its segments."""
        return frozenset(self.segments)

    @property
    def oncoming_segments(self) -> tuple[str, ...]:
        """The ids of the lane segments of oncoming traffic, from the host's left."""
        return tuple(f"oncoming_{lane}" for lane in range(1, self.n_oncoming + 1))

    def lanes_present(self, s_m: float) -> int:
        """Number of the main road's lanes in the host's direction at a world station."""
        return sum(not segment.startswith("exit") for segment in self.segments_at(s_m))


class Markings(DocumentPart):
    """Paint: `dash_fraction` is the painted share of `dash_cycle_m`, `wear` the share of paint that is rubbed off,
    `missing` the share of each line's length without paint, in stretches. `left_yellow` and `left_double` (two stripes
    of `width_m`, `width_m` apart) apply to the leftmost line as the host drives. `left_pair` says which of two stripes,
    from the left, is solid and which has the dashes of a dashed line; with `same` both are solid. With `dots`, dashed
    lines, but no stripes of a pair, consist of Botts' dots instead: raised discs 10 cm across, four to a dash."""

    dash_cycle_m: Annotated[float, Field(ge=0.001, le=1000)]
    dash_fraction: Annotated[float, Field(gt=0, le=1)]
    width_m: Positive
    grayscale: Unit
    gloss: Unit
    left_yellow: bool = False
    left_double: bool = False
    wear: Unit = 0.0
    missing: Unit = 0.0
    dots: bool = False
    left_pair: Literal["same", "solid_dashed", "dashed_solid"] = "same"


class Surface(DocumentPart):
    """Textures of road and terrain, numbered from 1. `wetness` of the pavement is from 0 (dry) to 1 (under water).
    Three values describe what is visible on the pavement but is no paint: `tar` is the amount of cracks filled with
    bitumen, from 0 (none) to 1 (a net of them); `joint` is the contrast between old and new asphalt beside each other;
    `ghost_lines` is the contrast of removed paint."""

    road_texture: AssetNumber
    road_texture_scale: Positive
    road_gloss: Unit
    terrain_texture: AssetNumber
    terrain_texture_scale: Positive
    texture_orientation_rad: Number
    wetness: Unit = 0.0
    shoulder_texture: Annotated[int, Field(ge=1, le=2)] = 1
    tar: Unit = 0.0
    joint: Unit = 0.0
    ghost_lines: Unit = 0.0


class Symbol(DocumentPart):
    """Paint that bounds no lane. The middle of an arrow is on the centre of lane segment `lane` at station `s_m`. Stop
    lines (`lane` is None) cross the lanes of the main road there, crosswalks also the oncoming ones. The hatching of a
    gore fills the area between main road and exit from station `s_m` to where the ramp begins."""

    kind: SymbolKind
    lane: Name | None
    s_m: Metres


class Car(DocumentPart):
    """A car in lane segment `lane` (its id in the lane graph) at station `s_m` (world y on the main reference line; of
    a map the lane's road's own), heading as the lane does, `offset_m` to its driver's right of the lane's centre:
    parked cars stand on a shoulder. This is its place at the start of a clip, through which it keeps its lane and
    speed. Models are numbered from 1. `saturation` mixes the body's colour (1) with the gray of its first channel (0).

    On a map it drives through the lanes of `route` behind its own. `track` are instants (seconds of the clip) and the
    lengths that it has driven then; without them it keeps its speed, which is otherwise that at the clip's start."""

    model: AssetNumber
    scale: Positive
    color: Color
    gloss: Unit
    lane: Name
    s_m: Station
    saturation: Unit = 1.0
    offset_m: Metres = 0.0
    speed_m_s: Annotated[float, Field(ge=0, le=100)] = 0.0
    route: Annotated[tuple[LaneName, ...], Field(max_length=1000, exclude_if=is_empty)] = ()
    track: DrivenTrack = ()


class Tree(DocumentPart):
    """A tree at a world position off the roads. Models are numbered from 1."""

    model: AssetNumber
    x_m: Number
    y_m: Number
    yaw_rad: Number
    scale: Positive


class PlanInstant(DocumentPart):
    """Where a thing is at a time of a clip, in the world's plan, and where it faces."""

    time_s: Seconds
    x_m: Number
    y_m: Number
    yaw_rad: Number


class Thing(DocumentPart):
    """A person, a rider or a piece of road works, upright at a world position `above_m` over the ground, at the start
    of a clip. `yaw_rad` is where it faces, counter-clockwise from world y. Models are numbered from 1 in the catalogue
    of the kind; `colors` has a colour for each paint of the model, `phase` is the phase of its steps, pedals or wheels.
    In a clip it follows `track`, smoothly from instant to instant, and stands still before and after it; without a
    track it goes straight ahead at `speed_m_s`. With a track, `speed_m_s` is its speed at the clip's start."""

    kind: ThingKind
    model: AssetNumber
    x_m: Number
    y_m: Number
    yaw_rad: Number
    above_m: Metres = 0.0
    scale: Positive = 1.0
    colors: Annotated[tuple[Color, ...], Field(max_length=MAX_PAINTS)] = ()
    phase: Unit = 0.0
    speed_m_s: Annotated[float, Field(ge=0, le=100)] = 0.0
    track: Annotated[tuple[PlanInstant, ...], Field(max_length=10_000, exclude_if=is_empty)] = ()

    @model_validator(mode="after")
    def _goes_on(self) -> "Thing":
        """Check that the instants of the track are in order."""
        for instant, following in pairwise(self.track):
            if following.time_s <= instant.time_s:
                raise ValueError(f"track: expected instants in order, got {following.time_s:g} s")
        return self


class Vegetation(DocumentPart):
    """The share of light that leaves let through, relative to real leaves, and the height in metres of the grass beside
    the road near the host."""

    translucency: Unit = 0.0
    grass_m: Annotated[float, Field(ge=0, le=1)] = 0.0


class Light(DocumentPart):
    """The sun, its azimuth counter-clockwise from world x, its zenith beyond pi/2 at night; the exposure factor; and
    `metering`, the exponent with which the exposure compensates for the scene's daylight (0 not at all, 1 fully)."""

    sun_zenith_rad: Annotated[float, Field(ge=0, le=2.0)]
    sun_azimuth_rad: Number
    exposure: Positive
    metering: Unit = 0.0


class Air(DocumentPart):
    """The meteorological visibility, which is the distance where 2 % of the contrast is left, and the share of the sun
    that clouds hide."""

    visibility_m: Positive = 1e6
    overcast: Unit = 0.0


class Sensor(DocumentPart):
    """Metres driven during the exposure; the standard deviation of the noise at middle gray, in 8-bit levels; lens
    flare, dirt and drops of water on the glass, each from 0 to 1; the quality of JPEG images; and the share of light
    that the image's corners lack."""

    motion_blur_m: Annotated[float, Field(ge=0, le=1000)] = 0.0
    noise: Annotated[float, Field(ge=0, le=1000)] = 0.0
    flare: Unit = 0.0
    dirt: Unit = 0.0
    drops: Unit = 0.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = JPEG_QUALITY
    vignette: Annotated[Unit, Field(exclude_if=operator.not_)] = 0.0


class Weather(DocumentPart):
    """The weather and the time of day that the scene was drawn for ("any" for none), and their effects: `rain` and
    `snowfall` in the air, from 0 to 1; the share of the terrain, and of the road, that snow covers (wheel tracks stay
    clear longest); `headlights` of the host and of all cars."""

    kind: Literal["any", "clear", "cloudy", "fog", "rain", "snow"] = "any"
    daytime: Literal["any", "day", "dusk", "night"] = "any"
    rain: Unit = 0.0
    snowfall: Unit = 0.0
    snow: Unit = 0.0
    snow_on_road: Unit = 0.0
    headlights: bool = False


class Scene(DocumentPart):
    """One picture of one world. `(seed, split, index)` identify the random draw of the world. `sky` is 0 for the
    built-in sky, or the number of a user's sky, counted from 1. Its roads are either `road`, the paper's model, or
    `map`; `town` has the values that a town's map was drawn from."""

    format: Literal["synth3dlanes.scene"]
    version: Literal[1]
    seed: Seed
    split: Annotated[str, Field(max_length=200)]
    index: Annotated[int, Field(ge=0, lt=N_SCENE_NUMBERS)]
    terrain: Terrain
    road: PaperRoad | None
    markings: Markings
    surface: Surface
    cars: Annotated[tuple[Car, ...], Field(max_length=1000)]
    trees: Annotated[tuple[Tree, ...], Field(max_length=10_000)]
    camera: HostCamera
    light: Light
    air: Air = Air()
    sensor: Sensor = Sensor()
    weather: Weather = Weather()
    host: Bonnet = Bonnet()
    sky: Annotated[int, Field(ge=0, le=MAX_ASSETS)] = 0
    assets: Assets = Assets()
    symbols: Annotated[tuple[Symbol, ...], Field(max_length=MAX_SYMBOLS)] = ()
    vegetation: Vegetation = Vegetation()
    roadside: Roadside = Roadside()
    shot: Shot = Shot()
    lidar: Lidar | None = None
    map: Annotated[RoadMap | None, Field(exclude_if=is_none)] = None
    town: Annotated[Town | None, Field(exclude_if=is_none)] = None
    things: Annotated[tuple[Thing, ...], Field(max_length=MAX_THINGS, exclude_if=is_empty)] = ()

    def stream(self, name: str) -> np.random.Generator:
        """Random numbers for details of the world that the scene does not store, such as `clouds`."""
        return stream(self.seed, self.split, self.index, name)

    def picture_stream(self, name: str) -> np.random.Generator:
        """Random numbers for what differs between the pictures of one world, such as `sensor_noise`."""
        frame, camera = self.shot.frame, self.shot.camera
        return self.stream(self._of_view(f"{name}/{frame}/{camera}" if frame or camera else name))

    def glass_stream(self, name: str) -> np.random.Generator:
        """Random numbers for what differs between cameras but not between frames, such as `dirt`."""
        return self.stream(self._of_view(f"{name}/{self.shot.camera}" if self.shot.camera else name))

    def _of_view(self, name: str) -> str:
        return f"{name}/view/{self.shot.view}" if self.shot.view else name

    @property
    def has_traffic(self) -> bool:
        """Whether cars have speeds of their own: in clips, and in single pictures where traffic was simulated."""
        return self.shot.n_frames > 1 or self.town is not None

    @property
    def start(self) -> HostCamera:
        """The camera around which the world is built: the host's own, or the camera of its first view."""
        views = self.shot.views
        if views is None:
            return self.camera
        return self.camera.model_copy(update={"lane": views.lane, "y_m": views.y_m, "offset_m": views.offset_m})

    @model_validator(mode="after")
    def _has_its_models(self) -> "Scene":
        """Check that all model, texture and sky numbers exist."""
        used: list[tuple[str, AssetKind, int]] = [
            *((f"cars.{i}.model", "cars", car.model) for i, car in enumerate(self.cars)),
            *((f"trees.{i}.model", "trees", tree.model) for i, tree in enumerate(self.trees)),
            ("surface.road_texture", "roads", self.surface.road_texture),
            ("surface.terrain_texture", "terrains", self.surface.terrain_texture),
            ("sky", "skies", self.sky),
        ]
        for path, kind, number in used:
            if number > self.assets.count(kind):
                raise ValueError(f"{path}: expected at most {self.assets.count(kind)}, got {number}")
        for i, thing in enumerate(self.things):
            models = self.assets.thing_models(thing.kind)
            if thing.model > len(models):
                raise ValueError(f"things.{i}.model: expected at most {len(models)}, got {thing.model}")
            paints = models[thing.model - 1].paints
            if len(thing.colors) != len(paints):
                wanted = f"{len(paints)} ({', '.join(paints) or 'none'})"
                raise ValueError(f"things.{i}.colors: expected {wanted}, got {len(thing.colors)}")
        return self

    @property
    def roads(self) -> PaperRoad | RoadMap:
        """What says where its roads are."""
        return self.map or self.paper_road

    @property
    def paper_road(self) -> PaperRoad:
        """The scene's road in the paper's model."""
        assert self.road is not None, "asked only of scenes without a map"
        return self.road

    @model_validator(mode="after")
    def _has_roads(self) -> "Scene":
        """Check that the roads are given once."""
        if (self.road is None) == (self.map is None):
            raise ValueError("road: expected either a road or a map")
        return self

    @model_validator(mode="after")
    def _governs_its_lanes(self) -> "Scene":
        """Check that the lanes that signals and signs govern exist."""
        beside = self.roadside
        segments = self.roads.driving_lanes
        some = ", ".join(sorted(segments)[:MOST_NAMED])
        governed = [
            *((f"roadside.signals.{i}.lanes", item.lanes) for i, item in enumerate(beside.signals)),
            *((f"roadside.signs.{i}.lanes", item.lanes) for i, item in enumerate(beside.signs)),
            *(
                (f"roadside.crossings.{i}.signals", tuple(signal.lane for signal in item.signals))
                for i, item in enumerate(beside.crossings)
            ),
        ]
        for path, lanes in governed:
            for lane in lanes:
                if lane not in segments:
                    raise ValueError(f"{path}: expected lanes such as {some}, got {lane}")
        return self

    @model_validator(mode="after")
    def _has_its_lanes(self) -> "Scene":
        """Check that the lanes of host and cars exist at their stations."""
        for part, problem_of in PROBLEMS.items():
            own = getattr(self, part)
            if own is not None and (problem := problem_of(self, own)):
                raise ValueError(problem)
        return self


def _road_problem(scene: Scene, road: PaperRoad) -> str:
    """What is missing on the paper's road; "" if nothing is."""
    present = road.lanes_present(scene.camera.y_m)
    if scene.camera.lane > present:
        return f"camera.lane: expected at most {present} at y_m = {scene.camera.y_m:g}, got {scene.camera.lane}"
    for kind in ("rails", "posts"):
        for i, item in enumerate(getattr(scene.roadside, kind)):
            if item.road not in ("main", "exit"):
                return f"roadside.{kind}.{i}.road: expected main or exit, got {item.road}"
            if item.road == "exit" and (road.topology == 1 or item.side == "median"):
                return f"roadside.{kind}.{i}: expected a side of a road that is there, got its exit's"
    for i, car in enumerate(scene.cars):
        lanes = (*road.segments_at(car.s_m), *road.oncoming_segments)
        if car.lane not in lanes:
            return f"cars.{i}.lane: expected one of {', '.join(lanes)} at s_m = {car.s_m:g}, got {car.lane}"
        if car.route or car.track:
            return f"cars.{i}.route: expected none without a map, got one"
    for i, symbol in enumerate(scene.symbols):
        named = road.segments_at(symbol.s_m) if symbol.kind.startswith("arrow") else (None,)
        if symbol.lane not in named:
            wanted = ", ".join(lane or "null" for lane in named)
            return f"symbols.{i}.lane: expected one of {wanted}, got {symbol.lane or 'null'}"
        if symbol.kind == "give_way_line":
            return f"symbols.{i}.kind: expected no give_way_line, which only maps have, got one"
        if symbol.kind == "gore" and road.topology == 1:
            return f"symbols.{i}.kind: expected a road with an exit for a gore, got topology 1"
    return ""


def _map_problem(scene: Scene, roads: RoadMap) -> str:
    """What is missing on the map; "" if nothing is."""
    if scene.camera.lane != 1:
        return f"camera.lane: expected 1 on a map, got {scene.camera.lane}"
    if scene.symbols:
        return f"symbols: expected none beside a map, whose paint they are, got {len(scene.symbols)}"
    for kind in ("rails", "posts"):
        for i, item in enumerate(getattr(scene.roadside, kind)):
            if item.road not in roads.road_ids:
                return f"roadside.{kind}.{i}.road: expected a road of the map, got {item.road}"
    for i, car in enumerate(scene.cars):
        for name in (car.lane, *car.route):
            if name not in roads.driving_lanes:
                return f"cars.{i}.lane: expected driving lanes of the map, got {name}"
        for pair in pairwise((car.lane, *car.route)):
            if pair not in roads.all_links:
                return f"cars.{i}.route: expected linked lanes, got {pair[0]} and {pair[1]}"
    return ""


# What is missing, by the part of a scene that misses it.
PROBLEMS: dict[str, Callable[[Scene, Any], str]] = {"road": _road_problem, "map": _map_problem}


def to_json(scene: Scene) -> str:
    """The scene as one line of JSON; equal scenes give equal text."""
    return scene.model_dump_json()


def from_json(text: str | bytes, where: str) -> Scene:
    """Parse `scene.json`; raise FormatError with one line per problem, each beginning with `where`."""
    return parse(Scene, text, where, f"synth3dlanes.scene version {SCENE_VERSION}")
