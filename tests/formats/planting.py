"""Faults in the files of an export: what is read of a file is changed, and written again; what `verify` finds then."""

import json
from xml.etree import ElementTree

import numpy as np
from pyarrow import Table, feather, parquet

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify


def _rows(read, write):
    """Rows of a table, which keeps its schema."""
    return lambda path: read(path).to_pylist(), lambda path, rows: write(
        Table.from_pylist(rows, schema=read(path).schema), path
    )


KINDS = {
    ".json": (lambda path: json.loads(path.read_text()), lambda path, found: path.write_text(json.dumps(found))),
    ".txt": (lambda path: path.read_text(), lambda path, text: path.write_text(text)),
    ".feather": _rows(feather.read_table, feather.write_feather),
    ".parquet": _rows(parquet.read_table, parquet.write_table),
    ".npy": (np.load, np.save),
    **dict.fromkeys(
        (".osm", ".xodr"),
        (
            lambda path: ElementTree.fromstring(path.read_text()),
            lambda path, root: path.write_text(ElementTree.tostring(root, encoding="unicode")),
        ),
    ),
}


def other(pattern, change):
    """Plants another document, other rows, another array, root or text in the first file of a pattern. `change` returns
    it, or changes it in place."""

    def plant(out):
        path = sorted(out.glob(pattern))[0]
        read, write = KINDS[path.suffix]
        found = read(path)
        made = change(found)
        write(path, found if made is None else made)

    return plant


def each(change):
    """Rows of which each is changed in place."""

    def all_of(rows):
        for row in rows:
            change(row)

    return all_of


def swapped_tracks(instant, track):
    """Rows in whose last instant, by one of their keys, each track has the box of another one."""

    def change(rows):
        last = max(row[instant] for row in rows)
        later = [row for row in rows if row[instant] == last]
        names = [row[track] for row in later]
        for row, name in zip(later, names[1:] + names[:1], strict=True):
            row[track] = name

    return change


def problems(source, out, format_name, most_frames=100):
    """All problems of all lists."""
    results = verify(Export(str(source), out, format_name), most_frames)
    return [problem for result in results for problem in result.problems]
