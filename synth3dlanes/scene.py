"""Scene: one world, fully decided, and its JSON form (`scene.json`, spec section 5).

World frame, metres and radians. Pure data: nothing here reads files or computes geometry.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from synth3dlanes.errors import FormatError

SCENE_VERSION = 1

Unit = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
Color = tuple[Unit, Unit, Unit]


class Part(BaseModel):
    """A frozen part of a scene; unknown keys, missing keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Gaussian(Part):
    """One hill or hollow of the terrain (paper, Appendix I, Table 'Terrain 3D')."""

    center_m: tuple[float, float]
    magnitude_m: float
    sd_m: tuple[Positive, Positive]
    orientation_rad: float


class Terrain(Part):
    """A sum of Gaussians."""

    gaussians: tuple[Gaussian, ...]


class Road(Part):
    """Top view and ramp of the main road and its exit (Appendix I, Tables 'Topology' to 'Lane 3D')."""

    topology: Annotated[int, Field(ge=1, le=4)]
    flip_longitudinal: bool
    flip_lateral: bool
    n_lanes: Annotated[int, Field(ge=2, le=8)]
    lane_width_m: Positive
    shoulder_factor: Annotated[float, Field(ge=0)]
    offset_m100_m: float
    offset_m50_m: float
    offset_p50_m: float
    offset_p100_m: float
    exit_angle_rad: Annotated[float, Field(ge=0, lt=0.5)]
    exit_offset_m: Annotated[float, Field(ge=0)]
    ramp_height_m: Annotated[float, Field(ge=0)]
    ramp_slope: Positive


class Markings(Part):
    """Paint: `dash_fraction` is the painted share of `dash_cycle_m`."""

    dash_cycle_m: Positive
    dash_fraction: Annotated[float, Field(gt=0, le=1)]
    width_m: Positive
    grayscale: Unit
    gloss: Unit


class Surface(Part):
    """Textures of road and terrain; types count from 1."""

    road_texture: Annotated[int, Field(ge=1)]
    road_texture_scale: Positive
    road_gloss: Unit
    terrain_texture: Annotated[int, Field(ge=1)]
    terrain_texture_scale: Positive
    texture_orientation_rad: float


class Car(Part):
    """A car on the centre of lane segment `lane` (its id in the lane graph) at station `s_m` (world y on the
    main reference line), heading as the host does. Models count from 1."""

    model: Annotated[int, Field(ge=1)]
    scale: Positive
    color: Color
    gloss: Unit
    lane: str
    s_m: float


class Tree(Part):
    """A tree at a world position that the sampler has checked against the roads. Models count from 1."""

    model: Annotated[int, Field(ge=1)]
    x_m: float
    y_m: float
    yaw_rad: float
    scale: Positive


class Camera(Part):
    """The host's camera: lane from the left as it drives, station `y_m`, lateral offset positive to the right."""

    lane: Annotated[int, Field(ge=1)]
    y_m: float
    offset_m: float
    height_m: Positive
    pitch_rad: float
    width_px: Annotated[int, Field(ge=8)]
    height_px: Annotated[int, Field(ge=8)]
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float


class Light(Part):
    """The sun, azimuth counter-clockwise from world x, and the film exposure factor."""

    sun_zenith_rad: Annotated[float, Field(ge=0, le=1.6)]
    sun_azimuth_rad: float
    exposure: Positive


class Scene(Part):
    """One world. `(seed, split, index)` say where it was drawn from."""

    format: Literal["synth3dlanes.scene"]
    version: Literal[1]
    seed: Annotated[int, Field(ge=0)]
    split: str
    index: Annotated[int, Field(ge=0)]
    terrain: Terrain
    road: Road
    markings: Markings
    surface: Surface
    cars: tuple[Car, ...]
    trees: tuple[Tree, ...]
    camera: Camera
    light: Light


def to_json(scene: Scene) -> str:
    """The scene as one line of JSON; equal scenes give equal text."""
    return scene.model_dump_json()


def from_json(text: str | bytes, where: str) -> Scene:
    """Parse `scene.json`; raise FormatError with one line per problem, each beginning with `where`."""
    try:
        return Scene.model_validate_json(text)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, where))) from None


def validation_problems(error: ValidationError, where: str) -> list[str]:
    """One line per problem: where, what was expected, what was found."""
    lines = []
    for problem in error.errors():
        path = ".".join(str(step) for step in problem["loc"])
        found = "" if problem["type"] == "missing" else f", got {problem['input']!r:.60}"
        lines.append(f"{where}: {path + ': ' if path else ''}{problem['msg']}{found}")
    return lines
