"""Traffic elements of a site: heads of signals and faces of signs, with what they show and the lanes that they govern.
World frame, metres."""

from collections.abc import Iterator
from dataclasses import dataclass

from synth3dlanes.roads.network import Network
from synth3dlanes.scene.roadside import Crossing, Post, Roadside
from synth3dlanes.scene.things import ElementCategory
from synth3dlanes.scene.traffic_elements import ElementKind, ElementState, LaneSignal, TrafficSignal
from synth3dlanes.world.crossings import gantry_boards, lane_signal_places
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.posts import post_frames, sign_place
from synth3dlanes.world.sign_faces import BOARD_KINDS, FACE_KINDS, FACES, SIGN_FACES
from synth3dlanes.world.signals import (
    Mounted,
    board_body,
    foot_frames,
    head_body,
    head_light,
    lane_head_body,
    lane_light,
    mounted,
)
from synth3dlanes.world.solids import Body


@dataclass(frozen=True, eq=False)
class TrafficElement:
    """A head of a signal or the face of a sign: what it is, the ids of the lane segments that it governs, where it is,
    and its body without light. `signal` says what a signal shows."""

    category: ElementCategory
    kind: ElementKind
    lanes: tuple[str, ...]
    place: Mounted
    body: Body
    signal: TrafficSignal | LaneSignal | None = None

    def state(self, time_s: float) -> ElementState | None:
        """What a signal shows at a time of a clip; None of a sign."""
        match self.signal:
            case TrafficSignal():
                return self.signal.state_at(time_s)
            case LaneSignal(state=state):
                return state
        return None

    def light(self, time_s: float) -> Body | None:
        """What shines of it at a time of a clip; None if nothing does."""
        match self.signal:
            case TrafficSignal(form=form):
                lit = head_light(self.place, form, self.signal.state_at(time_s))
            case LaneSignal(state=state):
                lit = lane_light(self.place, state)
            case None:
                return None
        return lit if len(lit.corners_world) else None


def traffic_elements(ground: Ground, roadside: Roadside) -> list[TrafficElement]:
    """All traffic elements in the order of their instance ids: signs of posts, what gantries have, signals, signs."""
    signs = [post for post in roadside.posts if post.kind == "sign"]
    found = [
        TrafficElement(
            "road_sign",
            FACE_KINDS[post.face - 1],
            _beside(ground.network, post),
            place := sign_place(frame, post),
            board_body(place, FACES[post.face - 1]),
        )
        for post, frame in zip(signs, post_frames(ground, signs), strict=True)
    ]
    for crossing in roadside.crossings:
        found += _on_gantry(ground, crossing)
    for signal, frame in zip(roadside.signals, foot_frames(ground, roadside.signals), strict=True):
        place = mounted(signal, frame)
        found.append(TrafficElement("traffic_light", signal.form, signal.lanes, place, head_body(place), signal))
    for sign, frame in zip(roadside.signs, foot_frames(ground, roadside.signs), strict=True):
        place = mounted(sign, frame)
        body = board_body(place, SIGN_FACES[sign.kind])
        found.append(TrafficElement("road_sign", sign.kind, sign.lanes, place, body))
    return found


def _on_gantry(ground: Ground, crossing: Crossing) -> Iterator[TrafficElement]:
    for place, layers, variant, lanes in gantry_boards(ground, crossing):
        kind = BOARD_KINDS[variant % len(BOARD_KINDS)]
        yield TrafficElement("road_sign", kind, lanes, place, board_body(place, layers))
    for signal, place in zip(crossing.signals, lane_signal_places(ground, crossing), strict=True):
        yield TrafficElement("lane_signal", "lane", (signal.lane,), place, lane_head_body(place), signal)


def _beside(network: Network, post: Post) -> tuple[str, ...]:
    """The lanes of the carriageway beside a sign. One that forbids entry governs none as these are driven."""
    if FACE_KINDS[post.face - 1] == "no_entry":
        return ()
    road = network.road(post.road)
    direction = road.carriageways[0 if post.side == "left" else -1].direction
    here = {lane.id for lane in road.lanes_at(post.s_m) if lane.direction == direction}
    return tuple(lane for lane in network.lanes if lane in here)
