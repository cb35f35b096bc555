"""OpenDRIVE's version and words."""

MAJOR, MINOR = "1", "7"
NO_NUMBER = "-1"
USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
MARK_TYPES = {"none": "none", "solid": "solid", "double": "solid solid", "dashed": "broken", "dots": "botts dots"}
