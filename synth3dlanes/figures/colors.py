"""The key of all figures, pages and pictures: what colours and lines mean.

Blue is a centre line and red a delimiter, of labels and of detections alike. A line in an image is full where it is
seen and dotted where it is hidden; a hollow line is a label with detections over it. From above, from the side and in
space, a line is dashed where the paint is, and pale where it is hidden or outside the image.
"""

from synth3dlanes.labels.labels import LaneKind

Rgb = tuple[int, int, int]


def hexadecimal(color: Rgb) -> str:
    """The colour as `#rrggbb`, for matplotlib, HTML and rich."""
    return "#{:02x}{:02x}{:02x}".format(*color)


KINDS: dict[LaneKind, Rgb] = {"centerline": (0, 190, 255), "delimiter": (255, 45, 110)}
"""Blue and red: visible on asphalt, grass and sky, and distinguishable with colour blindness."""

KIND_WORDS: dict[LaneKind, str] = {"centerline": "centre line", "delimiter": "delimiter"}

OBJECT: Rgb = (255, 196, 0)
ELEMENT: Rgb = (196, 120, 255)
"""Yellow boxes of objects, violet faces of traffic elements."""

MASKS = {"seen": "#17a34a", "hidden by the ground": "#f59e0b", "hidden by objects": "#a21caf"}
"""Single points of labels, by what hides them."""

ROAD = "#c9ced6"
GROUND = "#a9c29a"
TREE = "#4c8a4a"
STRUCTURE = "#7b6f8c"
INK = "#22303c"
FAINT = "#8894a0"
CAMERA: Rgb = (242, 183, 5)
FRUSTUM = hexadecimal(CAMERA)
