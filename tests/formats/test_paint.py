"""The words of each format for the paint of a line."""

from collections.abc import Callable

import pytest

from synth3dlanes.formats import argoverse2, comparing_maps, cosmos, nuscenes_maps, openlane
from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from tests.formats import closed_form as cf

PAINTS: dict[str, tuple[Marking, PaintColor | None, bool | None, Pair | None]] = {
    "none": ("none", None, None, None),
    "white dashed": ("dashed", "white", False, None),
    "white solid": ("solid", "white", False, None),
    "white dashed twice": ("dashed", "white", True, None),
    "white solid twice": ("solid", "white", True, None),
    "white dashed, solid": ("solid", "white", True, "dashed_solid"),
    "white solid, dashed": ("solid", "white", True, "solid_dashed"),
    "yellow dashed": ("dashed", "yellow", False, None),
    "yellow solid": ("solid", "yellow", False, None),
    "yellow dashed twice": ("dashed", "yellow", True, None),
    "yellow solid twice": ("solid", "yellow", True, None),
    "yellow dashed, solid": ("solid", "yellow", True, "dashed_solid"),
    "yellow solid, dashed": ("solid", "yellow", True, "solid_dashed"),
    "older, without a colour": ("dashed", None, None, None),
}
# Theirs begins at the right.
COSMOS = ("VIRTUAL", "LONG_DASHED_SINGLE", "SOLID_SINGLE", "LONG_DASHED_GROUP", "SOLID_GROUP", "SOLID_DASHED",
          "DASHED_SOLID")  # fmt: skip
LANELET2 = ("dashed", "solid", "dashed", "solid_solid", "dashed_solid", "solid_dashed")
AV2, NUSCENES = (
    ("NONE", "DASHED_{}", "SOLID_{}", "DOUBLE_DASH_{}", "DOUBLE_SOLID_{}", "DASH_SOLID_{}", "SOLID_DASH_{}"),
    ("NIL", "SINGLE_DASHED_{}", "SINGLE_SOLID_{}", "DOUBLE_DASHED_{}", "DOUBLE_SOLID_{}", "DASHED_SOLID_{}",
     "SOLID_DASHED_{}"),
)  # fmt: skip


def in_colors(words: tuple[str, ...]) -> list[str]:
    """The words of all paints, given those of white ones."""
    return [*(word.format("WHITE") for word in words), *(word.format("YELLOW") for word in words[1:]),
            words[1].format("WHITE")]  # fmt: skip


WORDS: dict[str, tuple[Callable[..., object], list[object]]] = {
    "argoverse2": (argoverse2.mark_type, [*in_colors(AV2)]),
    "nuscenes": (nuscenes_maps.segment_type, [*in_colors(NUSCENES)]),
    "cosmos": (lambda marking, color, double, pair: cosmos.line_style(marking, double, pair), [*in_colors(COSMOS)]),
    "lanelet2": (
        comparing_maps.paint_word,
        ["none", *(f"{word} white" for word in LANELET2), *(f"{word} yellow" for word in LANELET2), "dashed None"],
    ),
    # 1 white-dash, 2 white-solid, 3 double-white-dash, 4 double-white-solid, 5 white-ldash-rsolid,
    # 6 white-lsolid-rdash;
    # 7 to 12 the same in yellow.
    "openlane": (
        lambda marking, color, double, pair: openlane.category(
            cf.lane(cf.camera_label(), cf.curve(2.0), marking=marking, color=color, double=double, pair=pair)
        ),
        [*range(13), 1],
    ),
}


@pytest.mark.parametrize("name", WORDS)
def test_the_words_of_paint(name: str) -> None:
    word, expected = WORDS[name]
    assert {paint: word(*told) for paint, told in PAINTS.items()} == dict(zip(PAINTS, expected, strict=True))
    assert name != "openlane" or dict(zip(range(1, 13), [*PAINTS.values()][1:-1], strict=True)) == openlane.PAINTS
