"""Map files by their names: OpenDRIVE, and Lanelet2 as OSM files."""

from pathlib import Path

from synth3dlanes.roads.maps.document import MAX_FILE_BYTES
from synth3dlanes.roads.maps.given_map import GivenMap, packed, read_opendrive, read_packed
from synth3dlanes.roads.maps.lanelet_map import read_lanelet2
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import read_bounded

LANELET2 = (".osm", ".osm.gz")


def read_map(path: Path) -> GivenMap:
    """Read a map file; the one that was read last is kept. Raises InputError or FormatError with one line for a file
    that is none, or hostile."""
    try:
        data = read_bounded(path, MAX_FILE_BYTES)
    except OSError as error:
        raise InputError(f"map {path}: cannot read: {error.strerror or error}") from None
    read = read_lanelet2 if path.name.lower().endswith(LANELET2) else read_opendrive
    return read_packed(read, packed(data), path.name, f"map {path}")
