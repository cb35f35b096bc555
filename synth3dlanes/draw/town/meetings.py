"""Who comes to which crosswalk of a town in a clip. World frame, metres and seconds."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.crossing import Crosser
from synth3dlanes.draw.draws import DrawsOf
from synth3dlanes.draw.town.drive import CrosswalkKey
from synth3dlanes.draw.town.layout import TownMap
from synth3dlanes.draw.town.paint import CROSSWALK_M
from synth3dlanes.draw.town.rules import LightGroup
from synth3dlanes.system.arrays import Points2

# Crosswalks farther from the host's way in the clip are left out; people keep this far from a crosswalk's sides.
MAX_FROM_HOST_M, INSIDE_M = 55.0, 0.4


class Meeting(NamedTuple):
    """Somebody at a crosswalk, and the lights of the lanes that lead across it."""

    key: CrosswalkKey
    crosser: Crosser
    groups: tuple[LightGroup, ...]


def draw_meetings(town_map: TownMap, host_places: Points2, of: DrawsOf, duration_s: float) -> Iterator[Meeting]:
    """Who comes to the crosswalks near the host, each on a strip of its own."""
    people = of("people")
    people("per_100_m")
    n, own = people("crossing"), of("people", "people_crossing")
    for rules in town_map.junctions if town_map.town.has_crosswalks else ():
        for number, arm in enumerate(rules.junction.arms):
            near_m, far_m = CROSSWALK_M
            middle = arm.pose.moved((near_m + far_m) / 2)
            if np.linalg.norm(host_places - [middle.x, middle.y], axis=1).min() > MAX_FROM_HOST_M:
                continue
            has_signals = rules.control == "signals" and not rules.junction.is_roundabout
            groups = {rules.group(number, lane.key) for lane in arm.lanes(incoming=True)} if has_signals else set()
            for i in range(n):
                speed_m_s, (from_left, at, share) = own("speed_m_s"), own.rng.random(3).tolist()
                strip = (i + 0.4 + 0.2 * at) / n
                ahead_m = near_m + INSIDE_M + strip * (far_m - near_m - 2 * INSIDE_M)
                kerbs = [arm.pose.moved(ahead_m, arm.cross.edge(side)) for side in ("left", "right")]
                places = np.array([(pose.x, pose.y) for pose in kerbs])
                places = places if from_left < 0.5 else places[::-1]
                yield Meeting(
                    (rules.junction.id, number),
                    Crosser.draw(places, speed_m_s, share, duration_s),
                    tuple(sorted(groups)),
                )
