"""The documented rules (docs/params.md) that change declared distributions: rules of weather, of topology, of roads
without oncoming lanes, and of the number of lanes."""

from collections.abc import Callable, Mapping
from typing import Any

from synth3dlanes.params.distributions import Choice, Distribution, Integers, Uniform, at_least, at_most, extent
from synth3dlanes.params.groups import DAYTIMES, KINDS
from synth3dlanes.params.params import Params
from synth3dlanes.roads.from_paper import is_wide_enough
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.scene import MIN_MEDIAN_M, PaperRoad, Scene
from synth3dlanes.scene.town import ROUNDABOUTS, Town

# Parameters of which the rules keep only the range, with the reason.
CONDITIONED = {
    "cars.s_m": "kept apart",
    "trees.x_m": "kept off roads",
    "trees.y_m": "kept off roads",
}
NO_MEDIAN: Choice[float] = Choice((0.0,), (1.0,))
Rules = dict[str, Distribution | None]


def lanes_of(declared: Integers | Choice[int], topology: int) -> Integers | Choice[int]:
    """The number of lanes on a road of this topology: at least two where a lane of the main road leaves or joins."""
    return at_least(declared, 2) if topology > 2 else declared


def lane_of_host(declared: Integers | Choice[int], present: int) -> Integers | Choice[int]:
    """The host's lane among those present: those asked for, or the last one if none of them is."""
    if isinstance(declared, Integers):
        return Integers(min(declared.low, present), min(declared.high, present))
    return at_most(declared, present)


def median_of(declared: Uniform | Choice[float], n_oncoming: int) -> Uniform | Choice[float] | None:
    """The median beside this many oncoming lanes: none without them, or where it would be narrower than MIN_MEDIAN_M.
    None where the rules leave a part of a range."""
    if n_oncoming == 0:
        return NO_MEDIAN
    if isinstance(declared, Choice):
        return declared.mapped(lambda width_m: width_m if width_m >= MIN_MEDIAN_M else 0.0)
    if declared.high < MIN_MEDIAN_M:
        return NO_MEDIAN
    return declared if declared.low >= MIN_MEDIAN_M else None


class ParameterRules:
    """The distributions that parameters have in a scene, by `group.key`."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self._by_weather: dict[tuple[str, str], dict[str, Distribution]] = {}
        # By the part of a scene that brings rules of its own.
        self._of_part: dict[str, Callable[[Rules, Scene, Any], Rules]] = {
            "road": self._of_road,
            "map": self._of_map,
            "town": self._of_town,
        }

    def of(self, scene: Scene) -> Mapping[str, Distribution | None]:
        """The distribution of every parameter in scenes with the weather, the topology and the lanes of this one; None
        where the rules leave only its range, no key where it is not used."""
        found: Rules = dict(self._under(scene.weather.kind, scene.weather.daytime))
        params = self.params
        found |= dict.fromkeys(CONDITIONED)
        if "sold" in params.cars.palette.values:
            del found["cars.color"], found["cars.saturation"]  # not drawn from these keys
        for part, rules in self._of_part.items():
            own = getattr(scene, part)
            found = found if own is None else rules(found, scene, own)
        return found

    def _of_road(self, found: Rules, scene: Scene, road: PaperRoad) -> Rules:
        """The rules of the paper's road, whose lanes, room and works bound what is drawn."""
        params = self.params
        found["road.n_lanes"] = lanes_of(params.road.n_lanes, road.topology)
        if not self._has_room(road):
            found |= {"road.n_oncoming": None, "road.median_m": None}
        else:
            found["road.median_m"] = median_of(params.road.median_m, road.n_oncoming)
        found["camera.lane"] = lane_of_host(params.camera.lane, road.lanes_present(scene.camera.y_m))
        if (scene.shot.n_frames > 1 and road.topology > 2) or road.works is not None:
            # A host whose lane leaves its road gets the lane beside it, and along works lanes have other numbers.
            found["camera.lane"] = None
        return found

    def _of_map(self, found: Rules, scene: Scene, roads: RoadMap) -> Rules:
        """The rules of a map, which has no such road; cars for which there is no room are left out."""
        unused = ("road.", "symbols.", "camera.lane", "camera.y_m", "cars.s_m")
        return {key: form for key, form in found.items() if not key.startswith(unused)} | {"cars.n": None}

    def _of_town(self, found: Rules, scene: Scene, town: Town) -> Rules:
        """The rules of a town: lanes and control are as its junction allows."""
        unused = {"cars.n", "trees.n", "trees.model", "trees.x_m", "trees.y_m"}
        found["cars.model"] = None  # those that turn or park are short
        declared = self.params.town
        if town.junction in ROUNDABOUTS:
            unused |= {"town.n_lanes", "town.turn_lanes", "town.control"}
        elif town.control == "equal":
            unused.add("town.turn_lanes")
        elif town.n_lanes > 1:
            found["town.control"] = None  # only streets of one lane are equal
        found = {key: form for key, form in found.items() if key not in unused and not key.startswith("motion.")}
        found["town.n_side"] = at_most(declared.n_side, town.n_lanes)
        return found

    def _under(self, kind: str, daytime: str) -> dict[str, Distribution]:
        """The distributions in this weather at this time of day; the weather's own are as declared."""
        if (kind, daytime) not in self._by_weather:
            changed = self.params.under(kind, daytime).groups
            self._by_weather[kind, daytime] = {
                f"{name}.{key}": form
                for name, group in changed.items()
                if name not in {*KINDS, *DAYTIMES} - {kind, daytime}
                for key, form in group
            }
        return self._by_weather[kind, daytime]

    def _has_room(self, road: PaperRoad) -> bool:
        """Whether the bends of a road have room for the most oncoming lanes and the widest median declared: then none
        were left out."""
        declared = self.params.road
        widest = {"n_oncoming": extent(declared.n_oncoming)[1], "median_m": extent(declared.median_m)[1]}
        return not widest["n_oncoming"] or is_wide_enough(road.model_copy(update=widest))
