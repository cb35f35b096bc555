"""OpenDRIVE files that the tests write."""

from xml.etree import ElementTree

import numpy as np

from tests.maps.standard import along

# A lane's links to the lane of a number before and behind it.
ON = '<predecessor id="{0}"/><successor id="{0}"/>'
PLAIN = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/><roadMark sOffset="0" type="solid"/>'


def lane(number: int, inside: str = PLAIN, kind: str = "driving", link: str = "", more: str = "") -> str:
    """A lane."""
    return f'<lane id="{number}" type="{kind}" level="false" {more}><link>{link}</link>{inside}</lane>'


def sides(*lanes: str) -> str:
    """The lanes of a section in their groups; lane 0 is added."""
    groups = {"left": [], "center": [lane(0, "", "none")], "right": []}
    for text in lanes:
        number = int(ElementTree.fromstring(text).get("id"))
        (groups["left" if number > 0 else "right"] if number else groups["center"]).append(text)
    if len(groups["center"]) > 1:
        groups["center"] = groups["center"][1:]
    return "".join(f"<{side}>{''.join(texts)}</{side}>" for side, texts in groups.items() if texts)


def section(*lanes: str, s: float = 0.0, more: str = "") -> str:
    """A lane section."""
    return f'<laneSection s="{s}" {more}>{sides(*lanes)}</laneSection>'


TWO = section(lane(1), lane(-1))


def plan(*pieces: tuple[str, float], start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """Geometry one after the other, each where the one before ends."""
    texts, s, at = [], 0.0, np.array(start)
    for form, length in pieces:
        x, y, heading = at
        texts.append(f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{form}</geometry>')
        at, s = along(ElementTree.fromstring(texts[-1]), np.array([length]))[0], s + length
    return f"<planView>{''.join(texts)}</planView>"


def road(
    pieces: str,
    lanes: str = TWO,
    name: str = "1",
    *,
    link: str = "",
    more: str = "",
    profile: str = "",
    after: str = "",
) -> str:
    """A road."""
    length = sum(float(at.get("length")) for at in ElementTree.fromstring(pieces))
    return (
        f'<road name="" length="{length}" id="{name}" {more}><link>{link}</link>{pieces}{profile}'
        f"<lanes>{lanes}</lanes>{after}</road>"
    )


def link(before: str = "", after: str = "") -> str:
    """The links of a road to another, as ID:CONTACT, or to a junction by its id."""
    texts = []
    for tag, text in (("predecessor", before), ("successor", after)):
        name, is_road, contact = text.partition(":")
        kind = f'elementType="road" contactPoint="{contact}"' if is_road else 'elementType="junction"'
        texts.append(f'<{tag} {kind} elementId="{name}"/>' if text else "")
    return "".join(texts)


def opendrive(*parts: str) -> bytes:
    """A file."""
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/>{"".join(parts)}</OpenDRIVE>'.encode()
