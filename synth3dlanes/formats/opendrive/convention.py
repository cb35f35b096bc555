"""OpenDRIVE's version and words."""

MAJOR, MINOR = "1", "7"
NO_NUMBER = "-1"
USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
LANE_CHANGES = {"dashed": "both", "dots": "both", "solid_dashed": "increase", "dashed_solid": "decrease"}
"""Towards which lane numbers, which increase to the left, a mark may be crossed: from the side of its dashes."""
