"""The primitives of an OSM file as Lanelet2 uses them: points in metres, ways through them, relations between these."""

from collections import Counter
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import numpy as np

from synth3dlanes.roads.maps.document import inflated, number, parse_xml, passing_over
from synth3dlanes.roads.maps.utm import utm_from_degrees, zone_of
from synth3dlanes.system.arrays import Points3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import shown

LOCAL = ("local_x", "local_y")


@dataclass(frozen=True)
class OsmWay:
    """A line through nodes, by their ids."""

    nodes: tuple[str, ...]
    tags: dict[str, str]


@dataclass(frozen=True)
class OsmRelation:
    """A relation: its members as (type, id, role)."""

    members: tuple[tuple[str, str, str], ...]
    tags: dict[str, str]

    def of(self, role: str) -> list[str]:
        """The ids of the members of a role."""
        return [ref for _, ref, of in self.members if of == role]


@dataclass(frozen=True, eq=False)
class Osm:
    """A file. `xyz` are the places of its nodes in its local coordinates (the tags local_x, local_y) if all have these,
    else in those of UTM; `degrees` their latitude and longitude, NaN where the file has none; `arrows` the arrows of
    those that are lenses of lights. `left_out` counts what is broken."""

    rows: dict[str, int]
    xyz: Points3
    degrees: np.ndarray
    ways: dict[str, OsmWay]
    relations: dict[str, OsmRelation]
    arrows: dict[str, str] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)

    def points(self, way: str) -> Points3:
        """The points of a way. Raises FormatError for a way, or a node of it, that is not there."""
        if way not in self.ways:
            raise FormatError(f"expected way {shown(way)} to be there, got none")
        lost = [node for node in self.ways[way].nodes if node not in self.rows]
        if lost:
            raise FormatError(f"way {way}: expected node {shown(lost[0])} to be there, got none")
        return self.xyz[[self.rows[node] for node in self.ways[way].nodes]]


def read_osm(data: bytes, where: str) -> Osm:
    """The primitives in the bytes of a file, as they are or of gzip. Raises FormatError, with one line that begins with
    `where`, for another file and for one without points."""
    root = parse_xml(inflated(data, where), where)
    if root.tag != "osm":
        raise FormatError(f"{where}: expected an OSM file, got one of {shown(root.tag)}")
    left_out, rows, read = Counter[str](), dict[str, int](), list[tuple[float, ...]]()
    arrows = dict[str, str]()
    for node in root.iterfind("node"):
        with passing_over(node, left_out):
            place = _place(node)
            rows[node.get("id", "")] = len(read)
            read.append(place)
            arrows |= {node.get("id", ""): tag.get("v", "") for tag in node.iterfind("tag[@k='arrow']")}
    if not read:
        raise FormatError(f"{where}: expected nodes with places, got none")
    table = np.array(read, float)
    degrees, local = table[:, :2], table[:, 2:4]
    if np.isnan(local).any():
        known = ~np.isnan(degrees).any(axis=1)
        rows = {name: row for name, row in rows.items() if known[row]}
        left_out["nodes without a place"] += int((~known).sum())
        if not known.any():
            raise FormatError(f"{where}: expected nodes with lat and lon, or all with local_x and local_y, got neither")
        local = utm_from_degrees(degrees, zone_of(float(np.median(degrees[known, 1]))))
    ways = {
        way.get("id", ""): OsmWay(tuple(at.get("ref", "") for at in way.iterfind("nd")), _tags(way))
        for way in root.iterfind("way")
    }
    relations = {
        relation.get("id", ""): OsmRelation(
            tuple((at.get("type", ""), at.get("ref", ""), at.get("role", "")) for at in relation.iterfind("member")),
            _tags(relation),
        )
        for relation in root.iterfind("relation")
    }
    return Osm(rows, np.column_stack([local, table[:, 4]]), degrees, ways, relations, arrows, left_out)


def _place(node: Element) -> tuple[float, ...]:
    """Latitude, longitude, local x and y, and height of a node; NaN for what it lacks."""
    where, tags = f"node {node.get('id')}", {tag.get("k", ""): tag for tag in node.iterfind("tag")}
    given = [number(node, key, where, np.nan) for key in ("lat", "lon")]
    if abs(given[0]) > 89.9 or abs(given[1]) > 360:
        raise FormatError(f"{where}: expected a place on the earth, got {given}")
    local = [number(tags[key], "v", where) if key in tags else np.nan for key in LOCAL]
    height_m = number(tags["ele"], "v", where, 0.0) if "ele" in tags else number(node, "ele", where, 0.0)
    return (*given, *local, height_m)


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}
