"""Drawn maps with all that the standard allows, against a second reading of their numbers (`standard`): all lanes, at
the ends of sections too."""

import numpy as np
import pytest

from synth3dlanes.roads.maps.given_map import read_opendrive
from tests.maps.comparing import everywhere
from tests.maps.files import lane, opendrive, plan, road, section
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
                found.append(text.replace('level="false"', 'level="true"') if is_level else text)
            texts.append(section(*found, s=s, more="" if left else 'singleSide="true"'))
        return "".join(texts)


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
    profile = f"<elevationProfile>{heights}</elevationProfile><lateralProfile>{banks}</lateralProfile>"
    start = draw(-50, 50), draw(-50, 50), draw(-3, 3)
    return opendrive(road(plan(*pieces, start=start), offsets + draw.lanes(length, is_banked), profile=profile))


@pytest.mark.parametrize("seed", first(16, range(120)))
def test_every_lane_of_a_drawn_road_is_where_the_standard_says(seed: int) -> None:
    data = file(seed)
    found = everywhere(read_opendrive(data, "drawn.xodr", "map drawn.xodr"), read(data))
    assert found.n_points > 50
    assert found.plan_m < 0.004
    assert found.height_m < 0.004
