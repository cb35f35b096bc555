"""Params: the ranges that scenes are drawn from, and their YAML form (`params/*.yaml`, docs/params.md).

Metres and degrees. Reading a file is the only side effect.
"""

import copy
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    model_validator,
)

from synth3dlanes.params.distributions import (
    Choice,
    Distribution,
    Flag,
    Integer,
    Integers,
    Named,
    Real,
    Uniform,
    form,
    integers,
    is_pair,
    names,
    parse_integers,
    reals,
)
from synth3dlanes.scene.assets.catalogue import BUILT_IN, AssetKind, Assets
from synth3dlanes.scene.settings import JPEG_QUALITY
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import did_you_mean, shown, unknown_key
from synth3dlanes.system.yaml_text import read_yaml, text_of

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
# The preset that has every key.
REFERENCE = "appendix_i"
# Kinds of weather and times of day, each a group of what it replaces.
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
    *("symbols", "weather", "host", "vegetation", "roadside", "motion", "town"),
    *(*KINDS, *DAYTIMES, "structures", "town_streets"),
)
# Groups whose values stand in the reference alone.
IN_REFERENCE = (*KINDS, *DAYTIMES, "structures", "town_streets")
# If more keys than this are missing, one line names them all.
MAX_MISSING = 3


def numbers(kind: AssetKind) -> PlainValidator:
    """The legal numbers of models or textures of one kind, which are those of the `Assets` in the validation's context.
    A range or weights over all built-in ones, as in the presets, mean all of a user's own. Without a context, as in
    `dataset.json`, any number is legal."""
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


def added(default: Any) -> Any:
    """A field that a later version added. Parameters without it have this constant; `dataset.json` leaves it out if it
    has this value."""
    constant = Choice((default,), (1.0,))
    return Field(default=constant, exclude_if=lambda value: value == constant)


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
    drops on the glass, and the quality of JPEG images."""

    motion_blur_m: MotionBlur
    noise: NoiseLevel
    flare: Fraction = added(0.0)
    dirt: Fraction = added(0.0)
    drops: Fraction = added(0.0)
    jpeg_quality: Annotated[Integer, integers(1, 100)] = added(JPEG_QUALITY)


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
    """Places and sizes of what stands beside and over the road. Distances between things, and those of lamps and
    delineators from the edge, are drawn once, the others for each thing."""

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


def _read_kept(read: Any) -> tuple[str, ...]:
    """Keys that weather or time of day replace, in order; raise ValueError."""
    known = sorted(REPLACED.values())
    if not isinstance(read, list | tuple) or any(path not in known for path in read):
        raise ValueError(f"expected a list of keys that follow from the weather: {', '.join(known)}")
    return tuple(sorted(set(read)))


def _as_in_reference(name: str) -> Any:
    """A field whose values stand in the reference preset alone; `dataset.json` leaves it out if it has those."""
    return Field(exclude_if=lambda group: group == _reference_group(name))


class Params(Group):
    """The distribution of every parameter of a scene. Names are as in `scene.json`, with degrees instead of radians.
    `kept` are the keys, as `surface.wetness`, whose distributions are the user's own: weather and time of day leave
    them as they are.

    `model_dump(mode="json")` gives the YAML forms back; `Params.model_validate` reads them.
    """

    terrain: TerrainParams
    road: RoadParams
    markings: MarkingsParams
    surface: SurfaceParams
    cars: CarParams
    trees: TreeParams
    camera: CameraParams
    light: LightParams
    air: AirParams
    sensor: SensorParams
    symbols: SymbolParams = Field(default=SymbolParams(), exclude_if=lambda group: group == SymbolParams())
    weather: WeatherParams = Field(default=WeatherParams(), exclude_if=lambda group: group == WeatherParams())
    clear: DryParams = _as_in_reference("clear")
    cloudy: DryParams = _as_in_reference("cloudy")
    fog: DryParams = _as_in_reference("fog")
    rain: RainParams = _as_in_reference("rain")
    snow: SnowParams = _as_in_reference("snow")
    day: DayParams = _as_in_reference("day")
    dusk: DuskParams = _as_in_reference("dusk")
    night: NightParams = _as_in_reference("night")
    host: HostParams = Field(default=HostParams(), exclude_if=lambda group: group == HostParams())
    vegetation: VegetationParams = Field(
        default=VegetationParams(), exclude_if=lambda group: group == VegetationParams()
    )
    roadside: RoadsideParams = Field(default=RoadsideParams(), exclude_if=lambda group: group == RoadsideParams())
    structures: StructureParams = _as_in_reference("structures")
    motion: MotionParams = Field(default=MotionParams(), exclude_if=lambda group: group == MotionParams())
    town: TownParams = Field(default=TownParams(), exclude_if=lambda group: group == TownParams())
    town_streets: TownStreetParams = _as_in_reference("town_streets")
    kept: Annotated[tuple[str, ...], BeforeValidator(_read_kept)] = Field(default=(), exclude_if=lambda kept: not kept)

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, document: Any) -> Any:
        """What a document leaves out of groups whose values stand in the reference preset, as there."""
        if not isinstance(document, dict):
            return document
        filled = dict(document)
        for name in IN_REFERENCE:
            given = document.get(name, {})
            filled[name] = {**_reference()[name], **given} if isinstance(given, dict) else given
        return filled

    @property
    def is_town(self) -> bool:
        """Whether scenes are towns, all or some of them."""
        return self.town.junction.values != (NO_JUNCTION,)

    @property
    def groups(self) -> dict[str, Group]:
        """The groups by name."""
        return {name: group for name, group in self if isinstance(group, Group)}

    def open_to(self) -> dict[str, dict[str, Distribution]]:
        """What the kinds of weather and times of day that may be drawn replace: `group.key` -> distributions, by the
        value of `weather` that brings them."""
        found: dict[str, dict[str, Distribution]] = {}
        for name in ("kind", "daytime"):
            for value in getattr(self.weather, name).values:
                for path, distribution in self.replaced(value).items():
                    found.setdefault(path, {})[f"weather.{name} {value}"] = distribution
        return found

    def replaced(self, *names: str) -> dict[str, Distribution]:
        """The distributions that these kinds of weather and times of day replace, by `group.key`; none for any."""
        return {
            REPLACED[key]: distribution for name in names if name != "any" for key, distribution in getattr(self, name)
        }

    def keeping(self, own: Iterable[str]) -> "Params":
        """The parameters with these keys of the user's own, too; those that no weather replaces need not be kept."""
        return self.model_copy(update={"kept": tuple(sorted({*self.kept, *own} & self.open_to().keys()))})

    def under(self, kind: str, daytime: str) -> "Params":
        """The parameters of scenes in this weather and at this time of day."""
        changes: dict[str, dict[str, Distribution]] = {}
        for path, distribution in self.replaced(kind, daytime).items():
            if path not in self.kept:
                group, key = path.split(".")
                changes.setdefault(group, {})[key] = distribution
        return self.model_copy(
            update={group: getattr(self, group).model_copy(update=keys) for group, keys in changes.items()}
        )


def presets_folder() -> Path:
    """The folder of the presets: inside the package in an installed wheel, at the root of a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "_params"
    return installed if installed.is_dir() else package.parent / "params"


def preset_names(kind: str = "") -> list[str]:
    """The names of the presets, or of the ready `benchmarks`, `cameras`, `rigs` or `lidars`."""
    return sorted(path.stem for path in (presets_folder() / kind).glob("*.yaml"))


# The option that takes a kind of preset.
OPTION_OF = {"": "--params", "cameras": "--camera", "rigs": "--rig", "lidars": "--lidar"}


def find_preset(source: str, kind: str = "") -> tuple[Path, str]:
    """The path of a preset of some kind, by its name, or of a user's own file, by its path; and its name in messages.
    Raises InputError if there is neither."""
    if source in preset_names(kind):
        within = Path(kind, f"{source}.yaml")
        return presets_folder() / within, str("params" / within)
    if Path(source).suffix in (".yaml", ".yml"):
        return Path(source), source
    other = next((other for other in OPTION_OF if other != kind and source in preset_names(other)), None)
    hint = did_you_mean(source, preset_names(kind)) if other is None else f"; {source} is for {OPTION_OF[other]}"
    raise InputError(f"{source}: expected one of {', '.join(preset_names(kind))}, or the path of a .yaml file{hint}")


@lru_cache(maxsize=1)
def _reference() -> dict[str, dict[str, Any]]:
    """The keys of the reference preset, as they are written."""
    document, _ = _parsed(text_of(*find_preset(REFERENCE)), REFERENCE)
    found: dict[str, dict[str, Any]] = document
    return found


@lru_cache
def _reference_group(name: str) -> Group:
    """A group of the reference preset."""
    group: Any = Params.model_fields[name].annotation
    found: Group = group.model_validate(_reference()[name])
    return found


@dataclass(frozen=True, eq=False)
class _File:
    """A preset or a parameter file as it is written: its name in messages, its path, text, keys and problems."""

    where: str
    path: Path
    text: str
    document: dict[Any, Any]
    problems: list[str]
    preset: str


# The key of a file that names the preset or the file that it changes.
BASE = "base"


def _read_file(source: str, by: _File | None = None) -> _File:
    """A preset or file, as the base of another file or as a user names it."""
    named = "" if by is None else f"{by.where}: {BASE}: "
    try:
        path, where = find_preset(source)
    except InputError as error:
        raise InputError(*(f"{named}{problem}" for problem in error.problems)) from None
    if by is not None and where == source:
        path = by.path.parent / source
        where = str(path)
    text = text_of(path, f"{named}{where}")
    document, problems = copy.deepcopy(_parsed(text, where))
    is_preset = os.path.realpath(path) == os.path.realpath(presets_folder() / path.name)
    if not isinstance(document, dict):
        raise InputError(*(problems or [f"{where}: expected groups of parameters, got {shown(document)}"]))
    return _File(where, path, text, document, problems, path.stem if is_preset else "")


def files_of(source: str) -> list[_File]:
    """A preset or file and those that it is based on, itself last. Raises InputError."""
    files = [_read_file(source)]
    seen = [os.path.realpath(files[0].path)]
    while BASE in files[0].document:
        first, base = files[0], files[0].document.pop(BASE)
        if not isinstance(base, str):
            expected = "the name of a preset or the path of a parameter file"
            raise InputError(*first.problems, f"{first.where}: {BASE}: expected {expected}, got {shown(base)}")
        files.insert(0, _read_file(base, first))
        seen.append(os.path.realpath(files[0].path))
        if seen[-1] in seen[:-1]:
            circle = " -> ".join(file.where for file in reversed(files))
            raise InputError(f"{first.where}: {BASE}: expected a file that is not based on this one, got {circle}")
    return files


def preset_under(source: str) -> str:
    """The preset that a file is based on, or that a source names; "" for a file without a base."""
    return next((file.preset for file in reversed(files_of(source)) if file.preset), "")


def merged(files: Sequence[_File]) -> dict[Any, Any]:
    """The keys of files, those of later ones in place of those of earlier ones."""
    document: dict[Any, Any] = {}
    for file in files:
        for name, read in file.document.items():
            under = document.get(name)
            if isinstance(read, dict) and isinstance(under, dict):
                document[name] = {**under, **read}
            else:
                document[name] = [*under, *read] if isinstance(read, list) and isinstance(under, list) else read
    return document


def _named(files: Iterable[_File]) -> dict[str, str]:
    """The groups and keys that files have, as `cars` and `cars.n`, each with the name of the last such file."""
    found = {}
    for file in files:
        for name, read in file.document.items():
            found[str(name)] = file.where
            found.update({f"{name}.{key}": file.where for key in read} if isinstance(read, dict) else {})
    return found


def load_params(source: str, overrides: Sequence[str] = (), assets: Assets = BUILT_IN.assets) -> Params:
    """Read a preset (by name) or a YAML file, with what it is based on, then apply overrides like `road.n_lanes=3`.

    Numbers of models and textures refer to `assets`; see `numbers`. Raises one InputError with a line
    for every problem, each naming file and key.
    """
    files = files_of(source)
    problems = [problem for file in files for problem in file.problems]
    document = merged(files)
    overridden, override_problems = _override(document, overrides)
    try:
        params = Params.model_validate(document, context=assets)
    except ValidationError as error:
        places = {**_named(files), **dict.fromkeys(overridden, "overrides")}
        raise InputError(*problems, *override_problems, *_problems(error, files[-1].where, places)) from None
    if problems or override_problems:
        raise InputError(*problems, *override_problems)
    # Keys of their author's own are those in files that change a preset; of those in a complete file, which has all
    # keys, the ones that differ from the preset that it was made from.
    own = overridden | _named(file for file in files if not file.preset).keys()
    if not any(file.preset for file in files) and params.open_to():
        own = overridden | nearest_preset(params)[1] | _named(files[1:]).keys()
    return params.keeping(own)


def nearest_preset(params: Params) -> tuple[str, set[str]]:
    """The preset that parameters differ least from, and the keys, as `cars.n`, that differ."""
    own = forms(params)
    changes = {
        name: {f"{group}.{key}" for group in own for key, form in own[group].items() if form != base[group][key]}
        for name in preset_names()
        for base in [forms(load_params(name))]
    }
    name = min(changes, key=lambda name: len(changes[name]))
    return name, changes[name]


@lru_cache(maxsize=16)
def _parsed(text: str, where: str) -> tuple[Any, list[str]]:
    """The result of `read_yaml`, which takes most of the time of loading, computed once for each file."""
    return read_yaml(text, where)


def check_params(sources: Iterable[str], overrides: Sequence[str] = ()) -> None:
    """Load every source; raise one InputError with the problems of all."""
    problems: list[str] = []
    for source in sources:
        try:
            load_params(source, overrides)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(*dict.fromkeys(problems))


def is_parameter(group: str, key: str) -> bool:
    """Whether there is a parameter of this name."""
    return key in _keys((group,))


def fixed(params: Params, group: str, key: str, value: Any) -> Params:
    """The parameters with one of them constant; raise pydantic's ValidationError for a value that is not legal."""
    changed: dict[str, Any] = {name: dict(keys) for name, keys in params.groups.items()}
    changed[group][key] = value
    return Params.model_validate({**changed, "kept": params.kept})


def problems_of(params: Params, path: str, value: Any) -> list[str]:
    """What is wrong with a constant value of the parameter `group.key`, in lines; nothing for other paths."""
    group, _, key = path.partition(".")
    if not is_parameter(group, key):
        return []
    try:
        found = getattr(getattr(fixed(params, group, key, value), group), key)
    except ValidationError as error:
        return [f"{path}: {problem['ctx']['error']}, got {shown(value)}" for problem in error.errors()]
    is_constant = isinstance(found, Choice) and len(found.values) == 1
    return [] if is_constant else [f"{path}: expected a constant, got {shown(value)}"]


def forms(params: Params) -> dict[str, dict[str, Any]]:
    """The YAML form of every key, by group and key."""
    return {name: {key: form(distribution) for key, distribution in group} for name, group in params.groups.items()}


def _override(document: dict[Any, Any], overrides: Iterable[str]) -> tuple[set[str], list[str]]:
    """Set `group.key` in place; return the keys that were set and the problems."""
    done: set[str] = set()
    problems: list[str] = []
    for override in overrides:
        path, equals, text = override.partition("=")
        steps = path.strip().split(".")
        if not equals or len(steps) != 2:
            problems.append(f"overrides {override}: expected group.key=value")
            continue
        value, value_problems = read_yaml(text, f"overrides {path.strip()}")
        problems += value_problems
        group = document.setdefault(steps[0], {}) if steps[0] in OPTIONAL else document.get(steps[0])
        if isinstance(group, dict) and not value_problems:
            group[steps[1]] = value
            done.add(path.strip())
        elif not _keys((steps[0],)):
            groups = [name for name in Params.model_fields if _keys((name,))]
            problems.append(f"overrides {path.strip()}: {unknown_key(steps[0], groups)}")
    return done, problems


def _problems(error: ValidationError, where: str, places: Mapping[str, str]) -> list[str]:
    """A line for each problem of a file `where`; the place of a group or key that is elsewhere is in `places`."""
    lines = []
    missing = [".".join(map(str, problem["loc"])) for problem in error.errors() if problem["type"] == "missing"]
    for problem in error.errors():
        path = ".".join(str(step) for step in problem["loc"])
        place = places.get(path, where)
        place += f" {path}" if place == "overrides" else f": {path}"
        if problem["type"] == "missing" and len(missing) > MAX_MISSING:
            continue
        if problem["type"] == "missing":
            text = "missing key"
        elif problem["type"] == "extra_forbidden":
            text = unknown_key(str(problem["loc"][-1]), _keys(problem["loc"][:-1]))
        elif problem["type"] == "value_error":
            text = f"{problem['ctx']['error']}, got {shown(problem['input'])}"
        else:
            text = f"expected a group of parameters, got {shown(problem['input'])}"
        lines.append(f"{place}: {text}")
    if len(missing) > MAX_MISSING:
        named = ", ".join(missing[:MAX_MISSING])
        hint = f"a file that changes a preset begins with its name, as `{BASE}: appendix_i`"
        lines.append(f"{where}: {len(missing)} missing keys: {named}, ...; {hint}")
    return lines


def _keys(group: tuple[int | str, ...]) -> Iterable[str]:
    """The keys of a group, of none for other names; without a group those of all parameters."""
    if not group:
        return Params.model_fields
    model = Params.model_fields[str(group[0])].annotation if group[0] in Params.model_fields else None
    return model.model_fields if isinstance(model, type) and issubclass(model, BaseModel) else ()
