"""OpenDRIVE's version and words."""

MAJOR, MINOR = "1", "7"
NO_NUMBER = "-1"
USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
MARK_TYPES = {
    "none": "none",
    "solid": "solid",
    "double": "solid solid",
    "solid_dashed": "solid broken",
    "dashed_solid": "broken solid",
    "dashed": "broken",
    "dots": "botts dots",
}
"""Of marks from the left; OpenDRIVE names those of lanes to the left of lane 0 from the right."""
LANE_CHANGES = {"dashed": "both", "dots": "both", "solid_dashed": "increase", "dashed_solid": "decrease"}
"""Towards which lane numbers, which increase to the left, a mark may be crossed: from the side of its dashes."""
