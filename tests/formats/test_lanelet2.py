"""Lanelet2 maps of scenes, read by rules of the format alone: shared bounds, lane changes, what follows what, rules."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, draw_world, sample_world
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.format import ReadFrame
from synth3dlanes.formats.lanelet2 import lanelet2, verify
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.labels import Lane as Line
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.osm import read_osm
from synth3dlanes.roads.maps.utm import degrees_from_utm, utm_from_degrees, zone_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.world import World
from tests.thorough import first

PLAIN = ("trees.n=0", "town.fronts=0", "town.traffic=0", "town.n_more=0")
SIGNALS = ("town.junction=crossing", "town.control=signals", "town.turn_lanes=both", "town.n_lanes=2", *PLAIN)
RINGS = ("town.junction=roundabout", "town.n_lanes=2", *PLAIN)
SEGMENT = "synth3dlanes.segment"


@dataclass
class Lane:
    """A lanelet of a file, its ways as the file has them, and its bounds from left and right as their ways go."""

    id: str
    tags: dict[str, str]
    left: str
    right: str
    rules: list[str]


class File:
    """A file as its text says, without help of the package."""

    def __init__(self, text: str) -> None:
        root = ElementTree.fromstring(text)
        self.nodes = {node.get("id"): (node, self.tags(node)) for node in root.iterfind("node")}
        self.ways = {
            way.get("id"): ([at.get("ref") for at in way.iterfind("nd")], self.tags(way))
            for way in root.iterfind("way")
        }
        self.relations = {
            relation.get("id"): (
                [(at.get("type"), at.get("ref"), at.get("role")) for at in relation.iterfind("member")],
                self.tags(relation),
            )
            for relation in root.iterfind("relation")
        }
        self.ids = [element.get("id") for element in root if element.tag != "MetaInfo"]
        self.lanes = [
            Lane(name, tags, *(next(ref for _, ref, of in members if of == side) for side in ("left", "right")),
                 [ref for _, ref, of in members if of == "regulatory_element"])
            for name, (members, tags) in self.relations.items() if tags["type"] == "lanelet"
        ]  # fmt: skip

    @staticmethod
    def tags(element: ElementTree.Element) -> dict[str, str]:
        return {str(tag.get("k")): str(tag.get("v")) for tag in element.iterfind("tag")}

    def points(self, way: str) -> np.ndarray:
        return np.array([[float(self.nodes[node][1][key]) for key in ("local_x", "local_y", "ele")]
                         for node in self.ways[way][0]])  # fmt: skip

    def bounds(self, lane: Lane) -> tuple[list[str], list[str]]:
        """The nodes of both bounds as traffic drives: of the ways in their own direction, or both turned."""
        left, right = self.ways[lane.left][0], self.ways[lane.right][0]
        a, b = self.points(lane.left)[:, :2], self.points(lane.right)[:, :2]
        if np.hypot(*(a[0] - b[0])) + np.hypot(*(a[-1] - b[-1])) > np.hypot(*(a[0] - b[-1])) + np.hypot(
            *(a[-1] - b[0])
        ):
            right, b = right[::-1], b[::-1]
        ring = np.concatenate([b, a[::-1]]) - b[0]
        area = float(np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1)))
        # With the right bound first the way around is counter-clockwise.
        return (left, right) if area > 0 else (left[::-1], right[::-1])

    def middle(self, lane: Lane) -> np.ndarray:
        left, right = (
            np.array([[float(self.nodes[node][1][key]) for key in ("local_x", "local_y", "ele")] for node in nodes])
            for nodes in self.bounds(lane)
        )
        return (
            (left + right) / 2 if len(left) == len(right) else np.array([left[0] + right[0], left[-1] + right[-1]]) / 2
        )

    def rules(self, subtype: str) -> dict[str, list[tuple[str, str, str]]]:
        return {
            name: members for name, (members, tags) in self.relations.items()
            if tags["type"] == "regulatory_element" and tags["subtype"] == subtype
        }  # fmt: skip


WORLDS: dict[str, Callable[[], World]] = {
    "exit": lambda: sample_world(Scenes(load_params("appendix_i"), 7, "round"), 1),
    "lights": lambda: draw_world(Scenes(load_params("town", SIGNALS), 5), 1),
    "roundabout": lambda: draw_world(Scenes(load_params("town", RINGS), 5), 1),
    "streets": lambda: sample_world(Scenes(load_params("streets"), 5, "round"), 1),
    "town": lambda: sample_world(Scenes(load_params("town"), 6, "round"), 3),
}


@cache
def made(name: str) -> tuple[World, str, File]:
    world = WORLDS[name]()
    text, lost = lanelet2(world)
    assert lost == 0
    return world, text, File(text)


every_world = pytest.mark.parametrize("name", first(1, WORLDS))


@every_world
def test_a_lane_follows_another_as_in_the_lane_graph_and_through_no_other_ends(name: str) -> None:
    world, _, file = made(name)
    lanes = [lane for lane in file.lanes if SEGMENT in lane.tags]
    ends = {lane.id: [(side[0], side[-1]) for side in file.bounds(lane)] for lane in lanes}
    found, inner = set(), 0
    for one in lanes:
        for other in lanes:
            if all(a[1] == b[0] for a, b in zip(ends[one.id], ends[other.id], strict=True)):
                pair = one.tags[SEGMENT], other.tags[SEGMENT]
                inner += pair[0] == pair[1] and pair not in world.network.links
                found.add(pair)
    named = {lane.tags[SEGMENT] for lane in lanes}
    assert named == set(world.network.lanes)
    assert {pair for pair in found if pair[0] != pair[1]} == {
        pair for pair in world.network.links if pair[0] != pair[1]
    }
    assert inner == len(lanes) - len(named)


@every_world
def test_middles_of_lanelets_are_the_lanes_in_3d_in_the_direction_of_traffic(name: str) -> None:
    world, _, file = made(name)
    for lane in (lane for lane in file.lanes if SEGMENT in lane.tags):
        own = world.network.lanes[lane.tags[SEGMENT]]
        road = world.network.road(own.road).stretch_of(own)
        ends = np.nan_to_num([own.start_m, own.end_m], neginf=-250, posinf=250)
        s = np.linspace(*ends, 20_000)[:: 1 if own.ascends else -1]
        apart_m, at = cKDTree(road.points(s, own.middle(s))).query(file.middle(lane)[1:-1] if len(file.middle(lane)) > 2
                                                                  else file.middle(lane))  # fmt: skip
        assert apart_m.max(initial=0.0) < (0.02 if len(file.middle(lane)) > 2 else 0.2), lane
        assert (np.diff(at) >= 0).all(), f"{lane}: expected points as traffic drives"


@every_world
def test_neighbours_share_a_bound_and_change_lanes_where_the_paint_is_dashed(name: str) -> None:
    world, _, file = made(name)
    network = world.network
    segments = network.graph([path.id for path in network.paths]).segments
    beside = {segment.id: network.neighbours(segment) for segment in segments}
    dashed, solid = [], []
    for line in network.delimiters:
        ends = (0.0, line.end_m) if line.pieces[0].knots is not None else np.clip([line.start_m, line.end_m], -260, 260)
        points = line.points_world(np.linspace(*ends, 2 + int(20 * (ends[1] - ends[0]))))
        (dashed if line.marking == "dashed" else solid).append(points)
    trees = {kind: cKDTree(np.concatenate(parts)) for kind, parts in (("dashed", dashed), ("solid", solid)) if parts}
    rights = {(lane.right, file.bounds(lane)[1][0]): lane for lane in file.lanes}
    n_shared = 0
    for lane in (lane for lane in file.lanes if SEGMENT in lane.tags):
        left_nodes = file.bounds(lane)[0]
        other = rights.get((lane.left, left_nodes[0]))
        tags, points = file.ways[lane.left][1], file.points(lane.left)[1:-1]
        if len(points) and "pair" not in str(tags):
            on = {kind for kind, tree in trees.items() if np.mean(tree.query(points)[0] < 0.06) > 0.95}
            painted = tags["type"] in ("line_thin", "line_thick")
            assert painted == bool(on), (lane, tags)
            if painted and tags["subtype"] in ("solid", "solid_solid", "dashed"):
                is_dashed = tags["subtype"] == "dashed"
                # Where a turn lane opens, its line begins on another.
                assert ("dashed" if is_dashed else "solid") in on
                assert tags["lane_change"] == ("yes" if is_dashed else "no")
        if other is not None and network.lanes[lane.tags[SEGMENT]].junction is None:
            n_shared += 1
            assert beside[lane.tags[SEGMENT]][0] == other.tags[SEGMENT]
            assert beside[other.tags[SEGMENT]][1] == lane.tags[SEGMENT]
    assert n_shared or not any(name for pair in beside.values() for name in pair)


@every_world
def test_places_by_degrees_and_by_local_coordinates_are_one(name: str) -> None:
    """What readers by UTM and Autoware's local projector take."""
    _, _, file = made(name)
    degrees = np.array([[float(node.get("lat")), float(node.get("lon"))] for node, _ in file.nodes.values()])
    local = np.array([[float(tags[key]) for key in ("local_x", "local_y")] for _, tags in file.nodes.values()])
    origin = utm_from_degrees(np.array([[49.0, 9.0]]), 32)
    assert np.abs(utm_from_degrees(degrees, 32) - origin - local).max() < 1e-5


# Of the package lanelet2 1.2.3: UtmProjector(Origin(49, 9)).reverse, and UtmProjector.forward without an offset.
OF_LANELET2 = (
    ((100.0, -200.0), (48.998200868307784, 9.0013671444742)),
    ((-731.25, 912.5), (49.00820806097958, 8.990000752745646)),
    ((20000.0, 15000.0), (49.13460712761047, 9.274178506929973)),
    ((-150000.0, 80000.0), (49.70092100570398, 6.919790092107389)),
)


@pytest.mark.parametrize(("local", "degrees"), OF_LANELET2)
def test_degrees_are_those_of_the_projector_of_lanelet2(
    local: tuple[float, float], degrees: tuple[float, float]
) -> None:
    utm = utm_from_degrees(np.array([[49.0, 9.0]]), 32) + local
    assert np.abs(degrees_from_utm(utm, 32) - degrees).max() < 1e-11
    assert np.abs(utm_from_degrees(np.array([degrees]), 32) - utm).max() < 1e-6


def test_utm_of_a_place_far_from_the_middle_of_its_zone() -> None:
    found = utm_from_degrees(np.array([[35.68123456, 139.7671234]]), zone_of(139.7671234))
    assert np.abs(found - [388435.54033919127, 3949293.820246137]).max() < 1e-6


@every_world
def test_every_reference_leads_somewhere_and_ids_differ(name: str) -> None:
    _, text, file = made(name)
    assert len(set(file.ids)) == len(file.ids)
    assert all(node in file.nodes for nodes, _ in file.ways.values() for node in nodes)
    known = {"way": file.ways, "relation": file.relations}
    assert all(ref in known[kind] for members, _ in file.relations.values() for kind, ref, _ in members)
    used = {ref for members, _ in file.relations.values() for _, ref, role in members if role == "regulatory_element"}
    assert used == {name for name, (_, tags) in file.relations.items() if tags["type"] == "regulatory_element"}
    assert lanelet2(WORLDS[name]())[0] == text


@every_world
def test_lanelets_have_what_autoware_asks_of_them(name: str) -> None:
    """Of its map validator: road_lanelet_attribute, lanelet_geometry, turn_direction, local_coordinates_declaration."""
    world, _, file = made(name)
    for lane in file.lanes:
        left, right = file.bounds(lane)
        assert not {*left} & {*right}
        assert len({*left}) >= len(left) - 1
        if lane.tags["subtype"] == "road":
            assert lane.tags["one_way"] == "yes"
            assert lane.tags["location"] == ("nonurban" if world.scene.map is None else "urban")
            assert lane.tags["participant:vehicle"] == "yes"
            is_connector = world.network.lanes[lane.tags[SEGMENT]].junction is not None
            assert lane.tags.get("turn_direction") in (("left", "right", "straight") if is_connector else (None,))
        else:
            assert (lane.tags["subtype"], lane.tags["participant:pedestrian"]) == ("crosswalk", "yes")
    assert all({"local_x", "local_y", "ele"} <= {*tags} for _, tags in file.nodes.values())
    signs = [tags["subtype"] for _, tags in file.ways.values() if tags["type"] == "traffic_sign"]
    assert all(re.fullmatch(r"de\d{3}(-\d+)?", sign) for sign in signs), signs


def test_a_connector_to_the_left_turns_left() -> None:
    _, _, file = made("lights")
    turns = {"left": 1.0, "straight": 0.0, "right": -1.0}
    seen = set()
    for lane in file.lanes:
        if turn := lane.tags.get("turn_direction"):
            middle = file.middle(lane)[:, :2]
            ahead, leaves = middle[1] - middle[0], middle[-1] - middle[-2]
            side = (ahead[0] * leaves[1] - ahead[1] * leaves[0]) / np.linalg.norm(ahead) / np.linalg.norm(leaves)
            assert abs(side - turns[turn]) < 0.6, lane
            seen.add(turn)
    assert seen == set(turns)


def test_lights_are_rules_of_the_lanes_that_they_govern_with_stop_lines_and_bulbs() -> None:
    world, _, file = made("lights")
    rules = file.rules("traffic_light")
    governed = {lane for signal in world.scene.roadside.signals for lane in signal.lanes}
    by_rule = {rule: lane for lane in file.lanes for rule in lane.rules}
    assert {by_rule[rule].tags[SEGMENT] for rule in rules} == governed
    for rule, members in rules.items():
        kinds = {role: [ref for _, ref, of in members if of == role] for role in ("refers", "ref_line", "light_bulbs")}
        (stop,) = kinds["ref_line"]
        assert file.ways[stop][1]["type"] == "stop_line"
        assert (
            len(kinds["refers"])
            == len(kinds["light_bulbs"])
            == sum(by_rule[rule].tags[SEGMENT] in signal.lanes for signal in world.scene.roadside.signals)
        )
        lane = file.middle(by_rule[rule])
        ahead = (lane[-1] - lane[0])[:2] / np.linalg.norm((lane[-1] - lane[0])[:2])
        assert np.linalg.norm(file.points(stop).mean(axis=0) - lane[-1]) < 10
        for light, bulbs in zip(kinds["refers"], kinds["light_bulbs"], strict=True):
            left, right = file.points(light)
            # Seen from the lane, the first point is on the left.
            assert (right - left)[:2] @ [ahead[1], -ahead[0]] > 0
            tags = file.ways[light][1]
            assert (tags["type"], tags["subtype"]) == ("traffic_light", "red_yellow_green")
            assert 0.5 < float(tags["height"]) < 1.5
            assert file.ways[bulbs][1]["traffic_light_id"] == light
            assert [file.nodes[node][1]["color"] for node in file.ways[bulbs][0]] == ["red", "yellow", "green"]
            up = file.points(bulbs)[:, 2] - left[2]
            assert float(tags["height"]) > up[0] > up[1] > up[2] > 0


@pytest.mark.parametrize("name", first(0, ["roundabout", "town"]))
def test_right_of_way_is_that_of_the_map(name: str) -> None:
    world, _, file = made(name)
    assert world.scene.map is not None
    wanted = {pair for at in world.scene.map.junctions for pair in at.yields if {*pair} <= set(world.network.lanes)}
    lane_of = {lane.id: lane.tags.get(SEGMENT) for lane in file.lanes}
    found = {
        (lane_of[one], lane_of[other])
        for members in file.rules("right_of_way").values()
        for _, one, role in members if role == "yield"
        for _, other, of in members if of == "right_of_way"
    }  # fmt: skip
    assert found == wanted
    assert found


@pytest.mark.thorough
def test_signs_of_speed_limits_are_known_to_the_lanes_ahead_of_them() -> None:
    world, _, file = made("town")
    limits = {lane for sign in world.scene.roadside.signs if sign.kind.startswith("speed_") for lane in sign.lanes}
    assert limits
    told = {lane.tags[SEGMENT]: lane.tags["speed_limit"] for lane in file.lanes if "speed_limit" in lane.tags}
    assert set(told) <= limits
    for rule, members in file.rules("speed_limit").items():
        (sign,) = (ref for _, ref, role in members if role == "refers")
        limit = file.ways[sign][1]["subtype"].removeprefix("de274-")
        assert {lane.tags["speed_limit"] for lane in file.lanes if rule in lane.rules} <= {limit}


@pytest.mark.thorough
def test_crosswalks_are_lanelets_of_walkers_with_the_outline_of_the_paint() -> None:
    world, _, file = made("town")
    ours = [form for form in world.symbol_shapes if form.kind == "crosswalk"]
    found = [lane for lane in file.lanes if lane.tags["subtype"] == "crosswalk"]
    assert len(found) == len(ours) > 0
    for lane in found:
        corners = np.concatenate([file.points(way)[[0, -1]] for way in (lane.left, lane.right)])
        apart = []
        for form in ours:
            (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            own = form.points_world(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
            apart.append(np.linalg.norm(corners[:, None] - own, axis=2).min(axis=1).max())
        assert min(apart) < 0.001
        # People walk along the longer sides.
        left, right = file.points(lane.left), file.points(lane.right)
        assert np.linalg.norm(left[-1] - left[0]) > np.linalg.norm(left[0] - right[0])


class InPieces(SourceSample):
    """A world's labels, their painted lines in pieces of some ten metres, as where a map has short marks."""

    def __init__(self, world: World) -> None:
        self.world = world

    @property
    def scene(self) -> Scene:
        return self.world.scene

    @cached_property
    def labels(self) -> Labels:
        whole = ground_truth(self.scene)
        return replace(whole, lanes=tuple(piece for lane in whole.lanes for piece in self._pieces(lane)))

    @staticmethod
    def _pieces(lane: Line) -> list[Line]:
        ends = [*range(0, len(lane.xyz_cam) - 20, 20), len(lane.xyz_cam) - 1]
        if lane.kind != "delimiter" or len(ends) < 2:
            return [lane]
        parts = (slice(first, last + 1) for first, last in pairwise(ends))
        fields = ({key: getattr(lane, key)[at] for key in ("xyz_cam", "in_image", "terrain_visible")} for at in parts)
        return [replace(lane, id=f"{lane.id}{i}", object_visible=None, **own) for i, own in enumerate(fields)]


def test_a_bound_along_painted_lines_after_each_other_has_no_false_alarm() -> None:
    world, text, _ = made("lights")
    frame = ReadFrame("lights.osm", "lights.osm", None, read_osm(text.encode(), "lights.osm"))
    assert verify(frame, InPieces(world)).problems == ()
