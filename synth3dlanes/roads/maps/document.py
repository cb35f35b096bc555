"""The XML of a given map: parsed with bounds and without a document type, and its attributes as numbers."""

import gzip
import io
import math
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from pydantic import ValidationError

from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import shown

# As gzip compresses (.xodrz).
GZIP_MAGIC = b"\x1f\x8b"
# Far above the files of towns, which have 20 MB in 300,000 elements.
MAX_FILE_BYTES, MAX_ELEMENTS, MAX_DEPTH = 256 << 20, 5_000_000, 50
# The largest number: coordinates in a UTM grid have up to seven digits.
MAX_NUMBER = 1e8


def inflated(data: bytes, where: str) -> bytes:
    """The data, decompressed where it is of gzip. Raises FormatError for broken data and for more than
    MAX_FILE_BYTES."""
    if not data.startswith(GZIP_MAGIC):
        return data
    try:
        found = gzip.GzipFile(fileobj=io.BytesIO(data)).read(MAX_FILE_BYTES + 1)
    except EOFError:
        raise FormatError(f"{where}: expected data of gzip, got a file that is cut off") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise FormatError(f"{where}: expected data of gzip, got {error}") from None
    if len(found) > MAX_FILE_BYTES:
        raise FormatError(f"{where}: expected at most {MAX_FILE_BYTES:,} bytes in the compressed file, got more")
    return found


def parse_xml(data: bytes, where: str) -> Element:
    """The root of a document, its tags without prefixes of namespaces. Raises FormatError, with one line that begins
    with `where`, for what is no XML, declares a document type or is absurdly large or deep."""
    builder, depth, count = TreeBuilder(), 0, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise FormatError(
                f"{where}: expected at most {MAX_ELEMENTS} elements, {MAX_DEPTH} within each other, got more"
            )
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def refuse(*_: object) -> None:
        # Its entities and the defaults of its attributes make a small file large.
        raise FormatError(f"{where}: expected a map without a document type, got <!DOCTYPE")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda _: None
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: expected XML, got {error}") from None
    return builder.close()


@contextmanager
def passing_over(item: Element, left_out: Counter[str]) -> Iterator[None]:
    """Count an item that is broken, instead of raising its FormatError."""
    try:
        yield
    except (FormatError, ValidationError):
        left_out[f"broken {item.tag}s"] += 1


def number(element: Element, key: str, where: str, default: float | None = None) -> float:
    """An attribute that is a finite number up to MAX_NUMBER. Raises FormatError for another, and for a missing one
    without a default."""
    text = element.get(key)
    if text is None or not text.strip():
        if default is not None:
            return default
        raise FormatError(f"{where}: {element.tag}: {key}: expected a number, got none")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_NUMBER:
        raise FormatError(f"{where}: {element.tag}: {key}: expected a number up to {MAX_NUMBER:g}, got {shown(text)}")
    return value


def whole(element: Element, key: str, where: str) -> int:
    """An attribute that is a whole number of at most four digits."""
    value = number(element, key, where)
    if value != int(value) or abs(value) > 9999:
        raise FormatError(f"{where}: {element.tag}: {key}: expected a whole number, got {shown(element.get(key))}")
    return int(value)
