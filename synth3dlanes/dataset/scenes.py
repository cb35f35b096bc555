"""Scenes of files and data sets, as a user names them: a scene.json, a sample such as `DIR/train:00000017`, or some
samples of a split; and how the scenes of a data set were drawn."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ValidationError

from synth3dlanes.dataset.address import SAMPLE, splits_near
from synth3dlanes.dataset.description import DESCRIPTION, RenderPart, is_lifted
from synth3dlanes.dataset.format import SCENE
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.dataset.splits import readers
from synth3dlanes.draw.like import Neighbourhood
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.params import Params
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.scene import Scene, from_json
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import read_bounded
from synth3dlanes.system.schema import MAX_BYTES, Excerpt, Seed, validation_problems


def scene_name(path: Path) -> str:
    """The stem of the files that are made from a scene: 00000017 for 00000017.scene.json, scene for scene.json."""
    return path.name.removesuffix(".json").removesuffix(".scene")


def load_scene(path: Path) -> Scene:
    """Read a scene.json; raise FormatError with one line per problem."""
    return from_json(read_bounded(path, MAX_BYTES), str(path))


def find_scene(where: str) -> tuple[str, Scene]:
    """A scene and its name. `where` is a scene file or a sample `DIR/SPLIT:KEY`."""
    if SAMPLE.fullmatch(where):
        reader, position = find(where)
        return reader.key(position), read_scene(reader, position)
    if Path(where).is_dir():
        there = splits_near(where)
        raise FormatError(f"{where}: expected a scene.json or a sample, as DIR/train:00000017, got a folder{there}")
    if ":" in Path(where).name and not Path(where).exists():
        find(where)  # says what is wrong with the key
    return scene_name(Path(where)), load_scene(Path(where))


@checked
def read_scene(reader: Reader, i: int) -> Scene:
    """The scene of one sample, read without its image and labels. Raises InputError for a sample without a scene."""
    if is_lifted(reader.description):
        known = "one that was lifted from a real drive, of which only the image and the lanes are known"
        raise InputError(f"{reader.url}:{reader.key(i)}: expected a sample with a scene, got {known}")
    return from_json(reader.member(i, SCENE), f"{reader.url}:{reader.key(i)}")


def _in_order(document: Any) -> Any:
    """Assets as tuples, as a scene has them. dataset.json has them as mappings by name, in the same order."""
    if not isinstance(document, dict):
        return document
    return {kind: tuple(own.values()) if isinstance(own, dict) else own for kind, own in document.items()}


class GivenPlace(Excerpt):
    """The host's place on a map in all scenes: a lane, by its name in the scene, and a station of its road."""

    lane: str
    s_m: float

    def text(self) -> str:
        """The place as `--at` takes it: ROAD:s:lane."""
        road, _, number = self.lane.rsplit(".", 2)
        return f"{road}:{self.s_m!r}:{number}"


class GivenFile(Excerpt):
    """The map file that scenes were drawn on, its SHA-256, and the host's place if that is one for all."""

    file: str
    digest: str
    at: GivenPlace | None = None


class Provenance(Excerpt):
    """The part of a dataset.json that says how its scenes were drawn and rendered."""

    seed: Seed
    image_format: Literal["jpg", "png"]
    render: RenderPart
    params: Params
    assets: Annotated[Assets, BeforeValidator(_in_order)] = Assets()
    shots: Shots = SINGLE
    like: Neighbourhood | None = None
    map: GivenFile | None = None
    where: str | None = None

    def scenes(self, split: str) -> Scenes:
        """The scenes of a split. Raises InputError for scenes on a map, whose file a data set does not keep."""
        if self.map is not None:
            raise InputError(f"expected scenes that can be drawn again, got those of the map {self.map.file}")
        return Scenes(self.params, self.seed, split, assets=self.assets, shots=self.shots, like=self.like)


def read_provenance(description: Mapping[str, Any], where: str) -> Provenance:
    """How the scenes of a data set were drawn, from the contents of its dataset.json. Raises FormatError with a line
    for every problem, beginning with `where`."""
    try:
        return Provenance.model_validate(description)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, where))) from None


def provenance_of(reader: Reader) -> Provenance:
    """How the scenes of a data set were drawn. Raises FormatError like `read_provenance`."""
    return read_provenance(reader.description, f"{reader.url}: {DESCRIPTION}")


def scenes_of(reader: Reader) -> Scenes:
    """The scenes of a split, to be drawn again. Raises FormatError like `provenance_of`, and InputError for scenes on a
    map."""
    return provenance_of(reader).scenes(reader.url.rpartition("/")[2])


def some_samples(folder: str, n: int, shuffle: int | None, where: str | None) -> list[tuple[Reader, int]]:
    """At most `n` samples of a split, as (reader, position): the first ones, or a random choice with the seed
    `shuffle`. `where` is a query on the index that selects samples.

    For a data set, its first split is used. Raises InputError if no sample is left.
    """
    reader = readers(folder)[0]
    chosen = np.arange(len(reader)) if where is None else rows_where(reader.index, where)
    if not len(chosen):
        raise InputError(f"where {where}: expected a sample of {reader.url} that fits, got none of {len(reader)}")
    if shuffle is not None:
        chosen = np.random.default_rng(shuffle).permutation(chosen)
    return [(reader, int(i)) for i in chosen[:n]]
