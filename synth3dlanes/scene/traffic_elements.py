"""Traffic elements of a scene: signals and signs at free places, and the signals over the lanes of a gantry. Pure data.

World frame, metres and radians. A place is the foot of the pole. `yaw_rad` is the direction of the governed traffic,
counter-clockwise from world y; the face looks the other way. `lanes` are the ids of the governed segments of the lane
graph.
"""

from typing import Annotated, Literal

from pydantic import Field

from synth3dlanes.system.schema import DocumentPart, Name, Number

# The most signals, and the most signs, that have places of their own; the most lanes that an element governs.
MAX_FREE, MAX_LANES, MAX_PHASES = 300, 32, 16

SignalState = Literal["off", "red", "red_amber", "amber", "green"]
LensForm = Literal["ball", "left", "straight", "right"]
LaneState = Literal["off", "red_cross", "green_arrow", "amber_left", "amber_right"]
SignKind = Literal[
    "stop",
    "give_way",
    "priority",
    "no_entry",
    "speed_20",
    "speed_30",
    "speed_40",
    "speed_50",
    "speed_60",
    "speed_70",
    "speed_80",
    "speed_90",
    "speed_100",
    "speed_120",
    "speed_130",
    "ahead_only",
    "left_only",
    "right_only",
    "no_left_turn",
    "no_right_turn",
    "no_u_turn",
    "exit_left",
    "exit_right",
]
# What the numbered faces of signs beside the road and the boards of gantries are, beside those above.
FaceKind = Literal[
    "speed_limit",
    "warning",
    "bend_left",
    "bend_right",
    "information",
    "direction_left",
    "direction_right",
    "direction_ahead",
    "direction_down",
    "roadworks_left",
    "roadworks_right",
]
# What an element is within its category: the form of a light's lenses, `lane` over a lane, or what a sign shows.
ElementKind = LensForm | Literal["lane"] | SignKind | FaceKind
ElementState = SignalState | LaneState
GovernedLanes = Annotated[tuple[Name, ...], Field(max_length=MAX_LANES)]
Mounting = Annotated[float, Field(gt=0, le=12)]
Reach = Annotated[float, Field(ge=-25, le=25)]


class Phase(DocumentPart):
    """What a signal shows, and for how many seconds."""

    state: SignalState
    seconds: Annotated[float, Field(gt=0, le=1000)] = 1000.0


class TrafficSignal(DocumentPart):
    """A head with three lights, red above amber above green, whose lenses show balls or arrows. Its lower edge is
    `height_m` over the ground at its foot, its middle `reach_m` to the right of that as its traffic drives (negative:
    to the left), at the end of an arm. Without a pole it hangs on what stands there. It shows its phases in turn, the
    first of them from `shift_s` seconds before a clip begins."""

    x_m: Number
    y_m: Number
    yaw_rad: Number
    height_m: Mounting
    phases: Annotated[tuple[Phase, ...], Field(min_length=1, max_length=MAX_PHASES)]
    lanes: GovernedLanes
    form: LensForm = "ball"
    reach_m: Reach = 0.0
    shift_s: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    has_pole: bool = True

    def state_at(self, time_s: float) -> SignalState:
        """What it shows at a time of a clip."""
        left_s = (time_s + self.shift_s) % sum(phase.seconds for phase in self.phases)
        for phase in self.phases:
            if left_s < phase.seconds:
                return phase.state
            left_s -= phase.seconds
        return self.phases[-1].state


class TrafficSign(DocumentPart):
    """A sign, mounted like a signal's head: `height_m` is the height of its lower edge."""

    x_m: Number
    y_m: Number
    yaw_rad: Number
    height_m: Mounting
    kind: SignKind
    lanes: GovernedLanes
    reach_m: Reach = 0.0
    has_pole: bool = True


class LaneSignal(DocumentPart):
    """A signal over the middle of a lane on a gantry, for the traffic of that lane."""

    lane: Name
    state: LaneState
