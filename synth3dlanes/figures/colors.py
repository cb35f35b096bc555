"""The colours that every figure shares, so that a line means the same thing in all of them."""

from synth3dlanes.labels import LaneKind

Rgb = tuple[int, int, int]

KINDS: dict[LaneKind, Rgb] = {"centerline": (0, 190, 255), "delimiter": (255, 45, 110)}
"""Blue and red, readable on asphalt, grass and sky alike, and told apart by colour-blind eyes."""

ROAD = "#c9ced6"
GROUND = "#a9c29a"
TREE = "#4c8a4a"
INK = "#22303c"
FAINT = "#8894a0"
FRUSTUM = "#f2b705"


def hexadecimal(color: Rgb) -> str:
    """The colour as matplotlib, HTML and rich spell it."""
    return "#{:02x}{:02x}{:02x}".format(*color)
