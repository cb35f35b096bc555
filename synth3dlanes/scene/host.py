"""The host of a scene: its place and its camera, which picture of a clip or rig is taken, its lidar, its bonnet.

Pure data; world frame, metres and radians.
"""

import math
from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from synth3dlanes.geometry.lens import PINHOLE, Lens
from synth3dlanes.scene.road_map import Station
from synth3dlanes.scene.settings import MAX_VIEWS
from synth3dlanes.system.schema import (
    AHEAD_DEG,
    MAX_PX,
    DocumentPart,
    Metres,
    Name,
    Number,
    Positive,
    Unit,
    is_empty,
    is_none,
)

# Frames of a clip, cameras of a rig, and how far behind the host lanes may be labelled.
MAX_FRAMES, MAX_CAMERAS, MAX_BEHIND_M = 1000, 64, 110.0
MAX_BEAMS = 256
Seconds = Annotated[float, Field(ge=0, le=1e6)]
Driven = Annotated[float, Field(ge=0, le=1e6)]


def _goes_on(track: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Check that a track goes on in time and along the way."""
    for (time_s, length_m), (next_s, next_m) in pairwise(track):
        if next_s <= time_s or next_m < length_m:
            raise ValueError(f"expected instants in order and no way back, got {next_s:g} s, {next_m:g} m")
    return track


# Instants (seconds of a clip), and lengths driven by then.
DrivenTrack = Annotated[
    tuple[tuple[Seconds, Driven], ...], AfterValidator(_goes_on), Field(max_length=10_000, exclude_if=is_empty)
]


class HostCamera(DocumentPart):
    """The host's place and its camera.

    The host: `lane` is counted from the left in driving direction, `y_m` is its station (at the start of a clip), the
    lateral offset is positive to the right; on a map, lane 1 and the length `y_m` along its route. The camera:
    `right_m` and `forward_m` are relative to the host's place in the host's road frame, `height_m` is over the plane
    of that frame; yaw is positive counter-clockwise seen from above, roll about the viewing axis is positive clockwise
    as the driver sees it.
    """

    lane: Annotated[int, Field(ge=1, le=8)]
    y_m: Station
    offset_m: Metres
    height_m: Annotated[float, Field(gt=0, le=1000)]
    pitch_rad: Number
    width_px: Annotated[int, Field(ge=8, le=MAX_PX)]
    height_px: Annotated[int, Field(ge=8, le=MAX_PX)]
    fx_px: Positive
    fy_px: Positive
    cx_px: Number
    cy_px: Number
    roll_rad: Number = 0.0
    name: Name = ""
    right_m: Annotated[float, Field(ge=-10, le=10)] = 0.0
    forward_m: Annotated[float, Field(ge=-10, le=10)] = 0.0
    yaw_rad: Annotated[float, Field(ge=-4, le=4)] = 0.0
    lens: Lens = PINHOLE

    @property
    def looks_ahead(self) -> bool:
        """Whether it looks where the host drives, and not aside or back."""
        return abs(math.degrees(self.yaw_rad)) <= AHEAD_DEG


class Views(DocumentPart):
    """Which of the `n` places that the host has in turn in one world a scene shows: the one of number `view`. The world
    is built from the first of these places, given as in `HostCamera`, to `reach_m` ahead of it."""

    view: Annotated[int, Field(ge=0, lt=MAX_VIEWS)]
    n: Annotated[int, Field(ge=2, le=MAX_VIEWS)]
    lane: Annotated[int, Field(ge=1, le=8)]
    y_m: Station
    offset_m: Metres
    reach_m: Annotated[float, Field(ge=0, le=1000)]

    @model_validator(mode="after")
    def _is_one_of_them(self) -> "Views":
        """Check that the view is among them."""
        if self.view >= self.n:
            raise ValueError(f"view: expected less than {self.n}, got {self.view}")
        return self


class Shot(DocumentPart):
    """Which picture of the world a scene describes: frame `frame` of a clip of `n_frames` frames at `fps` frames per
    second, by camera `camera` of a rig of `n_cameras`. In a clip the host keeps its lane and drives at `speed_m_s`; on
    a map its `track` may say how far it has driven (metres) at instants (seconds) of the clip. Lanes are labelled from
    `behind_m` metres behind the host."""

    frame: Annotated[int, Field(ge=0, lt=MAX_FRAMES)] = 0
    n_frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)] = 1
    fps: Annotated[float, Field(gt=0, le=1000)] = 10.0
    speed_m_s: Annotated[float, Field(ge=0, le=100)] = 0.0
    camera: Annotated[int, Field(ge=0, lt=MAX_CAMERAS)] = 0
    n_cameras: Annotated[int, Field(ge=1, le=MAX_CAMERAS)] = 1
    behind_m: Annotated[float, Field(ge=0, le=MAX_BEHIND_M)] = 0.0
    track: DrivenTrack = ()
    views: Annotated[Views | None, Field(exclude_if=is_none)] = None

    @model_validator(mode="after")
    def _is_one_of_them(self) -> "Shot":
        """Check that the shot has this frame and this camera, and that a shot with views is no clip."""
        if self.views is not None and self.n_frames > 1:
            raise ValueError(f"views: expected none of a clip, got {self.views.n}")
        for name in ("frame", "camera"):
            number, count = getattr(self, name), getattr(self, f"n_{name}s")
            if number >= count:
                raise ValueError(f"{name}: expected less than {count}, got {number}")
        return self

    @property
    def view(self) -> int:
        """The number of the view; 0 where a world has one."""
        return 0 if self.views is None else self.views.view

    @property
    def n_views(self) -> int:
        """How many views the world has."""
        return 1 if self.views is None else self.views.n

    @property
    def time_s(self) -> float:
        """Seconds since the clip's first frame."""
        return self.frame / self.fps

    @property
    def duration_s(self) -> float:
        """Seconds from the clip's first frame to its last."""
        return (self.n_frames - 1) / self.fps


class Lidar(DocumentPart):
    """A spinning lidar on the host. All beams start at one point; their elevations are listed from the top beam down.
    The other values are the number of azimuths per turn, the ranges (metres) that it measures, and its place, given as
    for a camera."""

    name: Name = ""
    elevations_rad: Annotated[
        tuple[Annotated[float, Field(ge=-1.5, le=1.5)], ...], Field(min_length=1, max_length=MAX_BEAMS)
    ]
    azimuths: Annotated[int, Field(ge=16, le=MAX_PX)]
    min_range_m: Annotated[float, Field(ge=0, le=1000)]
    max_range_m: Annotated[float, Field(gt=0, le=1000)]
    height_m: Annotated[float, Field(ge=0.3, le=10)]
    right_m: Annotated[float, Field(ge=-10, le=10)] = 0.0
    forward_m: Annotated[float, Field(ge=-10, le=10)] = 0.0
    yaw_rad: Annotated[float, Field(ge=-4, le=4)] = 0.0
    pitch_rad: Annotated[float, Field(ge=-4, le=4)] = 0.0
    roll_rad: Annotated[float, Field(ge=-4, le=4)] = 0.0

    @model_validator(mode="after")
    def _is_sorted(self) -> "Lidar":
        """Check that the beams are in order."""
        if any(lower >= upper for upper, lower in pairwise(self.elevations_rad)):
            raise ValueError("elevations_rad: expected the top beam first, and each elevation once")
        return self


class Bonnet(DocumentPart):
    """The host's own bonnet: the share of the image's height that it covers (0 for none), its gray value and its
    gloss."""

    bonnet: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    gray: Unit = 0.0
    gloss: Unit = 0.0
