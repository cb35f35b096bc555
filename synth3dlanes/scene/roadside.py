"""What stands beside and over the roads of a scene. Pure data; world frame, metres and radians."""

from typing import Annotated, Literal

from pydantic import Field

from synth3dlanes.scene.road_map import Station
from synth3dlanes.scene.traffic_elements import MAX_FREE, MAX_LANES, LaneSignal, TrafficSign, TrafficSignal
from synth3dlanes.system.schema import Color, DocumentPart, Metres, Name, Number

RoadSide = Literal["left", "right", "median"]
RailKind = Literal["guardrail", "concrete", "noise_wall", "kerb", "walkway", "power_line"]
PostKind = Literal["lamp", "sign", "delineator"]
N_SIGN_FACES, MAX_BUILDINGS, MAX_RAILS = 16, 200, 100


class Rail(DocumentPart):
    """A barrier, wall, kerb or power line along a road (`main`, `exit`, or one of a map) between two plan stations. Its
    front is `aside_m` from the edge of the pavement on a side of the plan; on the side `median` its middle is at plan
    offset `aside_m` of the road. A `walkway` is a kerb with a paved path behind it."""

    kind: RailKind
    road: Name
    side: RoadSide
    from_m: Station
    to_m: Station
    aside_m: Metres
    height_m: Annotated[float, Field(gt=0, le=30)]
    color: Color


class Post(DocumentPart):
    """A lamp post, sign or delineator at a plan station, placed like a `Rail`. `face` numbers the picture of a sign
    from 1; a `turned` sign shows it to the traffic in the other direction."""

    kind: PostKind
    road: Name
    side: RoadSide
    s_m: Metres
    aside_m: Metres
    height_m: Annotated[float, Field(gt=0, le=30)]
    face: Annotated[int, Field(ge=1, le=N_SIGN_FACES)] = 1
    turned: bool = False


class Crossing(DocumentPart):
    """A gantry or bridge across all roads at a plan station of the main road: its free height `clearance_m` over every
    pavement, and its width along the road. A gantry has boards, or else the signals over lanes that are listed."""

    kind: Literal["gantry", "bridge"]
    s_m: Metres
    clearance_m: Annotated[float, Field(ge=4.7, le=30)]
    width_m: Annotated[float, Field(gt=0, le=100)]
    color: Color
    signals: Annotated[tuple[LaneSignal, ...], Field(max_length=MAX_LANES)] = ()


class Building(DocumentPart):
    """A house with a gable, an industrial hall or a block of flats: the middle of its floor plan, the direction of its
    length (counter-clockwise from world y), and the height of its walls."""

    kind: Literal["house", "hall", "block"]
    x_m: Number
    y_m: Number
    yaw_rad: Number
    width_m: Annotated[float, Field(gt=0, le=1000)]
    length_m: Annotated[float, Field(gt=0, le=1000)]
    height_m: Annotated[float, Field(gt=0, le=300)]
    color: Color
    roof: Color


class Roadside(DocumentPart):
    """What stands beside and over the road. In the instance pass, structures are numbered in this order: rails, posts,
    crossings, buildings, poles of signals and of signs, decks and tunnels of a map, then the heads of signals and the
    signs that these hold."""

    rails: Annotated[tuple[Rail, ...], Field(max_length=MAX_RAILS)] = ()
    posts: Annotated[tuple[Post, ...], Field(max_length=1000)] = ()
    crossings: Annotated[tuple[Crossing, ...], Field(max_length=20)] = ()
    buildings: Annotated[tuple[Building, ...], Field(max_length=MAX_BUILDINGS)] = ()
    signals: Annotated[tuple[TrafficSignal, ...], Field(max_length=MAX_FREE)] = ()
    signs: Annotated[tuple[TrafficSign, ...], Field(max_length=MAX_FREE)] = ()

    @property
    def free_elements(self) -> tuple[TrafficSignal | TrafficSign, ...]:
        """The signals and signs that have places of their own."""
        return (*self.signals, *self.signs)
