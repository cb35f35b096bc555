"""Write OpenDRIVE: one file a scene, with its roads, their lanes and paint, and what stands beside them."""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.opendrive.convention import LANE_CHANGES, MAJOR, MARK_TYPES, MINOR, NO_NUMBER, USER_DATA
from synth3dlanes.formats.opendrive.map_write import opendrive_of_map
from synth3dlanes.formats.opendrive.marks import MIRRORED, Mark, marks
from synth3dlanes.formats.opendrive.objects import add_objects
from synth3dlanes.formats.opendrive.profiles import knots, pieces
from synth3dlanes.formats.opendrive.roads import JUNCTION, OdrLane, OdrRoad, roads
from synth3dlanes.formats.opendrive.xml import Element, add
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.world.world import World, resolve

# How far the written reference line, heights and widths (metres) and rolls (radians) may be from the world's.
LINE_M, HEIGHT_M, WIDTH_M, ROLL_RAD = 1e-3, 1e-3, 1e-3, 1e-4
# A road gets lateral shapes if its surface is farther than this from the banked plane. They are fitted at this many
# places across, to about this error.
SHAPE_M, SHAPE_PLACES = 0.005, 9

README = f"""OpenDRIVE {MAJOR}.{MINOR}: a map of each scene.

- `SPLIT/KEY.xodr`: the roads of the scene of this frame. Its coordinates are those of `world_from_cam` in the frame's
  labels (x, y on the ground, z up, metres), which so places the camera in the map.
- Roads are laid on the terrain by elevation, superelevation and, where the ground bends across the lanes, shape.
- `{USER_DATA}` in a lane's user data is the id of its segment in the lane graph of the labels.
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The map of the frame's scene."""
    text = opendrive(resolve(frame.scene), frame.key)
    return FrameAnnotation(None, text.count('type="driving"'), files={f"{frame.split}/{frame.key}.xodr": text})


def opendrive(world: World, name: str) -> str:
    """The OpenDRIVE file of a world; its inertial frame is the world frame."""
    if world.scene.map is not None:
        return opendrive_of_map(world, name)
    found = roads(world.network)
    numbers = {road.name: i for i, road in enumerate(found, 1)} | {JUNCTION: len(found) + 1}
    root = ElementTree.Element("OpenDRIVE")
    xy = np.concatenate([road.xy_world for road in found])
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    header = {"revMajor": MAJOR, "revMinor": MINOR, "name": name, "version": "1.00", "vendor": "synth3dlanes"}
    add(root, "header", **header, north=north, south=south, east=east, west=west)
    elements = [_add_road(root, world, road, found, numbers) for road in found]
    add_objects(world, found, elements)
    if any(road.in_junction for road in found):
        _add_junction(root, world, found, numbers)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_road(root: Element, world: World, road: OdrRoad, found: list[OdrRoad], numbers: Mapping[str, int]) -> Element:
    by_name = {other.name: other for other in found}
    length = float(road.s_m[-1])
    of = {"junction": str(numbers[JUNCTION]) if road.in_junction else NO_NUMBER}
    rule = "LHT" if road.is_left_hand else "RHT"
    element = add(root, "road", name=road.name, length=length, id=str(numbers[road.name]), **of, rule=rule)
    link = add(element, "link")
    for tag, other in (("predecessor", road.before), ("successor", road.after)):
        if other == JUNCTION:
            add(link, tag, elementType="junction", elementId=str(numbers[JUNCTION]))
        elif other:
            is_end = (tag == "predecessor") == (road.is_oncoming == by_name[other].is_oncoming)
            touched = {"contactPoint": "end" if is_end else "start"}
            add(link, tag, elementType="road", elementId=str(numbers[other]), **touched)
    _add_line(element, road)
    profile = add(element, "elevationProfile")
    for piece in pieces(road.s_m, road.elevation_m[:, None], HEIGHT_M):
        add(profile, "elevation", s=piece.s, **_abcd(piece.abcd[:, 0]))
    lateral = add(element, "lateralProfile")
    for piece in pieces(road.s_m, road.roll_rad[:, None], ROLL_RAD):
        add(lateral, "superelevation", s=piece.s, **_abcd(piece.abcd[:, 0]))
    _add_shapes(lateral, road)
    lanes = add(element, "lanes")
    for piece in pieces(road.s_m, road.center_m[:, None], WIDTH_M):
        add(lanes, "laneOffset", s=piece.s, **_abcd(piece.abcd[:, 0]))
    section = add(lanes, "laneSection", s=0.0)
    found_marks = marks(world, road)
    sides = {"left": 1, "center": 0, "right": -1}
    for tag, side in sides.items():
        on_side = [lane for lane in road.lanes if np.sign(lane.number) == side]
        if side == 0:
            center = add(add(section, tag), "lane", id="0", type="none", level="false")
            _add_marks(center, 0, found_marks[0])
        elif on_side:
            group = add(section, tag)
            for lane in on_side:
                _add_lane(group, road, lane, found_marks[lane.number], world, by_name)
    return element


def _add_line(element: Element, road: OdrRoad) -> None:
    view = add(element, "planView")
    for piece in pieces(road.s_m, road.xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0], piece.abcd[1]
        heading = float(np.arctan2(dy, dx))
        to_local = np.array([[dx, -dy], [dy, dx]])
        (_, _, c_u, d_u), (_, _, c_v, d_v) = (piece.abcd @ to_local).T
        length = piece.end - piece.s
        geometry = add(view, "geometry", s=piece.s, x=x, y=y, hdg=heading, length=length)
        u = {"aU": 0.0, "bU": 1.0, "cU": c_u, "dU": d_u}
        v = {"aV": 0.0, "bV": 0.0, "cV": c_v, "dV": d_v}
        add(geometry, "paramPoly3", **u, **v, pRange="arcLength")


def _add_shapes(lateral: Element, road: OdrRoad) -> None:
    edges = [t for lane in road.lanes for t in (lane.inner_m, lane.outer_m)]
    low, high = np.min(edges, axis=0), np.max(edges, axis=0)
    shares = np.linspace(0, 1, SHAPE_PLACES)
    # Shapes are heights along e_h.
    over = np.column_stack([road.over_plane(low + (high - low) * share) * road.axes[:, 2, 2] for share in shares])
    if np.abs(over).max() <= SHAPE_M:
        return
    for i in knots(road.s_m, over, SHAPE_M):
        abcd = np.linalg.lstsq(np.vander((high[i] - low[i]) * shares, 4, increasing=True), over[i], rcond=None)[0]
        add(lateral, "shape", s=road.s_m[i], t=low[i], **_abcd(abcd))


def _add_lane(
    group: Element, road: OdrRoad, lane: OdrLane, found: list[Mark], world: World, by_name: Mapping[str, OdrRoad]
) -> None:
    element = add(group, "lane", id=str(lane.number), type=lane.kind, level="false")
    link = add(element, "link")
    # Lanes that lead into a junction are linked there.
    for tag, other in (("predecessor", road.before), ("successor", road.after)):
        number = _number_in(by_name[other], world, road, lane) if other and other != JUNCTION else None
        if number is not None:
            add(link, tag, id=str(number))
    width = np.abs(lane.outer_m - lane.inner_m)
    for piece in pieces(road.s_m, width[:, None], WIDTH_M):
        add(element, "width", sOffset=piece.s, **_abcd(piece.abcd[:, 0]))
    _add_marks(element, lane.number, found)
    if lane.segment:
        add(element, "userData", code=USER_DATA, value=lane.segment)


def _add_marks(element: Element, number: int, found: list[Mark]) -> None:
    for mark in found:
        from_inside = MIRRORED.get(mark.kind, mark.kind) if number > 0 else mark.kind
        kind, width = MARK_TYPES[from_inside], {"width": mark.total_width_m}
        common = {"type": kind, "weight": "standard", "color": mark.color}
        change = LANE_CHANGES.get(mark.kind, "none")
        entry = add(element, "roadMark", sOffset=mark.s_m, **common, **width, laneChange=change)
        if mark.stripes:
            lines = add(entry, "type", name=kind, **width)
        for t_m, (dash_m, gap_m, first_m) in mark.stripes.items():
            places = {"tOffset": t_m, "sOffset": first_m, "width": mark.width_m}
            add(lines, "line", length=dash_m, space=gap_m, **places, color=mark.color)


def _number_in(other: OdrRoad, world: World, road: OdrRoad, lane: OdrLane) -> int | None:
    """The number that a lane of a connecting road has in the road at its end."""
    if lane.segment is None:
        sign = 1 if other.is_oncoming == road.is_oncoming else -1
        return next((n.number for n in other.lanes if n.kind == lane.kind and sign * n.number * lane.number > 0), None)
    network = world.network
    segments = {lane.segment} | {joined.id for joined in network.joined_to(network.lanes[lane.segment])}
    return next(there.number for there in other.lanes if there.segment in segments)


def _add_junction(root: Element, world: World, found: list[OdrRoad], numbers: Mapping[str, int]) -> None:
    junction = add(root, "junction", name=JUNCTION, id=str(numbers[JUNCTION]), type="default")
    by_name = {road.name: road for road in found}
    for count, road in enumerate(road for road in found if road.in_junction):
        incoming = by_name[str(road.before)]
        ids = {"incomingRoad": str(numbers[incoming.name]), "connectingRoad": str(numbers[road.name])}
        connection = add(junction, "connection", id=str(count), **ids, contactPoint="start")
        for lane in road.driving:
            ends = {"from": str(_number_in(incoming, world, road, lane)), "to": str(lane.number)}
            add(connection, "laneLink", **ends)


def _abcd(coefficients: Float[np.ndarray, "4"]) -> dict[str, float]:
    return dict(zip("abcd", coefficients.tolist(), strict=True))
