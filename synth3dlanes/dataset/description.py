"""`dataset.json`: how the samples of a data set are made, and how many samples each split shall have.

This module alone reads it and decides its bytes. People may have edited it, so every value is checked.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from synth3dlanes.dataset.format import member_names
from synth3dlanes.scene.settings import MAX_SAMPLES, MAX_SHARD_SIZE, MAX_VIEWS, SPLIT_NAME
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import DocumentPart, Seed, parse

DESCRIPTION = "dataset.json"
DATASET_FORMAT = "synth3dlanes.dataset"
DATASET_VERSION = 1
# The licence of images and labels made with the built-in assets.
DATA_LICENSE = "CC0-1.0"

SplitName = Annotated[str, Field(pattern=f"^{SPLIT_NAME}$", max_length=200)]


class Split(DocumentPart):
    """The number of samples that a split shall have."""

    n: Annotated[int, Field(ge=0, le=MAX_SAMPLES)]


class RenderPart(DocumentPart):
    """How images were rendered: samples per pixel, the passes beside the image, the device."""

    samples: Annotated[int, Field(ge=1, le=1_000_000)]
    passes: Annotated[
        tuple[Literal["depth", "normal", "semantic", "instance", "height", "lidar"], ...], Field(max_length=6)
    ]
    device: str


class ShotsPart(DocumentPart):
    """The number of frames, of cameras and of views that see each scene. `scenes.Provenance` reads the rest."""

    model_config = ConfigDict(frozen=True, extra="allow")

    frames: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    cameras: list[Any] = Field(default_factory=list)
    views: Annotated[int, Field(ge=1, le=MAX_VIEWS)] = 1


class Description(DocumentPart):
    """The schema of dataset.json. Parameters and own assets are read by `sources.Provenance` alone."""

    format: Literal["synth3dlanes.dataset"]
    version: Literal[1]
    license: str | None = None
    generator: str
    seed: Seed
    image_format: Literal["jpg", "png"]
    render: RenderPart
    params: dict[str, Any]
    assets: dict[str, Any] = Field(default_factory=dict)
    shots: ShotsPart = ShotsPart()
    like: dict[str, Any] | None = None
    map: dict[str, Any] | None = None
    where: Annotated[str, Field(max_length=10_000)] | None = None
    shard_size: Annotated[int, Field(ge=1, le=MAX_SHARD_SIZE)]
    splits: Annotated[dict[SplitName, Split], Field(max_length=1000)]
    derived: dict[str, Any] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return names_of(self.model_dump())


def parse_description(data: bytes, where: str) -> dict[str, Any]:
    """The contents of `dataset.json`, checked against `Description`.

    Raises FormatError with a line for each problem: `where`, the key, what was expected and what was found.
    """
    parse(Description, data, where, f"{DATASET_FORMAT} version {DATASET_VERSION}")
    document: dict[str, Any] = json.loads(data)
    try:
        json.dumps(document, allow_nan=False)
    except ValueError:
        raise FormatError(f"{where}: expected finite numbers, got NaN or infinity") from None
    return document


def clip_of(description: Mapping[str, Any]) -> tuple[int, float]:
    """The number of frames of a clip, and of frames in a second, from the contents of `dataset.json`."""
    shots = description.get("shots", {})
    return int(shots.get("frames", 1)), float(shots.get("fps", 10.0))


def pictures_per_scene(description: Mapping[str, Any]) -> int:
    """The number of samples that show one scene, from the contents of `dataset.json`."""
    shots = description.get("shots", {})
    return int(shots.get("views", 1)) * clip_of(description)[0] * max(1, len(shots.get("cameras", ())))


def drive_of(description: Mapping[str, Any]) -> str | None:
    """The name of the real drive in which the labels were measured (`lift`), perhaps before the samples were split;
    None of labels of scenes."""
    derived = description.get("derived")
    while isinstance(derived, Mapping):
        if "lifted" in derived:
            return str(derived["lifted"])
        derived = derived.get("derived")
    return None


def is_lifted(description: Mapping[str, Any]) -> bool:
    """Whether the labels were measured in a real drive: there are no scenes then."""
    return drive_of(description) is not None


def names_of(description: Mapping[str, Any]) -> tuple[str, ...]:
    """The members of every sample of a data set."""
    has_scene = not is_lifted(description)
    return member_names(str(description["image_format"]), description["render"]["passes"], has_scene)


def numbers_of_lifted(frames: int, index: int) -> tuple[int, int, int] | None:
    """The numbers of the clip, the frame and the camera of a lifted sample, from the frames of a clip; None in a data
    set without clips."""
    return (*divmod(index, frames), 0) if frames > 1 else None


_ORIGINS = {False: "samples drawn from parameters", True: "samples derived from other data"}


def updated_description(before: bytes | None, recipe: dict[str, Any], split: str, n: int, where: str) -> bytes:
    """`dataset.json` once a split of `n` is asked for; `before` is what it holds now, None where there is none.

    A data set keeps the licence that it has. A new one made with a user's own assets, or lifted from a user's drive,
    gets none: theirs is not known.
    Raises InputError with a line for each key of the recipe that differs from the one there, and FormatError as
    `parse_description` does.
    """
    found = None if before is None else parse_description(before, where)
    is_theirs = any(recipe.get("assets", {}).values()) or is_lifted(recipe)
    new = {} if is_theirs else {"license": DATA_LICENSE}
    licence = {key: value for key, value in (found or new).items() if key == "license"}
    asked = {"format": DATASET_FORMAT, "version": DATASET_VERSION, **licence, **recipe}
    splits: dict[str, Any] = {}
    if found is not None:
        splits = found.pop("splits")
        there, new_ones = (_ORIGINS[bool(description.get("derived"))] for description in (found, asked))
        if there != new_ones:
            raise InputError(f"{where}: expected {there}, as in this data set, got {new_ones}; choose another folder")
        # Through JSON, so that a tuple equals the list that it was written as.
        problems = list(differences(found, json.loads(json.dumps(asked))))
        if problems:
            raise InputError(*(f"{where}: {problem}" for problem in problems))
    splits = {**splits, split: {"n": max(n, splits.get(split, {}).get("n", 0))}}
    return (json.dumps({**asked, "splits": dict(sorted(splits.items()))}, indent=1) + "\n").encode()


def differences(found: Any, asked: Any, name: str = "") -> Iterator[str]:
    """One line for every key in which a recipe differs from the data set's. A missing licence is no difference."""
    if (name == "license" and None in (found, asked)) or (name == "render.device" and asked == "auto"):
        return
    if isinstance(found, dict) and isinstance(asked, dict):
        for key in [*found, *(key for key in asked if key not in found)]:
            yield from differences(found.get(key), asked.get(key), f"{name}.{key}" if name else key)
    elif found != asked:
        yield f"{name}: expected {json.dumps(found)} as in this dataset, got {json.dumps(asked)}"


def recipe_of_description(description: Mapping[str, Any]) -> dict[str, Any]:
    """What a description says about how samples are made: all but format, version and splits."""
    return {key: value for key, value in description.items() if key not in ("format", "version", "splits")}


def recipe_text(description: Mapping[str, Any]) -> str:
    """The recipe of a description, without the licence, as text; equal recipes give equal text."""
    recipe = {key: value for key, value in recipe_of_description(description).items() if key != "license"}
    # Through JSON, so that a tuple equals the list that it is read back as; 3.0 equals 3.
    canonical = json.loads(json.dumps(recipe), parse_float=_whole)
    return json.dumps(canonical, sort_keys=True, separators=(",", ":"))


def _whole(text: str) -> float:
    number = float(text)
    return int(number) if number.is_integer() else number
