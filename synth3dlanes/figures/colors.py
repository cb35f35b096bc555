"""The colours shared by all figures."""

from synth3dlanes.labels import LaneKind

Rgb = tuple[int, int, int]

KINDS: dict[LaneKind, Rgb] = {"centerline": (0, 190, 255), "delimiter": (255, 45, 110)}
"""Blue and red: visible on asphalt, grass and sky, and distinguishable with colour blindness."""

OBJECT: Rgb = (255, 196, 0)

ROAD = "#c9ced6"
GROUND = "#a9c29a"
TREE = "#4c8a4a"
STRUCTURE = "#7b6f8c"
INK = "#22303c"
FAINT = "#8894a0"
FRUSTUM = "#f2b705"


def hexadecimal(color: Rgb) -> str:
    """The colour as `#rrggbb`, for matplotlib, HTML and rich."""
    return "#{:02x}{:02x}{:02x}".format(*color)
