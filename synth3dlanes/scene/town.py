"""Town: the values that the map of a town was drawn from, as its scene keeps them. Metres and radians."""

from typing import Annotated, Literal

from pydantic import Field

from synth3dlanes.system.schema import DocumentPart, Number

JunctionKind = Literal["t", "crossing", "staggered", "roundabout", "roundabout_2"]
Control = Literal["signals", "priority", "stop", "equal"]
TurnLanes = Literal["none", "left", "both"]
HostPlace = Literal["before", "in", "behind"]
HostTurn = Literal["left", "straight", "right"]


# Lanes of the rings of roundabouts, and of the main streets there.
ROUNDABOUTS: dict[str, int] = {"roundabout": 1, "roundabout_2": 2}


class Town(DocumentPart):
    """A town: its first junction, the streets there, and the host's way through it (docs/town.md). `angle_rad` is how
    far the side street is from a right angle. `host_m` is the host's distance to the junction, or from it; in it, 60 m
    are the whole way through it."""

    junction: JunctionKind
    angle_rad: Number
    n_lanes: Annotated[int, Field(ge=1, le=3)]
    n_side: Annotated[int, Field(ge=1, le=3)]
    lane_width_m: Annotated[float, Field(ge=2.5, le=5)]
    median_m: Annotated[float, Field(ge=0, le=20)]
    turn_lanes: TurnLanes
    pocket_m: Annotated[float, Field(ge=10, le=200)]
    corner_m: Annotated[float, Field(ge=5, le=30)]
    walkway_m: Annotated[float, Field(ge=0, le=4.5)]
    parking: bool
    control: Control
    crosswalks: bool
    island_m: Annotated[float, Field(ge=4, le=40)]
    bends_rad: Annotated[tuple[Number, ...], Field(max_length=8)]
    n_more: Annotated[int, Field(ge=0, le=3)]
    host_place: HostPlace
    host_turn: HostTurn
    host_m: Annotated[float, Field(ge=0, le=100)]

    @property
    def has_crosswalks(self) -> bool:
        """Whether arms have crosswalks: only where there are walkways."""
        return self.crosswalks and self.walkway_m > 0
