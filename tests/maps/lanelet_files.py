"""Small Lanelet2 files: points, lines and lanelets as text."""

from collections.abc import Mapping, Sequence

Tags = Mapping[str, str]


def _tags(tags: Tags) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())


class Sheet:
    """An OSM file in the making. Points that are equal are one node."""

    def __init__(self) -> None:
        self.nodes: dict[tuple[float, float, float], int] = {}
        self.ways: list[str] = []
        self.relations: list[str] = []
        self.n = 10_000

    def line(self, points: Sequence[tuple[float, float, float]], **tags: str) -> int:
        """A way."""
        nodes = [self.nodes.setdefault(point, len(self.nodes) + 1) for point in points]
        self.n += 1
        refs = "".join(f'<nd ref="{node}"/>' for node in nodes)
        self.ways.append(f'<way id="{self.n}">{refs}{_tags(tags)}</way>')
        return self.n

    def relation(self, members: Sequence[tuple[str, int, str]], tags: Tags) -> int:
        """A relation."""
        self.n += 1
        refs = "".join(f'<member type="{kind}" ref="{ref}" role="{role}"/>' for kind, ref, role in members)
        self.relations.append(f'<relation id="{self.n}">{refs}{_tags(tags)}</relation>')
        return self.n

    def lanelet(self, left: int, right: int, *rules: int, **tags: str) -> int:
        """A lanelet of traffic."""
        members = [
            ("way", left, "left"),
            ("way", right, "right"),
            *(("relation", at, "regulatory_element") for at in rules),
        ]
        return self.relation(members, {"type": "lanelet", "subtype": "road", "one_way": "yes", **tags})

    def rule(self, subtype: str, *members: tuple[str, int, str]) -> int:
        """A regulatory element."""
        return self.relation(members, {"type": "regulatory_element", "subtype": subtype})

    def data(self) -> bytes:
        """The file."""
        nodes = "".join(
            f'<node id="{node}">{_tags({"local_x": str(x), "local_y": str(y), "ele": str(z)})}</node>'
            for (x, y, z), node in self.nodes.items()
        )
        return f'<osm version="0.6">{nodes}{"".join(self.ways)}{"".join(self.relations)}</osm>'.encode()


def along(y: float, x0: float = 0.0, x1: float = 100.0, z: float = 0.0) -> list[tuple[float, float, float]]:
    """A straight line along x."""
    return [(x0, y, z), ((x0 + x1) / 2, y, z), (x1, y, z)]


def street() -> Sheet:
    """Two lanes to the east with a dashed line, one to the west beyond a solid one, and a lane that goes on."""
    sheet = Sheet()
    lines = {
        y: sheet.line(along(y), type="line_thin", subtype=kind)
        for y, kind in ((3.5, "solid"), (0.0, "solid_dashed"), (-3.5, "dashed"), (-7.0, "solid"))
    }
    sheet.lanelet(lines[0.0], lines[-3.5])
    sheet.lanelet(lines[-3.5], lines[-7.0])
    # Traffic goes against the order of these lines' points.
    sheet.lanelet(lines[0.0], lines[3.5])
    onward = [sheet.line(along(y, 100.0, 160.0), type="virtual") for y in (0.0, -3.5)]
    sheet.lanelet(*onward)
    return sheet
