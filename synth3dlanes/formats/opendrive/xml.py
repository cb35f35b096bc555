"""XML elements with words, numbers and ids as OpenDRIVE files have them."""

import math
import re
from collections.abc import Collection
from itertools import count
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

Element = ElementTree.Element
MAJOR, MINOR = "1", "7"
NO_NUMBER = "-1"
USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
# CARLA and others read ids as whole numbers of 32 bits.
NUMBER = re.compile(r"0|[1-9]\d{0,8}")


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    texts = {key: value if isinstance(value, str) else text(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def numbered(names: Collection[str], taken: Collection[str] = ()) -> dict[str, str]:
    """A number for each name, which is none of those taken: the name itself if it is one, else the next that is
    free."""
    found = {name: name for name in names if NUMBER.fullmatch(name) and name not in taken}
    used = {*found, *taken}
    free = (str(n) for n in count(1) if str(n) not in used)
    return {name: found.get(name) or next(free) for name in names}


def add_crosswalk(
    parent: Element, number: int, corners: Float[np.ndarray, "4 3"], s: float, t: float, **attributes: str | float
) -> Element:
    """A crosswalk at (s, t) by its corners from there along the road, to its left and up. It is turned so that people
    walk along u. Its outline is where readers of version 1.4 look, as CARLA, and closed as they want it."""
    sides = np.diff(corners[:3], axis=0)
    along = sides[int(np.hypot(*sides[1, :2]) > np.hypot(*sides[0, :2]))]
    turn_rad = math.atan2(along[1], along[0])
    words = {"id": str(number), "type": "crosswalk", "orientation": "none", **attributes}
    element = add(parent, "object", **words, s=s, t=t, zOffset=0.0, hdg=turn_rad, pitch=0.0, roll=0.0)
    outline = add(element, "outline", id="0", closed="true")
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    for i, (ahead, left, up) in enumerate([*corners.tolist(), corners[0].tolist()]):
        local = {"u": cos * ahead + sin * left, "v": cos * left - sin * ahead, "z": up, "height": 0.0}
        add(outline, "cornerLocal", id=str(i), **local)
    return element


def text(value: float) -> str:
    """Ten digits: a micrometre in a kilometre. Smaller than a picometre is noise."""
    return f"{value:.10g}" if abs(value) > 1e-12 else "0"
