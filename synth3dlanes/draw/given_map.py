"""The maker of given maps: the host's place on one, and what its file says of what stands there. World frame,
metres."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.draws import SCENE_DECIMALS, DrawsOf
from synth3dlanes.draw.given_standing import map_trees, stand
from synth3dlanes.draw.makers import Roads, draw_camera, first_shot, map_roads
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_map import route_way
from synth3dlanes.roads.maps.given_map import GivenMap
from synth3dlanes.roads.maps.part import MapPart, part_around
from synth3dlanes.roads.maps.places import MapStation, draw_place, read_place
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Scene, Tree
from synth3dlanes.system.streams import stream
from synth3dlanes.world.ground import Ground


class MapPlace(NamedTuple):
    """A map file, and a place on it for all scenes; None where each scene has one of its own."""

    map: GivenMap
    at: MapStation | None = None

    def draw(self, rng: np.random.Generator) -> MapPart:
        """The part of the map around the place, or around one that is drawn."""
        return part_around(self.map, self.at or draw_place(self.map, rng), rng)

    def roads(self, of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
        """The maker of a given map: a place on it with what its file says of what stands there."""
        shot, part = first_shot(shots, of("motion")), self.draw(stream(*of.drawn, "map"))
        camera = draw_camera(of("camera"), 1, host_length(part))

        def beside(scene: Scene, ground: Ground) -> Roadside:
            return stand(part, scene, ground, of("roadside", "map_standing"))

        def grow(scene: Scene, ground: Ground, trees: tuple[Tree, ...]) -> tuple[Tree, ...]:
            return (*trees, *map_trees(part, scene, ground, of("trees", "map_trees")))

        return replace(map_roads(of, part.map, camera, shot, beside), grow=grow, has_to_fit=False)

    def description(self) -> dict[str, object]:
        """The part of `dataset.json` that says which map."""
        at = {} if self.at is None else {"at": {"lane": self.at.lane, "s_m": self.at.s_m}}
        return {"file": self.map.source, "digest": self.map.digest, **at}


def place_on_map(path: Path, at: str = "") -> MapPlace:
    """The map in a file, with the place that `at` (ROAD:s:lane) says, if any. Raises InputError or FormatError in one
    line for another file, a place that is not there, and a map on which no host has a place."""
    given = read_map(path)
    place = MapPlace(given, read_place(given, at) if at else None)
    # Refused here, not once for each scene.
    place.draw(stream(0, "map", 0, "map"))
    return place


def host_length(part: MapPart) -> float:
    """How far the host is along the middle of the lanes of its route, seen from above."""
    return round(float(route_way(part.map).pieces[part.lane].stations(part.s_m)), SCENE_DECIMALS)
