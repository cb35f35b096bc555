"""Files from outside, mutated by hypothesis, and what may happen to them."""

import json
import re
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any
from xml.etree import ElementTree

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from synth3dlanes.system.errors import FormatError, Synth3dlanesError

# Examples that write files are slower; `--hypothesis-profile long` takes many of all.
files = settings(
    max_examples=settings().max_examples // 5,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
WHERE = "a/b.x"

# Written as JSON text, so that numbers may be of any size.
HOSTILE = [
    *("null", "true", "false", "0", "1", "-1", "0.5", '""', '"x"', "[]", "{}", "[[]]", '[""]', '{"": 1}'),
    *("NaN", "Infinity", "-Infinity", "1e308", "-1e308", "1e999", "1" + "0" * 400, "-" + "9" * 20, "9" * 5000),
    *('"\\ud800"', '"\\u0000"', '"[/bold]"', '"../../x"', f'"{"x" * 100_000}"'),
    *("[" * 300 + "]" * 300, "[" * 100_000, '{"a":' * 5000 + "1" + "}" * 5000, f"[{'0,' * 20_000}0]"),
]
MARK = "\0hostile\0"
LEAKED = re.compile(
    "BytesIO|python_buffer|pydantic|Traceback|Input should be|Field required|validation error|[A-Z][a-z]+Error"
)


def paths(document: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a document."""
    items = document.items() if isinstance(document, dict) else enumerate(document)
    found = [path]
    for key, value in items:
        found += paths(value, (*path, key)) if isinstance(value, dict | list) else [(*path, key)]
    return found


@st.composite
def edited_json(draw: st.DrawFn, text: str) -> bytes:
    """A document with a value replaced, removed, added or written twice."""
    document = json.loads(text)
    places = draw(st.sampled_from(paths(document)[1:]))
    where = document
    for step in places[:-1]:
        where = where[step]
    kind = draw(st.sampled_from(["replace", "replace", "replace", "remove", "add", "twice"]))
    if kind == "remove":
        del where[places[-1]]
    elif kind == "twice" and isinstance(where, list):
        where.append(where[places[-1]])
    elif kind == "add" and isinstance(where, dict):
        where["new"] = MARK
    else:
        where[places[-1]] = MARK
    return json.dumps(document).replace(json.dumps(MARK), draw(st.sampled_from(HOSTILE))).encode()


@st.composite
def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """Bytes cut short, flipped, removed or added."""
    at = draw(st.integers(0, len(data) - 1))
    end = min(len(data), at + draw(st.integers(0, 40)))
    kind = draw(st.sampled_from(["cut", "flip", "remove", "add", "fill"]))
    if kind == "cut":
        return data[:at]
    if kind == "flip":
        return data[:at] + bytes([data[at] ^ draw(st.integers(1, 255))]) + data[at + 1 :]
    if kind == "remove":
        return data[:at] + data[end:]
    if kind == "add":
        return data[:at] + draw(st.binary(min_size=1, max_size=40)) + data[at:]
    return data[:at] + draw(st.sampled_from([b"\0", b"\xff", b"\x80", b"7"])) * (end - at) + data[end:]


def mutated(data: bytes, is_json: bool = False) -> st.SearchStrategy[bytes]:
    return st.one_of(edited_json(data.decode()), damaged(data)) if is_json else damaged(data)


def refused_or_read(read: Callable[[], Any], *where: str, error: type[Synth3dlanesError] = FormatError) -> Any:
    """What is read, or None after an error of which each of its few short lines names the place, one of `where`."""
    try:
        return read()
    except error as problem:
        lines = str(problem).splitlines()
        assert 1 <= len(lines) <= 9
        for line in lines:
            assert line.startswith(where or WHERE), line
            assert len(line) < 400
            assert not LEAKED.search(line), line
        return None


VALUES = ("", "nan", "inf", "-1", "0", "1e-9", "0.0005", "1e8", "1e300", "x", "-7", "99", "1", "2", "4", "9", "30")
WORDS = (*VALUES, "start", "end", "road", "lanelet", "10001")
TAGS = ("road", "lane", "junction", "spiral", "width", "object", "node", "x")


def edited_xml(data: bytes, n: int, seed: int) -> Iterator[bytes]:
    """`n` times a document with one to four changes: attributes of other values or gone, elements gone, twice,
    elsewhere, in another order or of another name."""
    for i in range(n):
        rng, root = np.random.default_rng([seed, i]), ElementTree.fromstring(data)

        def one_of(items: Any, rng: np.random.Generator = rng) -> Any:
            found = list(items)
            return found[int(rng.integers(len(found)))]

        for _ in range(int(rng.choice([1, 1, 2, 4]))):
            kind, above = int(rng.integers(10)), one_of(at for at in root.iter() if len(at))
            at = one_of(at for at in root.iter() if at.attrib)
            if kind < 4:
                at.set(one_of(at.attrib), one_of(WORDS))
            elif kind == 4:
                del at.attrib[one_of(at.attrib)]
            elif kind == 5:
                above.remove(one_of(above))
            elif kind == 6:
                above[:] = rng.permutation(np.array([*above, None], dtype=object)[:-1]).tolist()
            elif kind == 7:
                at.tag = one_of(TAGS) if at is not root else at.tag
            else:
                (above if kind == 8 else one_of(root.iter())).append(deepcopy(one_of(above)))
        yield ElementTree.tostring(root)
