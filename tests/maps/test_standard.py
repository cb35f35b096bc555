"""Where lanes of OpenDRIVE files are, against a second reading of their numbers (`standard`): drawn files with all that
is allowed, and files whose values step, where lines end where they were going."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.formats.opendrive import opendrive as opendrive_of
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.part import read_place
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.world import World
from tests.maps.comparing import apart, everywhere
from tests.maps.files import ON, PLAIN, lane, opendrive, plan, road, section
from tests.maps.standard import read
from tests.thorough import first

MARK = '<roadMark sOffset="0" type="solid"/>'


class Draw:
    """A road of a file, drawn."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def __call__(self, low: float, high: float) -> float:
        return round(float(self.rng.uniform(low, high)), 6)

    def form(self) -> tuple[str, float]:
        """A piece of geometry, and its length."""
        length, kind = self(20, 70), self.rng.integers(6)
        if kind < 3:
            a, b = self(-0.015, 0.015), self(-0.015, 0.015)
            return ("<line/>", f'<arc curvature="{a}"/>', f'<spiral curvStart="{a}" curvEnd="{b}"/>')[kind], length
        c, d = self(-0.003, 0.003), self(-2e-5, 2e-5)
        if kind == 3:
            return f'<poly3 a="0" b="0" c="{c}" d="{d}"/>', length
        scale = 1.0 if kind == 4 else length
        u = f'aU="0" bU="{scale}" cU="0" dU="0"'
        v = f'aV="0" bV="0" cV="{c * scale**2}" dV="{d * scale**3}"'
        return f'<paramPoly3 pRange="{"arcLength" if kind == 4 else "normalized"}" {u} {v}/>', length

    def cubics(self, tag: str, length: float, size: float) -> str:
        """Entries of a value that does not go on from one to the next."""
        begins = [0.0, *sorted(round(float(s), 3) for s in self.rng.uniform(5, length, self.rng.integers(3)))]
        sizes = {"a": size, "b": size / 50, "c": size / 3000}
        told = [" ".join(f'{name}="{self(-1, 1) * most}"' for name, most in sizes.items()) for _ in begins]
        return "".join(f'<{tag} s="{s}" {abc} d="0"/>' for s, abc in zip(begins, told, strict=True))

    def widths(self, length: float) -> str:
        """Widths that step."""
        begins = [0.0, *sorted(round(float(s), 3) for s in self.rng.uniform(5, length, self.rng.integers(2)))]
        return "".join(
            f'<width sOffset="{s}" a="{self(2, 4)}" b="{self(-0.01, 0.01)}" c="{self(-1e-4, 1e-4)}" d="0"/>'
            for s in begins
        )

    def lanes(self, length: float, is_banked: bool) -> str:
        """Sections of lanes, some by their borders, some for one side, the outer ones level."""
        begins = [0.0, *sorted(round(float(s), 3) for s in self.rng.uniform(10, length - 10, self.rng.integers(3)))]
        texts = []
        for k, s in enumerate(begins):
            left, right = self.rng.integers(1, 4, 2)
            if k and self.rng.random() < 0.3:
                left = 0
            has_borders = self.rng.random() < 0.3
            found = []
            for n in (*range(left, 0, -1), *range(-1, -right - 1, -1)):
                sign = 1 if n > 0 else -1
                border = f'<border sOffset="0" a="{3.2 * n}" b="{0.002 * sign}" c="0" d="0"/>'
                text = lane(n, (border if has_borders and n < 0 else self.widths(length / 2)) + MARK)
                is_level = is_banked and n == -right and self.rng.random() < 0.5
                level = "true" if len(texts) % 2 else "1"
                found.append(text.replace('level="false"', f'level="{level}"') if is_level else text)
            texts.append(section(*found, s=s, more="" if left else 'singleSide="true"'))
        return "".join(texts)


def has_shapes(seed: int) -> bool:
    """Whether lateral shapes tell the surface of a drawn road."""
    return seed % 4 == 3


def file(seed: int) -> bytes:
    """A file of one road."""
    draw = Draw(seed)
    pieces = [draw.form() for _ in range(draw.rng.integers(1, 4))]
    length, is_banked = sum(m for _, m in pieces), seed % 2 == 1
    offsets = draw.cubics("laneOffset", length, 1.5)
    # Banked roads are level along: where one climbs, the ends of its lines are moved along it by the roll.
    heights = (
        f'<elevation s="0" a="{draw(-5, 5)}" b="0" c="0" d="0"/>' if is_banked else draw.cubics("elevation", length, 4)
    )
    banks = draw.cubics("superelevation", length, 0.08) if is_banked else ""
    if has_shapes(seed):
        shape = '<shape s="{}" t="-20" a="{}" b="{}" c="0" d="0"/>'
        banks += shape.format(0, 0, 0.001) + shape.format(length / 2, 0.03, -0.001)
    profile = f"<elevationProfile>{heights}</elevationProfile><lateralProfile>{banks}</lateralProfile>"
    start = draw(-50, 50), draw(-50, 50), draw(-3, 3)
    return opendrive(road(plan(*pieces, start=start), offsets + draw.lanes(length, is_banked), profile=profile))


@pytest.mark.parametrize("seed", first(16, range(120)))
def test_every_lane_of_a_drawn_road_is_where_the_standard_says(seed: int) -> None:
    data = file(seed)
    found = everywhere(read_opendrive(data, "drawn.xodr", "map drawn.xodr"), read(data))
    most_m = 0.01 if has_shapes(seed) else 0.004
    assert found.n_points > 50
    assert found.plan_m < most_m
    assert found.height_m < most_m


LINE = plan(("<line/>", 300.0))
PIECE = '<geometry s="{0}" x="{0}" y="{1}" hdg="0" length="{2}"><line/></geometry>'
GAP = f"<planView>{PIECE.format(0.0, 0.0, 100.0)}{PIECE.format(100.0, 0.4, 200.0)}</planView>"
BEND = plan(("<line/>", 60.0), ('<arc curvature="0.01"/>', 100.0), ("<line/>", 140.0))


def cubic(tag: str, *rows: tuple[float, float, float], key: str = "s") -> str:
    """Entries of a value along a road: station, value, slope."""
    return "".join(f'<{tag} {key}="{s}" a="{a}" b="{b}" c="0" d="0"/>' for s, a, b in rows)


def lanes(*sections: float, inside: str = PLAIN, offsets: str = "") -> str:
    """Sections of four lanes that begin at stations; `inside` is what lane -1 of the last one has."""
    found = [offsets]
    for s in sections:
        own = {-1: inside} if s == sections[-1] else {}
        found.append(section(*(lane(n, own.get(n, PLAIN), link=ON.format(n)) for n in (2, 1, -1, -2)), s=s))
    return "".join(found)


def lateral(text: str, climb: float) -> str:
    """A lateral profile, on a road that climbs."""
    heights = cubic("elevation", (0, 2, climb))
    return f"<elevationProfile>{heights}</elevationProfile><lateralProfile>{text}</lateralProfile>"


OFFSETS = cubic("laneOffset", (0, 0, 0), (100, -1.2, 0.01))
WIDTHS = cubic("width", (0, 3.5, 0), (50, 4.6, -0.01), key="sOffset") + MARK
HEIGHTS = f"<elevationProfile>{cubic('elevation', (0, 1, 0.02), (100, 4.2, -0.01))}</elevationProfile>"
BANKS = lateral(cubic("superelevation", (0, 0.02, 0), (100, 0.09, -0.0002)), 0.002)
# Files whose values step at a section's border, where all lanes step, or within a section.
STEPS = {
    "offset at a border": road(LINE, lanes(0, 100, offsets=OFFSETS)),
    "offset within": road(LINE, lanes(0, offsets=OFFSETS)),
    "offset a hair before the border": road(LINE, lanes(0, 100.0004, offsets=OFFSETS)),
    "width at a border": road(BEND, lanes(0, 100, inside=cubic("width", (0, 2.4, 0), key="sOffset") + MARK)),
    "width within": road(BEND, lanes(0, inside=WIDTHS)),
    "width beyond the section": road(
        LINE,
        section(lane(-1, cubic("width", (0, 3, 0), (100, 9, 0.5), key="sOffset") + MARK, link=ON.format(-1)))
        + section(lane(-1, link=ON.format(-1)), s=100.0),
    ),
    "border within": road(
        LINE, section(lane(1), lane(-1, cubic("border", (0, -3, 0), (100, -4, 0), key="sOffset") + MARK))
    ),
    "elevation at a border": road(LINE, lanes(0, 100), profile=HEIGHTS),
    "elevation within": road(LINE, lanes(0), profile=HEIGHTS),
    "elevation at the end": road(
        LINE, lanes(0), profile=f"<elevationProfile>{cubic('elevation', (0, 1, 0.02), (300, 50, 0))}</elevationProfile>"
    ),
    "bank at a border": road(BEND, lanes(0, 100), profile=BANKS),
    "bank within": road(BEND, lanes(0), profile=BANKS),
    "plan at a border": road(GAP, lanes(0, 100)),
    "plan within": road(GAP, lanes(0)),
    # Of which a scene keeps a part.
    "on a long road": road(
        plan(("<line/>", 800.0), ('<arc curvature="0.001"/>', 900.0), ("<line/>", 700.0)),
        lanes(0, 1300, inside=WIDTHS),
        profile=f"<elevationProfile>{cubic('elevation', (0, 40, 0.02), (1350, 61, -0.01))}</elevationProfile>",
    ),
}  # fmt: skip
# Where the host is if it is not 60 m on.
PLACES = {"elevation at the end": "1:260:-1", "on a long road": "1:1310:-1"}


@cache
def given(name: str) -> tuple[GivenMap, bytes]:
    """A file of these, read, and its text."""
    data = opendrive(STEPS[name])
    return read_opendrive(data, "steps.xodr", "map steps.xodr"), data


@cache
def scene(name: str) -> tuple[World, Labels]:
    """A world with the host before the step, and its labels."""
    return drawn(given(name)[0], PLACES.get(name, "1:60:-1"))


def drawn(file: GivenMap, at: str) -> tuple[World, Labels]:
    """A world with nothing but the road, and its labels."""
    bare = "cars.n=0", "trees.n=0", "terrain.n_gaussians=0"
    place = MapPlace(file, read_place(file, at))
    world = sample_world(Scenes(load_params("realistic", bare), 1, "train", map=place), 0)
    return world, ground_truth(world.scene)


@pytest.mark.parametrize("name", STEPS)
def test_labels_are_where_the_file_says_and_no_line_has_a_jump(name: str) -> None:
    found = apart(*scene(name), given(name)[0], read(given(name)[1]))
    assert found.n_points > 80
    assert found.plan_m < 0.002
    assert not found.height_m > 0.002
    # The bends themselves: a metre of 0.01 per metre.
    assert found.jump_m < 0.02


@pytest.mark.parametrize("name", STEPS)
def test_pavement_steps_where_the_labels_do(name: str) -> None:
    world, _ = scene(name)
    vertices = np.concatenate([mesh.vertices_world for mesh in world.site.surfaces.pavement])
    for stretch in world.ground.network.roads[0].stretches:
        (across,) = stretch.sections
        for s_m in (across.start_m, across.end_m):
            s = np.full(len(across.lanes) + 1, s_m)
            edges = stretch.points(s, across.edges(s[:1])[:, 0])
            for point in edges[np.linalg.norm(edges[:, :2], axis=1) < 200]:
                assert np.linalg.norm(vertices - point, axis=1).min() < 1e-3


@pytest.mark.parametrize("name", STEPS)
def test_an_exported_map_steps_where_the_labels_do(name: str) -> None:
    world, labels = scene(name)
    roads = {str(at.element.get("name")): at for at in read(opendrive_of(world, "scene").encode()).values()}
    assert world.scene.map is not None
    own = tuple(at.model_copy(update={"given_from_m": 0.0}) for at in world.scene.map.roads)
    in_world = world.scene.map.model_copy(update={"given_frame": (0.0, 0.0, 0.0, 0.0), "roads": own})
    found = apart(replace(world, scene=world.scene.model_copy(update={"map": in_world})), labels, given(name)[0], roads)
    assert found.plan_m < 0.02
    assert not found.height_m > 0.03


def test_a_mark_told_from_before_its_section_is_painted_in_it_on_the_lanes_edge() -> None:
    before = cubic("width", (0, 3.5, 0.1), key="sOffset") + (
        '<roadMark sOffset="0" type="none"/><roadMark sOffset="-12" type="broken" color="yellow"/>'
        '<roadMark sOffset="260" type="solid"/>'
    )
    file = opendrive(road(LINE, lanes(0, 100, inside=before)))
    read_map = read_opendrive(file, "x.xodr", "map x.xodr")
    world, labels = drawn(read_map, "1:60:-1")
    assert apart(world, labels, read_map, read(file)).plan_m < 0.002
    (line,) = [at for at in labels.lanes if at.id == "1.1.-1.line"]
    assert line.marking == "dashed"
    x = transform(labels.camera.world_from_cam, line.xyz_cam)[:, 1] + 60
    assert x.min() == pytest.approx(100, abs=0.01)
    marks = [mark for part in read_map.roads["1"].sections for at in part.lanes for mark in at.marks]
    assert [mark.s_m for mark in marks] == [0.0] * 8
