"""`croissant.json` beside `dataset.json`: the data set in the terms of Croissant (https://mlcommons.org/croissant/).

Data sets grow, so it has no digests of files; the index of a shard has the digest of each sample.
"""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from synth3dlanes.dataset.description import is_lifted, names_of
from synth3dlanes.dataset.format import COLUMN_OF_MEMBER, LABELS

CROISSANT = "croissant.json"
# Only a file with this text is written anew when a data set grows.
MARK = "Written by synth3dlanes. Remove this key to keep changes of your own."

# Croissant names every archive. Of a data set with more shards it says only how they are named.
MOST_SHARDS = 10_000

TAR = "application/x-tar"
_TYPES = {"jpg": "image/jpeg", "png": "image/png", "json": "application/json", "exr": "image/x-exr"}
_ML = "http://mlcommons.org/croissant/"
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": _ML,
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "data": {"@id": "cr:data", "@type": "@json"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": f"{_ML}RAI/",
    **{
        name: f"cr:{name}"
        for name in (
            *("citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty", "fileSet"),
            *("format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet"),
            *("references", "regex", "repeated", "replace", "samplingRate", "separator", "source", "subField"),
            "transform",
        )
    },
}


def croissant(description: Mapping[str, Any]) -> bytes:
    """The file of a data set by the contents of its `dataset.json`; equal contents give equal bytes."""
    licence = description.get("license")
    is_measured = is_lifted(description)
    what = "Images of a real drive with measured" if is_measured else "Rendered road images with exact"
    size = int(description["shard_size"])
    splits = {name: math.ceil(int(split["n"]) / size) for name, split in description["splits"].items()}
    is_listed = sum(splits.values()) <= MOST_SHARDS
    names = names_of(description)
    document = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "creativeWorkStatus": MARK,
        "conformsTo": f"{_ML}1.0",
        "name": "measured-3d-lanes" if is_measured else "synthetic-3d-lanes",
        "description": f"{what} 3D lane labels; README.md says how they were made.",
        "citeAs": "N. Garnett et al., 3D-LaneNet: End-to-End 3D Multiple Lane Detection, ICCV 2019",
        "version": description["generator"],
        **({"license": f"https://spdx.org/licenses/{licence}.html"} if licence else {}),
        "isLiveDataset": True,
        "distribution": [
            part for name, n in splits.items() for part in (_files(name, n, names) if is_listed else _shards(name))
        ],
        "recordSet": [record for name in splits if is_listed for record in _records(name, names[0])],
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _shards(split: str) -> Iterator[dict[str, Any]]:
    """The shards of a split by the form of their names."""
    yield {
        "@type": "cr:FileSet",
        "@id": f"{split}/shards",
        "name": f"{split}-shards",
        "encodingFormat": TAR,
        "includes": f"{split}/*.tar",
    }


def _files(split: str, n: int, names: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """The `n` shards of a split, each by its name, and the members of samples in them."""
    shards = [f"{split}/{number:05d}.tar" for number in range(n)]
    for shard in shards:
        yield {
            "@type": "cr:FileObject",
            "@id": shard,
            "name": shard.replace("/", "-"),
            "contentUrl": shard,
            "encodingFormat": TAR,
        }
    for name in names:
        yield {
            "@type": "cr:FileSet",
            "@id": f"{split}/{COLUMN_OF_MEMBER[name]}-files",
            "name": f"{split}-{COLUMN_OF_MEMBER[name]}-files",
            "containedIn": [{"@id": shard} for shard in shards],
            "encodingFormat": _TYPES[name.rpartition(".")[2]],
            "includes": f"*.{name}",
        }


def _records(split: str, image: str) -> Iterator[dict[str, Any]]:
    """The images of a split and its labels, in one order; a sample has the same key in both."""
    contents = ((image, "sc:ImageObject", "the image, RGB"), (LABELS, "sc:Text", "JSON: lanes with their points in 3D"))
    for member, kind, words in contents:
        column = COLUMN_OF_MEMBER[member]
        name, files = f"{split}/{column}", {"fileSet": {"@id": f"{split}/{column}-files"}}
        key = {"extract": {"fileProperty": "filename"}, "transform": {"regex": r"^(\d{8})\."}}
        yield {
            "@type": "cr:RecordSet",
            "@id": name,
            "name": name.replace("/", "-"),
            "key": {"@id": f"{name}/key"},
            "field": [
                _field(f"{name}/key", "sc:Text", "the sample", {**files, **key}),
                _field(f"{name}/{column}", kind, words, {**files, "extract": {"fileProperty": "content"}}),
            ],
        }


def _field(name: str, kind: str, words: str, source: dict[str, Any]) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": name,
        "name": name.replace("/", "-"),
        "description": words,
        "dataType": kind,
        "source": source,
    }
