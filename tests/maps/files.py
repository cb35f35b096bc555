"""OpenDRIVE files that the tests write, and an evaluation of their own numbers that shares no code with the reader."""

from xml.etree import ElementTree

import numpy as np

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
    """Geometry one after the other, each where the one before ends by `walked`."""
    texts, s, at = [], 0.0, np.array(start)
    for form, length in pieces:
        x, y, heading = at
        texts.append(f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{form}</geometry>')
        at, s = walked(ElementTree.fromstring(form), at, length, np.array([length]))[0], s + length
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


def opendrive(*parts: str) -> bytes:
    """A file."""
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/>{"".join(parts)}</OpenDRIVE>'.encode()


def walked(
    form: ElementTree.Element, start: np.ndarray, length: float, s: np.ndarray, steps: int = 20_000
) -> np.ndarray:
    """(x, y, heading) along one piece of geometry at lengths from its start, by small steps along the curve."""
    number = {key: float(value) for key, value in form.attrib.items() if key != "pRange"}
    x, y, heading = start
    if form.tag in ("line", "arc", "spiral"):
        at = np.linspace(0, length, steps + 1)
        first = number.get("curvature", number.get("curvStart", 0.0))
        last = number.get("curvature", number.get("curvEnd", 0.0))
        turn = first * at + (last - first) / length * at**2 / 2
        middle = (turn[1:] + turn[:-1]) / 2
        step = length / steps
        u = np.concatenate([[0], np.cumsum(np.cos(middle) * step)])
        v = np.concatenate([[0], np.cumsum(np.sin(middle) * step)])
    else:
        if form.tag == "poly3":
            p = np.linspace(0, length, steps + 1)
            u, v = p, sum(number[key] * p**i for i, key in enumerate("abcd"))
        else:
            p = np.linspace(0, 1.0 if form.get("pRange") == "normalized" else length, steps + 1)
            u, v = (sum(number[key + axis] * p**i for i, key in enumerate("abcd")) for axis in "UV")
        at = np.concatenate([[0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))])
        if form.tag == "paramPoly3":
            at *= length / at[-1]
        turn = np.unwrap(np.arctan2(np.gradient(v, p), np.gradient(u, p)))
    u, v, turn = (np.interp(s, at, values) for values in (u, v, turn))
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack([x + cos * u - sin * v, y + sin * u + cos * v, heading + turn])
