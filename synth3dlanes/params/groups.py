"""The groups of parameters: the distribution of each, with its legal values.

Metres and degrees. No side effects.
"""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainValidator

from synth3dlanes.params.distributions import (
    Choice,
    Flag,
    Integer,
    Integers,
    Named,
    Real,
    Uniform,
    integers,
    is_pair,
    names,
    parse_integers,
    reals,
)
from synth3dlanes.scene.assets.catalogue import AssetKind, Assets
from synth3dlanes.scene.settings import JPEG_QUALITY

Fraction = Annotated[Real, reals(0, 1)]
Orientation = Annotated[Real, reals(-360, 360)]
OffsetRange = Annotated[Real, reals(-50, 50)]
Visibility = Annotated[Real, reals(20, 1_000_000)]
SunZenith = Annotated[Real, reals(0, 110)]
Exposure = Annotated[Real, reals(0, 100, above=True)]
MotionBlur = Annotated[Real, reals(0, 1)]
NoiseLevel = Annotated[Real, reals(0, 32)]
# The largest number of a model or texture if the assets are unknown.
MAX_NUMBER = 9999
# Kinds of weather and times of day. Each is a group of the parameters that it replaces.
KINDS = ("clear", "cloudy", "fog", "rain", "snow")
DAYTIMES = ("day", "dusk", "night")
# The keys that these groups replace, by their own names.
REPLACED = {
    "visibility_m": "air.visibility_m",
    "overcast": "air.overcast",
    "wetness": "surface.wetness",
    "rain": "weather.rain",
    "snowfall": "weather.snowfall",
    "snow": "weather.snow",
    "snow_on_road": "weather.snow_on_road",
    "drops": "sensor.drops",
    "sun_zenith_deg": "light.sun_zenith_deg",
    "metering": "light.metering",
    "exposure": "light.exposure",
    "noise": "sensor.noise",
    "motion_blur_m": "sensor.motion_blur_m",
    "flare": "sensor.flare",
    "headlights": "weather.headlights",
}
# Groups that were added later; parameters without them have their defaults, or the values of the reference.
OPTIONAL: tuple[str, ...] = (
    *("symbols", "weather", "host", "vegetation", "roadside", "motion", "town", "mountain"),
    *(*KINDS, *DAYTIMES, "structures", "town_streets", "people", "riders", "works"),
)
# Groups whose values stand in the reference alone.
IN_REFERENCE = (*KINDS, *DAYTIMES, "structures", "town_streets")


def numbers(kind: AssetKind) -> PlainValidator:
    """The legal numbers of models or textures of one kind: the numbers in the `Assets` of the validation's context. A
    range or weights over all built-in models, as in the presets, mean all models of a user's own folder. Without a
    context, as in `dataset.json`, any number is legal."""
    return PlainValidator(lambda read, info: _parse_numbers(read, kind, info.context))


def _parse_numbers(read: Any, kind: AssetKind, assets: Assets | None) -> Integers | Choice[int]:
    if assets is not None and assets.own(kind) and _is_whole(read, kind):
        return Integers(1, assets.count(kind))
    return parse_integers(read, 1, assets.count(kind) if assets else MAX_NUMBER)


def _is_whole(read: Any, kind: AssetKind) -> bool:
    numbers = sorted(read) if isinstance(read, dict) and all(isinstance(key, int) for key in read) else []
    return any(
        numbers == list(range(1, last + 1)) or (is_pair(read) and list(read) == [1, last])
        for last in Assets.WHOLE[kind]
    )


def left_out_at(default: Any) -> Any:
    """A field that may be left out; `dataset.json` leaves it out if it has this value."""
    return Field(default=default, exclude_if=lambda value: value == default)


def added(default: Any) -> Any:
    """A field that a later version added. Parameters without it have this constant."""
    return left_out_at(Choice((default,), (1.0,)))


class Group(BaseModel):
    """A frozen group of parameters; keys without a default are required, unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class TerrainParams(Group):
    """Terrain 3D. `center_m` and `sd_m` are drawn once for x and once for y."""

    n_gaussians: Annotated[Integer, integers(0, 50)]
    center_m: Annotated[Real, reals(-1000, 1000)]
    magnitude_m: Annotated[Real, reals(-200, 200)]
    sd_m: Annotated[Real, reals(1, 10000)]
    orientation_deg: Orientation


class RoadParams(Group):
    """Topology, top view and ramp, and the oncoming lanes. Topologies 3 and 4 need two lanes, so they have at least
    two. A `median_m` below 1 counts as none. Oncoming lanes are left out where a bend is too sharp for them."""

    topology: Annotated[Integer, integers(1, 4)]
    flip_longitudinal: Flag
    flip_lateral: Flag
    n_lanes: Annotated[Integer, integers(1, 8)]
    lane_width_m: Annotated[Real, reals(2, 6)]
    shoulder_factor: Annotated[Real, reals(0, 2)]
    offset_m100_m: OffsetRange
    offset_m50_m: OffsetRange
    offset_p50_m: OffsetRange
    offset_p100_m: OffsetRange
    exit_angle_deg: Annotated[Real, reals(0, 15, above=True)]
    exit_offset_m: Annotated[Real, reals(0, 50)]
    ramp_height_m: Annotated[Real, reals(0, 20)]
    ramp_slope: Annotated[Real, reals(0, 200, above=True)]
    n_oncoming: Annotated[Integer, integers(0, 4)] = added(0)
    median_m: Annotated[Real, reals(0, 30)] = added(0.0)
    divider_dashed: Flag = added(False)


class MarkingsParams(Group):
    """Paint."""

    dash_cycle_m: Annotated[Real, reals(0.1, 50)]
    dash_fraction: Annotated[Real, reals(0, 1, above=True)]
    width_m: Annotated[Real, reals(0.02, 1)]
    grayscale: Fraction
    gloss: Fraction
    left_yellow: Flag
    left_double: Flag
    wear: Fraction
    missing: Fraction
    dots: Flag = added(False)
    left_pair: Annotated[Named, names("same", "solid_dashed", "dashed_solid")] = added("same")


class SurfaceParams(Group):
    """Textures of road and terrain."""

    road_texture: Annotated[Integer, numbers("roads")]
    road_texture_scale: Annotated[Real, reals(0, 1000, above=True)]
    road_gloss: Fraction
    terrain_texture: Annotated[Integer, numbers("terrains")]
    terrain_texture_scale: Annotated[Real, reals(0, 1000, above=True)]
    texture_orientation_deg: Orientation
    wetness: Fraction
    shoulder_texture: Annotated[Integer, integers(1, 2)]
    tar: Fraction = added(0.0)
    joint: Fraction = added(0.0)
    ghost_lines: Fraction = added(0.0)


class SymbolParams(Group):
    """Paint that bounds no lane. Symbols for which there is no room are left out."""

    arrow_rows: Annotated[Integer, integers(0, 20)] = added(0)
    stop_lines: Annotated[Integer, integers(0, 10)] = added(0)
    crosswalks: Annotated[Integer, integers(0, 10)] = added(0)
    gore: Flag = added(False)
    s_m: Annotated[Real, reals(-150, 150)] = Uniform(-100.0, 100.0)


class CarParams(Group):
    """Cars. `color` is drawn once per channel, `saturation` and `parked` once per car. With `palette` sold, `color` and
    `saturation` are ignored: cars have the colours of new cars, trucks and buses have liveries."""

    n: Annotated[Integer, integers(0, 100)]
    model: Annotated[Integer, numbers("cars")]
    scale: Annotated[Real, reals(0.1, 10)]
    color: Fraction
    saturation: Fraction
    gloss: Fraction
    s_m: Annotated[Real, reals(-150, 150)]
    parked: Fraction = added(0.0)
    palette: Annotated[Named, names("rgb", "sold")] = added("rgb")


class TreeParams(Group):
    """Trees."""

    n: Annotated[Integer, integers(0, 5000)]
    model: Annotated[Integer, numbers("trees")]
    scale: Annotated[Real, reals(0.1, 10)]
    yaw_deg: Orientation
    x_m: Annotated[Real, reals(-1000, 1000)]
    y_m: Annotated[Real, reals(-1000, 1000)]


class VegetationParams(Group):
    """Leaves and grass."""

    translucency: Fraction = added(0.0)
    grass_m: Annotated[Real, reals(0, 1)] = added(0.0)


class CameraParams(Group):
    """The host's camera. The range of `lane` is cut to the lanes that exist before the draw. `principal_offset_px` is
    drawn once for x and once for y."""

    lane: Annotated[Integer, integers(1, 8)]
    y_m: Annotated[Real, reals(-100, 0)]
    offset_m: Annotated[Real, reals(-2, 2)]
    height_m: Annotated[Real, reals(0.3, 10)]
    pitch_deg: Annotated[Real, reals(-30, 60)]
    width_px: Annotated[Integer, integers(16, 8192)]
    height_px: Annotated[Integer, integers(16, 8192)]
    horizontal_fov_deg: Annotated[Real, reals(5, 150)]
    roll_deg: Annotated[Real, reals(-30, 30)]
    principal_offset_px: Annotated[Real, reals(-1000, 1000)]


class LightParams(Group):
    """Sun and film exposure. `metering` says how far the exposure compensates for the scene's daylight, from 0 to 1."""

    sun_zenith_deg: SunZenith
    sun_azimuth_deg: Orientation
    exposure: Exposure
    metering: Fraction


class AirParams(Group):
    """Haze or fog, by its meteorological visibility, and the share of the sun that a closed layer of clouds hides."""

    visibility_m: Visibility
    overcast: Fraction


class SensorParams(Group):
    """Metres driven during the exposure, noise at middle gray in 8-bit levels (standard deviation), flare, dirt and
    drops on the glass, the quality of JPEG images, and the light that the corners lack."""

    motion_blur_m: MotionBlur
    noise: NoiseLevel
    flare: Fraction = added(0.0)
    dirt: Fraction = added(0.0)
    drops: Fraction = added(0.0)
    jpeg_quality: Annotated[Integer, integers(1, 100)] = added(JPEG_QUALITY)
    vignette: Fraction = added(0.0)


class WeatherParams(Group):
    """Weather and time of day. A `kind` or `daytime` other than any replaces the distributions of other keys by those
    of the group of its name."""

    kind: Annotated[Named, names("any", *KINDS)] = added("any")
    daytime: Annotated[Named, names("any", *DAYTIMES)] = added("any")
    rain: Fraction = added(0.0)
    snowfall: Fraction = added(0.0)
    snow: Fraction = added(0.0)
    snow_on_road: Fraction = added(0.0)
    headlights: Flag = added(False)


class DryParams(Group):
    """What clear, cloudy and foggy weather replaces."""

    visibility_m: Visibility
    overcast: Fraction
    wetness: Fraction


class RainParams(DryParams):
    """What rain replaces."""

    rain: Fraction
    drops: Fraction


class SnowParams(DryParams):
    """What snow replaces."""

    snowfall: Fraction
    snow: Fraction
    snow_on_road: Fraction
    drops: Fraction


class DayParams(Group):
    """What day replaces."""

    sun_zenith_deg: SunZenith


class DuskParams(DayParams):
    """What dusk replaces."""

    metering: Fraction
    exposure: Exposure
    noise: NoiseLevel
    motion_blur_m: MotionBlur
    headlights: Flag


class NightParams(DuskParams):
    """What night replaces."""

    flare: Fraction


class HostParams(Group):
    """The host's own bonnet in the picture."""

    bonnet: Annotated[Real, reals(0, 0.3)] = added(0.0)
    gray: Fraction = added(0.0)
    gloss: Fraction = added(0.0)


LANE_STATES = ("green_arrow", "red_cross", "amber_left", "amber_right", "off")
RAIL_NAMES = ("none", "guardrail", "concrete", "noise_wall", "kerb", "walkway")
Barrier = Annotated[Named, names(*RAIL_NAMES)]


class RoadsideParams(Group):
    """What stands beside and over the road. `outer` is along the outermost edges of the pavement (drawn for each side),
    `inner` between the main road and the exit, `median` in a median that has room for it."""

    outer: Barrier = added("none")
    inner: Barrier = added("none")
    median: Annotated[Named, names("none", "guardrail", "concrete")] = added("none")
    ramp_rail: Flag = added(False)
    rail_aside_m: Annotated[Real, reals(0.3, 5)] = added(0.5)
    wall_height_m: Annotated[Real, reals(1, 10)] = added(3.0)
    lamps: Annotated[Named, names("none", "left", "right", "both")] = added("none")
    lamp_spacing_m: Annotated[Real, reals(10, 200)] = added(40.0)
    lamp_height_m: Annotated[Real, reals(4, 20)] = added(9.0)
    delineators: Flag = added(False)
    delineator_spacing_m: Annotated[Real, reals(10, 200)] = added(50.0)
    n_signs: Annotated[Integer, integers(0, 20)] = added(0)
    n_gantries: Annotated[Integer, integers(0, 3)] = added(0)
    n_bridges: Annotated[Integer, integers(0, 2)] = added(0)
    clearance_m: Annotated[Real, reals(4.7, 12)] = added(5.5)
    power_line: Annotated[Named, names("none", "left", "right")] = added("none")
    n_houses: Annotated[Integer, integers(0, 50)] = added(0)
    n_halls: Annotated[Integer, integers(0, 20)] = added(0)
    n_blocks: Annotated[Integer, integers(0, 20)] = added(0)
    building_aside_m: Annotated[Real, reals(8, 200)] = added(40.0)
    lane_signals: Flag = added(False)
    lane_state: Annotated[Named, names(*LANE_STATES)] = added("green_arrow")
    exit_signs: Flag = added(False)


Aside = Annotated[Real, reals(0.3, 50)]
SignHeight = Annotated[Real, reals(1.5, 5)]
Ahead = Annotated[Real, reals(0, 300)]
Apart = Annotated[Real, reals(1, 300)]
WallHeight = Annotated[Real, reals(2, 100)]
BuildingSide = Annotated[Real, reals(3, 200)]


class StructureParams(Group):
    """Places and sizes of what stands beside and over the road. Distances between things, and distances of lamps and
    delineators from the edge, are drawn once a scene; all others are drawn for each thing."""

    lamp_aside_m: Aside
    delineator_aside_m: Aside
    sign_aside_m: Aside
    sign_height_m: SignHeight
    sign_ahead_m: Ahead
    signs_apart_m: Apart
    exit_sign_before_m: Annotated[Real, reals(0, 100)]
    exit_sign_height_m: SignHeight
    pole_aside_m: Aside
    pole_height_m: Annotated[Real, reals(4, 20)]
    crossing_ahead_m: Ahead
    crossings_apart_m: Annotated[Real, reals(10, 300)]
    bridge_width_m: Annotated[Real, reals(2, 40)]
    gantry_width_m: Annotated[Real, reals(0.3, 3)]
    building_ahead_m: Ahead
    house_width_m: BuildingSide
    house_length_m: BuildingSide
    house_height_m: WallHeight
    hall_width_m: BuildingSide
    hall_length_m: BuildingSide
    hall_height_m: WallHeight
    block_width_m: BuildingSide
    block_length_m: BuildingSide
    block_height_m: WallHeight


Speed = Annotated[Real, reals(0, 60)]


class MotionParams(Group):
    """Speeds in clips, constant through a clip; a single picture does not use them. Parked cars do not move."""

    host_speed_m_s: Speed = Uniform(20.0, 33.0)
    car_speed_m_s: Speed = Uniform(17.0, 36.0)


# Without a junction a scene is on the road of the paper.
NO_JUNCTION = "none"


class TownParams(Group):
    """A town in place of the road: what its map is drawn from (docs/town.md). `junction` is the first one, which the
    host drives through. `bend_deg` is drawn for each of its streets."""

    junction: Annotated[Named, names("none", "t", "crossing", "staggered", "roundabout", "roundabout_2")] = added(
        "none"
    )
    angle_deg: Annotated[Real, reals(-35, 35)] = added(0.0)
    n_lanes: Annotated[Integer, integers(1, 3)] = added(1)
    n_side: Annotated[Integer, integers(1, 3)] = added(1)
    lane_width_m: Annotated[Real, reals(2.75, 4)] = added(3.25)
    median_m: Annotated[Real, reals(0, 10)] = added(0.0)
    turn_lanes: Annotated[Named, names("none", "left", "both")] = added("none")
    pocket_m: Annotated[Real, reals(25, 80)] = added(40.0)
    corner_m: Annotated[Real, reals(6, 15)] = added(8.0)
    walkway_m: Annotated[Real, reals(0, 4)] = added(2.5)
    parking: Flag = added(False)
    control: Annotated[Named, names("signals", "priority", "stop", "equal")] = added("priority")
    crosswalks: Flag = added(False)
    island_m: Annotated[Real, reals(6, 20)] = added(9.0)
    bend_deg: Annotated[Real, reals(-40, 40)] = added(0.0)
    n_more: Annotated[Integer, integers(0, 3)] = added(0)
    host_place: Annotated[Named, names("before", "in", "behind")] = added("before")
    host_turn: Annotated[Named, names("left", "straight", "right")] = added("straight")
    host_m: Annotated[Real, reals(0, 60)] = added(30.0)
    traffic: Fraction = added(0.5)
    parked: Fraction = added(0.5)
    fronts: Fraction = added(0.7)
    street_trees: Fraction = added(0.3)


class MountainParams(Group):
    """A mountain road in place of the road: legs and sharp bends in turn, uphill. `grade` is the rise per metre; it is
    drawn for each leg, as `leg_m`, and `radius_m` and `turn_deg` for each bend."""

    road: Annotated[Named, names("none", "serpentines")] = added("none")
    n_bends: Annotated[Integer, integers(1, 5)] = added(4)
    first_left: Flag = added(True)
    radius_m: Annotated[Real, reals(10, 20)] = added(15.0)
    turn_deg: Annotated[Real, reals(100, 180)] = added(155.0)
    leg_m: Annotated[Real, reals(30, 100)] = added(80.0)
    grade: Annotated[Real, reals(0, 0.12)] = added(0.08)
    lane_width_m: Annotated[Real, reals(2.5, 4)] = added(3.0)
    widening_m: Annotated[Real, reals(0, 1.5)] = added(0.6)
    rail: Annotated[Named, names("none", "guardrail", "posts")] = added("guardrail")
    lay_by: Flag = added(False)
    descent: Flag = added(False)
    host_place: Fraction = added(0.5)


Green = Annotated[Real, reals(3, 120)]
Setback = Annotated[Real, reals(0.5, 30)]


class TownStreetParams(Group):
    """The streets of towns and what stands and drives along them, beyond the choices of `town` (docs/town.md)."""

    open_street_m: Annotated[Real, reals(120, 400)]
    link_street_m: Annotated[Real, reals(70, 200)]
    staggered_m: Annotated[Real, reals(30, 100)]
    edge_lines: Flag
    four_arms: Flag
    further: Annotated[Named, names("t", "crossing")]
    further_signals: Flag
    green_major_s: Green
    green_major_left_s: Green
    green_minor_s: Green
    far_signals: Flag
    speed_limit: Annotated[Named, names("speed_30", "speed_50")]
    building: Annotated[Named, names("block", "house", "hall")]
    alike: Fraction
    gap_m: Annotated[Real, reals(0.3, 50)]
    house_setback_m: Setback
    block_setback_m: Setback
    hall_setback_m: Setback
    trees_apart_m: Annotated[Real, reals(3, 100)]
    bay_m: Annotated[Real, reals(6.3, 50)]
    speed_m_s: Annotated[Real, reals(3, 20)]
    turn: Annotated[Named, names("left", "straight", "right")]
    arrival_s: Annotated[Real, reals(1, 600)]


class PeopleParams(Group):
    """People on the walkways of towns and maps near the host, and at crosswalks. Of `model`, people with umbrellas
    (7 and 8) take the place of others where it rains."""

    per_100_m: Annotated[Real, reals(0, 60)] = added(0.0)
    crossing: Annotated[Integer, integers(0, 8)] = added(0)
    standing: Fraction = added(0.2)
    model: Annotated[Integer, numbers("pedestrians")] = Choice((1, 2, 3, 4, 5, 6), (5.0, 5.0, 2.0, 2.0, 2.0, 2.0))
    scale: Annotated[Real, reals(0.5, 1.5)] = Uniform(0.95, 1.05)
    speed_m_s: Annotated[Real, reals(0.3, 4)] = Uniform(0.9, 1.7)
    umbrella: Fraction = added(0.6)


class RidersParams(Group):
    """Cyclists beside the kerbs of towns and maps, and motorcyclists on lanes. Those without room are left out."""

    cyclists: Annotated[Integer, integers(0, 40)] = added(0)
    motorcyclists: Annotated[Integer, integers(0, 20)] = added(0)
    cyclist_m_s: Annotated[Real, reals(1, 15)] = Uniform(3.5, 7.0)
    motorcyclist_m_s: Annotated[Real, reals(1, 60)] = Uniform(8.0, 14.0)


class WorksParams(Group):
    """Road works on roads without an exit. Lines that have to move are yellow where `lines` is as_before; a kind for
    which there is no room gives way to the next one of: lane_closed, lanes_shifted, lanes_narrowed, shoulder_closed."""

    present: Flag = added(False)
    kind: Annotated[Named, names("lane_closed", "lanes_shifted", "lanes_narrowed", "shoulder_closed")] = added(
        "lane_closed"
    )
    side: Annotated[Named, names("outer", "inner")] = added("outer")
    ahead_m: Annotated[Real, reals(-100, 150)] = Uniform(-20.0, 60.0)
    length_m: Annotated[Real, reals(10, 300)] = Uniform(60.0, 150.0)
    taper_m: Annotated[Real, reals(10, 100)] = Uniform(25.0, 50.0)
    end_taper_m: Annotated[Real, reals(5, 50)] = Uniform(10.0, 20.0)
    moved_m: Annotated[Real, reals(0.3, 3)] = Uniform(0.5, 1.5)
    least_lane_m: Annotated[Real, reals(2.4, 4)] = added(2.6)
    lines: Annotated[Named, names("as_before", "white", "yellow")] = added("yellow")
    line_width_m: Annotated[Real, reals(0.05, 0.3)] = added(0.12)
    removed: Fraction = added(0.5)
    devices: Annotated[Named, names("cone", "barrel")] = added("cone")
    spacing_m: Annotated[Real, reals(1.5, 20)] = Uniform(4.0, 10.0)
    barricade: Flag = added(True)
