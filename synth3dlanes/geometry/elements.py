"""Traffic elements of a site: heads of signals and the faces of signs, with what they show and govern. World frame,
metres."""

from dataclasses import dataclass

from synth3dlanes.geometry.crossings import lane_signal_places
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.signals import (
    Mounted,
    head_body,
    head_light,
    lane_head_body,
    lane_light,
    mounted,
    sign_body,
)
from synth3dlanes.geometry.solids import Body
from synth3dlanes.scene import Roadside
from synth3dlanes.traffic_elements import LaneSignal, TrafficSign, TrafficSignal


@dataclass(frozen=True, eq=False)
class TrafficElement:
    """A head or a face: where it is, its body without light, and what the scene says of it."""

    item: TrafficSignal | TrafficSign | LaneSignal
    place: Mounted
    body: Body

    @property
    def lanes(self) -> tuple[str, ...]:
        """The ids of the segments that it governs."""
        return (self.item.lane,) if isinstance(self.item, LaneSignal) else self.item.lanes

    def light(self, time_s: float) -> Body | None:
        """What shines of it at a time of a clip; None if nothing does."""
        match self.item:
            case TrafficSignal(form=form):
                lit = head_light(self.place, form, self.item.state_at(time_s))
            case LaneSignal(state=state):
                lit = lane_light(self.place, state)
            case _:
                return None
        return lit if len(lit.corners_world) else None


def elements(ground: Ground, roadside: Roadside) -> list[TrafficElement]:
    """All traffic elements in the order of their instance ids."""
    found = []
    for crossing in roadside.crossings:
        places = lane_signal_places(ground, crossing)
        found += [
            TrafficElement(signal, place, lane_head_body(place))
            for signal, place in zip(crossing.signals, places, strict=True)
        ]
    for signal in roadside.signals:
        place = mounted(ground, signal)
        found.append(TrafficElement(signal, place, head_body(place)))
    found += [TrafficElement(sign, mounted(ground, sign), sign_body(ground, sign)) for sign in roadside.signs]
    return found
