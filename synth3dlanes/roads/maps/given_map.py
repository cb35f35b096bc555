"""GivenMap: what a map file has of roads, junctions and paint, and what is left out; OpenDRIVE files as such. Map
frame, metres."""

import hashlib
import math
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Int
from pydantic import ValidationError

from synth3dlanes.roads.maps.cubics import SAME_M, Profile, is_zero, part, read_cubics, steepened, value
from synth3dlanes.roads.maps.document import inflated, number, parse_xml, passing_over
from synth3dlanes.roads.maps.elements import (
    FileRoad,
    GivenBody,
    GivenElement,
    GivenRail,
    read_bodies,
    read_elements,
    read_rails,
)
from synth3dlanes.roads.maps.furniture import drop_beyond, edges_at, read_furniture
from synth3dlanes.roads.maps.jumps import divided
from synth3dlanes.roads.maps.lanes import Section, read_sections, widened
from synth3dlanes.roads.maps.links import LinkedRoad, lane_links, read_end
from synth3dlanes.roads.maps.plan import places, read_plan
from synth3dlanes.scene.road_map import (
    LaneName,
    MapIsland,
    MapJunction,
    MapLane,
    MapPaint,
    MapRoad,
    MapSection,
    MapShape,
    MapSpan,
    Polynomial,
    lane_key,
)
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import MAX_NUMBER, Name, shown, validation_problems
from synth3dlanes.system.words import counted

# Files whose coordinates are larger than this are read relative to a round number near their first road.
FAR_M, ROUND_M = 1e5, 1000.0
# Places of a road that say how near it is.
NEAR_STEP_M = 20.0
MAX_MAP_ROADS = 100_000
# The number of broken roads whose reasons `GivenMap.text` has.
MOST_TOLD = 5
# Ways are followed no farther than this.
FAR_ENOUGH_M = 600.0
# The greatest gap between lanes that follow each other.
LINK_GAP_M = 5.0
# Shorter bridges and tunnels are left out.
LEAST_SPAN_M = 1.0
# No lane lies farther beside its reference line, no road is higher or more banked; looked at in steps.
MAX_ASIDE_M, MAX_HEIGHT_M, MAX_BANK_RAD, CHECK_STEP_M = 1000.0, 1e5, 1.3, 50.0


class LanePlace(NamedTuple):
    """A lane of a given map: its road, the number of its section and its own."""

    road: MapRoad
    section: int
    lane: MapLane

    @property
    def span_m(self) -> tuple[float, float]:
        """The stations of the road between which the lane lies."""
        return self.road.span_m(self.section)

    @property
    def length_m(self) -> float:
        """Its length along the reference line."""
        low, high = self.span_m
        return high - low

    @property
    def ascends(self) -> bool:
        """Whether its traffic drives with growing s."""
        return self.lane.ascends(self.road.keeps_left)


@dataclass(frozen=True, eq=False)
class GivenMap:
    """A map file, read. `origin` is where (0, 0) lies in the file, `names` are our ids of its roads by its own.
    `left_out` counts what has no counterpart here, by what it is; `broken` has a line for each road that is left out,
    with the reason. A copy for another process is the `packed` file, which that process reads once with `read`."""

    source: str
    digest: str
    packed: bytes
    read: Callable[[bytes, str, str], "GivenMap"]
    origin: tuple[float, float]
    names: dict[str, Name]
    roads: dict[Name, MapRoad]
    links: tuple[tuple[LaneName, LaneName], ...]
    junctions: tuple[MapJunction, ...]
    paint: tuple[MapPaint, ...]
    islands: tuple[MapIsland, ...]
    elements: tuple[GivenElement, ...]
    bodies: tuple[GivenBody, ...]
    rails: tuple[GivenRail, ...]
    left_out: dict[str, int] = field(default_factory=dict)
    broken: tuple[str, ...] = ()

    def __reduce__(self) -> tuple[Callable[..., "GivenMap"], tuple[object, ...]]:
        return read_packed, (self.read, self.packed, self.source, f"map {self.source}")

    @cached_property
    def lanes(self) -> dict[LaneName, LanePlace]:
        """All driving lanes by name."""
        return {
            f"{road.id}.{i}.{lane.number}": LanePlace(road, i, lane)
            for road in self.roads.values()
            for i, section in enumerate(road.sections)
            for lane in section.lanes
            if lane.kind == "driving"
        }

    @cached_property
    def plain_roads(self) -> dict[Name, MapRoad]:
        """Roads as scenes keep them whole, of those that any did: `part` fills it."""
        return {}

    @cached_property
    def following(self) -> dict[LaneName, list[LaneName]]:
        """The lanes that follow each lane that is followed."""
        found: dict[LaneName, list[LaneName]] = {}
        for one, other in self.links:
            found.setdefault(one, []).append(other)
        return found

    @cached_property
    def preceding(self) -> dict[LaneName, list[LaneName]]:
        """The lanes that each lane follows that follows any."""
        found: dict[LaneName, list[LaneName]] = {}
        for one, other in self.links:
            found.setdefault(other, []).append(one)
        return found

    @cached_property
    def reach_m(self) -> dict[LaneName, float]:
        """Length of the way from the beginning of each lane, at most FAR_ENOUGH_M, which a circle has."""
        found: dict[LaneName, float] = {}
        open_ends = {name: len(self.following.get(name, ())) for name in self.lanes}
        known = [name for name, n in open_ends.items() if not n]
        while known:
            name = known.pop()
            beyond = max((found[after] for after in self.following.get(name, ())), default=0.0)
            found[name] = min(self.lanes[name].length_m + beyond, FAR_ENOUGH_M)
            for before in self.preceding.get(name, ()):
                open_ends[before] -= 1
                if not open_ends[before]:
                    known.append(before)
        # What is left leads into a circle.
        return {name: found.get(name, FAR_ENOUGH_M) for name in self.lanes}

    @cached_property
    def outlines(self) -> dict[Name, Points2]:
        """Places along the reference line of every road."""
        return {
            name: places(road.plan, s := np.linspace(0, road.length_m, 2 + int(road.length_m / NEAR_STEP_M)), 0 * s)
            for name, road in self.roads.items()
        }

    @cached_property
    def lane_ends_m(self) -> Scalars:
        """Where the driving lanes end, put one behind the other in their order."""
        return np.cumsum([place.length_m for place in self.lanes.values()])

    @cached_property
    def _outlines(self) -> tuple[Points2, Int[np.ndarray, " n"]]:
        """The places of all outlines, and the number of the road of each."""
        lines = self.outlines.values()
        return np.concatenate([*lines]), np.repeat(np.arange(len(lines)), [len(line) for line in lines])

    def roads_near(self, xy: tuple[float, float], reach_m: float) -> list[MapRoad]:
        """The roads whose outline comes within a distance of a place."""
        places_of_all, numbers = self._outlines
        near = np.unique(numbers[np.hypot(*(places_of_all - xy).T) <= reach_m])
        roads = list(self.roads.values())
        return [roads[number] for number in near]

    def text(self) -> str:
        """What was read and what was not, as one line."""
        driving_m = sum(place.length_m for place in self.lanes.values())
        read = f"{counted(len(self.roads), 'road')}, {counted(len(self.junctions), 'junction')}"
        left = [f"{n} {what}" for what, n in sorted(self.left_out.items())]
        if self.broken:
            more = [f"{len(self.broken) - MOST_TOLD} more"] if len(self.broken) > MOST_TOLD else []
            noun = self.broken[0].partition(" ")[0]
            told = "; ".join([*self.broken[:MOST_TOLD], *more])
            left.append(f"{counted(len(self.broken), f'broken {noun}')} ({told})")
        driving = f"{driving_m / 1000:.1f} km of driving lanes"
        return f"map {self.source}: {read}, {driving}; left out: {', '.join(left) or 'nothing'}"


FileReader = Callable[[bytes, str, str], GivenMap]


def packed(data: bytes) -> bytes:
    """The bytes of a file as a map keeps them."""
    return zlib.compress(data, 1)


@lru_cache(maxsize=1)
def read_packed(read: FileReader, data: bytes, source: str, where: str) -> GivenMap:
    """The map in a packed file; the one that was read last is kept."""
    return read(zlib.decompress(data), source, where)


def read_opendrive(data: bytes, source: str, where: str) -> GivenMap:
    """The map in the bytes of a file named `source`, as they are or of gzip; FormatErrors begin with `where`."""
    root = parse_xml(inflated(data, where), where)
    if root.tag != "OpenDRIVE":
        raise FormatError(f"{where}: expected an OpenDRIVE file, got one of {shown(root.tag)}")
    try:
        return _read(root, hashlib.sha256(data).hexdigest(), packed(data), source, where)
    except ValidationError as error:
        raise FormatError(validation_problems(error, where)[0]) from None


def _read(root: Element, digest: str, packed_file: bytes, source: str, where: str) -> GivenMap:
    left_out: Counter[str] = Counter()
    elements = root.findall("road")
    if not 0 < len(elements) <= MAX_MAP_ROADS:
        raise FormatError(f"{where}: expected 1 to {MAX_MAP_ROADS} roads, got {len(elements)}")
    header = root.find("header")
    if header is not None and header.find("offset") is not None:
        left_out["the offset of the header"] += 1
    origin, names = _origin(elements, where), names_of([element.get("id", "") for element in elements])
    roads, linked, broken = dict[Name, MapRoad](), dict[str, LinkedRoad](), list[str]()
    paint, islands, in_file = list[MapPaint](), list[MapIsland](), list[FileRoad]()
    by_id = {element.get("id", ""): element for element in root.iterfind("junction")}
    junction_names = names_of([name for name, at in by_id.items() if at.get("type", "default") == "default"])
    for element in elements:
        id_of_file, of_road = element.get("id", ""), Counter[str]()
        name, at = names[id_of_file], f"road {id_of_file}"
        try:
            if id_of_file in linked:
                raise FormatError(f"{at}: expected ids of roads that differ, got one twice")
            road, linked[id_of_file] = _road(element, name, origin, at, of_road)
        except FormatError as error:
            broken.append(str(error))
            continue
        except ValidationError as error:
            broken.append(validation_problems(error, at)[0])
            continue
        left_out += of_road
        if road is None:
            left_out["roads without length"] += 1
            continue
        roads[name] = road.model_copy(update={"junction": junction_names.get(element.get("junction", "-1"))})
        drop_beyond(element, road.length_m, at, left_out)
        found = read_furniture(element, roads[name], at, left_out)
        paint += found.paint
        islands += found.islands
        in_file.append(FileRoad(element, roads[name], found.others, at))
    if not roads:
        more = f"; {len(broken) - 1} more roads are broken" if len(broken) > 1 else ""
        raise FormatError(f"{where}: {broken[0] if broken else 'expected a road with a length, got none'}{more}")
    roads = with_heights(roads)
    links = touching(lane_links(linked, by_id, left_out), roads, left_out)
    junctions = tuple(
        MapJunction(id=name, yields=_yields(by_id[id_of_file], linked, left_out))
        for id_of_file, name in junction_names.items()
    )
    controllers = {
        control.get("signalId", ""): at.get("id", "")
        for at in root.iterfind("controller")
        for control in at.iter("control")
    }
    signs = read_elements(in_file, controllers, left_out)
    bodies = tuple(body for of in in_file for body in read_bodies(of, left_out))
    rails = tuple(rail for of in in_file for rail in read_rails(of))
    for tag in ("junctionGroup", "station"):
        left_out[f"{tag}s"] += len(root.findall(tag))
    counts = {what: n for what, n in left_out.items() if n}
    lying = tuple(paint), tuple(islands)
    standing = signs, bodies, rails
    read = origin, names, roads, links, junctions, *lying, *standing
    return GivenMap(source, digest, packed_file, read_opendrive, *read, counts, tuple(broken))


def _origin(elements: list[Element], where: str) -> tuple[float, float]:
    """A round place near the roads of a map that is far from (0, 0), else that: near the first road, unless that is far
    from most."""
    firsts = [at for at in (element.find("planView/geometry") for element in elements) if at is not None]
    if not firsts:
        raise FormatError(f"{where}: expected roads with geometry, got none")
    found = list[tuple[float, float]]()
    for first in firsts:
        with suppress(FormatError):
            found.append((number(first, "x", where), number(first, "y", where)))
    if not found:
        return 0.0, 0.0
    middle = float(np.median([x for x, _ in found])), float(np.median([y for _, y in found]))
    x, y = found[0] if math.dist(found[0], middle) <= MAX_NUMBER / 2 else middle
    if max(abs(x), abs(y)) < FAR_M:
        return 0.0, 0.0
    return round(x / ROUND_M) * ROUND_M, round(y / ROUND_M) * ROUND_M


def names_of(ids: Sequence[str]) -> dict[str, Name]:
    """Our ids of roads or junctions by those of the file, which differ: equal where they can be."""
    plain = {
        text: "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in text)[:40] or "_"
        for text in ids
    }
    taken, found = {text for text, name in plain.items() if text == name}, dict[str, Name]()
    counts: Counter[str] = Counter()
    for text, name in plain.items():
        found[text] = name
        while text != name and found[text] in taken:
            counts[name] += 1
            found[text] = f"{name}_{counts[name]}"
        taken.add(found[text])
    return found


def with_heights(roads: dict[Name, MapRoad]) -> dict[Name, MapRoad]:
    """The roads, all with heights if any has a height, a bank, a shape, a bridge or a tunnel, else all without."""
    if all(
        is_zero(road.heights) and is_zero(road.banks) and not (road.shapes or road.bridges or road.tunnels)
        for road in roads.values()
    ):
        return {name: road.model_copy(update={"heights": (), "banks": ()}) for name, road in roads.items()}
    level = {"heights": (Polynomial(s_m=0.0, a=0.0),)}
    return {name: road if road.heights else road.model_copy(update=level) for name, road in roads.items()}


def _road(
    element: Element, name: Name, origin: tuple[float, float], where: str, left_out: Counter[str]
) -> tuple[MapRoad | None, LinkedRoad]:
    """A road and what is linked to it; no road if it is shorter than SAME_M, and then only joins others."""
    plan = read_plan(element, where, origin, left_out)
    length_m = sum(piece.length_m for piece in plan)
    before, after = read_end(element, "predecessor", left_out), read_end(element, "successor", left_out)
    for tag in ("crossfall", "crossSectionSurface"):
        left_out[f"{tag} of lateral profiles"] += len(element.findall(f"lateralProfile/{tag}"))
    offsets, heights, banks = (
        part(read_cubics(element.iterfind(path), "s", where, length_m, left_out), 0.0, length_m)
        for path in ("lanes/laneOffset", "elevationProfile/elevation", "lateralProfile/superelevation")
    )
    shapes = tuple(_shape(shape, where) for shape in element.iterfind("lateralProfile/shape"))
    sections = read_sections(element, length_m, not is_zero(banks) or bool(shapes), where, left_out)
    keeps_left = element.get("rule", "RHT") == "LHT"
    linked = LinkedRoad(element.get("id", ""), name, sections, before, after, element.get("junction"), keeps_left)
    if not plan:
        return None, linked
    whole = tuple(section for section in sections if not section.is_short)
    if not whole:
        raise FormatError(f"{where}: expected a lane section of {SAME_M:g} m or more, got none")
    road = MapRoad(
        id=name,
        plan=plan,
        sections=_whole(whole),
        lane_offsets=offsets,
        heights=heights,
        banks=banks,
        shapes=shapes,
        bridges=_spans(element, "bridge", length_m, where, left_out),
        tunnels=_spans(element, "tunnel", length_m, where, left_out),
        keeps_left=keeps_left,
    )
    check_sizes(road, where)
    parts = divided(road, whole)
    road = road.model_copy(update={"sections": _whole(parts)})
    joints = (section for section in sections if section.is_short)
    sections = tuple(sorted((*parts, *joints), key=lambda section: (section.s_m, not section.is_short)))
    return road if is_zero(banks) else _from_above(road), replace(linked, sections=sections)


def _whole(sections: Iterable[Section]) -> tuple[MapSection, ...]:
    return tuple(section.whole() for section in sections)


def check_sizes(road: MapRoad, where: str) -> None:
    """Raise FormatError for a road that is somewhere absurdly wide, high or banked."""
    for i, section in enumerate(road.sections):
        start_m, end_m = road.span_m(i)
        s = np.linspace(start_m, end_m, 2 + int((end_m - start_m) / CHECK_STEP_M))
        widths = {lane.number: np.maximum(Profile(lane.widths)(s - start_m), 0.0) for lane in section.lanes}
        sides = (sum(at for number, at in widths.items() if number * side > 0) for side in (1, -1))
        left, right = (
            np.abs(Profile(road.lane_offsets)(s) + side * of) for side, of in zip((1, -1), sides, strict=True)
        )
        for what, most, found in (
            ("edges of lanes", MAX_ASIDE_M, np.maximum(left, right)),
            ("heights", MAX_HEIGHT_M, np.abs(Profile(road.heights)(s))),
            ("superelevations", MAX_BANK_RAD, np.abs(Profile(road.banks)(s))),
        ):
            for k in np.flatnonzero(~(found <= most))[:1]:
                got = f"{found[k]:.4g} at s = {s[k]:.4g}"
                raise FormatError(f"{where}: {what}: expected at most {most:g}, got {got}")


def touching(
    links: Sequence[tuple[LaneName, LaneName]], roads: dict[Name, MapRoad], left_out: Counter[str]
) -> tuple[tuple[LaneName, LaneName], ...]:
    """The links of lanes that end where the next one begins."""
    ends: dict[tuple[LaneName, bool], tuple[float, float]] = {}
    kept = []
    for link in links:
        for name, leaves in zip(link, (True, False), strict=True):
            if (name, leaves) not in ends:
                ends[name, leaves] = _end_of(name, leaves, roads)
        if math.dist(ends[link[0], True], ends[link[1], False]) <= LINK_GAP_M:
            kept.append(link)
        else:
            left_out["links of lanes that do not touch"] += 1
    return tuple(kept)


def _end_of(name: LaneName, leaves: bool, roads: dict[Name, MapRoad]) -> tuple[float, float]:
    """The middle of a lane where its traffic leaves it, or enters it."""
    road_id, section, number = lane_key(name)
    road = roads[road_id]
    lane = next(at for at in road.sections[section].lanes if at.number == number)
    low, high = road.span_m(section)
    s_m = high if lane.ascends(road.keeps_left) == leaves else low
    t_m = next((a + b) / 2 for at, a, b in edges_at(road, section, s_m) if at is lane)
    x, y = places(road.plan, np.array([s_m]), np.array([t_m]))[0].tolist()
    return x, y


def _shape(element: Element, where: str) -> MapShape:
    s, t, a, b, c, d = (number(element, key, where, 0.0) for key in ("s", "t", "a", "b", "c", "d"))
    return MapShape(s_m=s, t_m=t, a=a, b=b, c=c, d=d)


def _spans(element: Element, tag: str, length_m: float, where: str, left_out: Counter[str]) -> tuple[MapSpan, ...]:
    """The bridges or tunnels of a road, cut to its ends."""
    found = []
    for item in element.iterfind(f"objects/{tag}"):
        with passing_over(item, left_out):
            s, span_m = number(item, "s", where, 0.0), number(item, "length", where, 0.0)
            from_m, to_m = max(s, 0.0), min(s + span_m, length_m)
            if to_m - from_m >= LEAST_SPAN_M:
                found.append(MapSpan(from_m=from_m, to_m=to_m))
    return tuple(found)


def _from_above(road: MapRoad) -> MapRoad:
    """A banked road, whose widths in the file lie on its banked plane but for those of level lanes, with those and the
    fall seen from above."""
    breaks = [piece.s_m for piece in road.banks]
    seen = widened(road, lambda s_m, end_m: math.cos(value(road.banks, s_m, end_m)), breaks)
    return seen.model_copy(update={"banks": steepened(road.banks, road.heights, road.length_m, 1)})


def _yields(
    junction: Element, roads: dict[str, LinkedRoad], left_out: Counter[str]
) -> tuple[tuple[LaneName, LaneName], ...]:
    """The lanes of roads of low priority, each with every lane of those of high priority that it gives way to."""
    found: list[tuple[LaneName, LaneName]] = []
    for priority in junction.iterfind("priority"):
        pair = [roads.get(priority.get(key, "")) for key in ("low", "high")]
        if None in pair:
            left_out["priorities of junctions without two roads"] += 1
            continue
        low, high = (
            [
                f"{road.name}.0.{number}"
                for i in list(road.numbers)[:1]
                for number, lane in road.sections[i].lanes.items()
                if lane.lane.kind == "driving" and number
            ]
            for road in pair
            if road is not None
        )
        found += [(one, other) for one in low for other in high]
    return tuple(dict.fromkeys(found))
