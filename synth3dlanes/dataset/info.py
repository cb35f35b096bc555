"""What a data set holds, from `dataset.json`, the indices and the files' sizes. No sample is read."""

from dataclasses import dataclass
from typing import Any

from synth3dlanes.dataset.address import can_list, connect, splits_near, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, drive_of, parse_description
from synth3dlanes.dataset.index import read_indices
from synth3dlanes.dataset.listing import data_set_of, inner_data_sets, read_shards
from synth3dlanes.params.params_text import preset_of
from synth3dlanes.system.errors import FormatError


@dataclass(frozen=True)
class SplitInfo:
    """A split: the number of samples asked for, in finished shards, in shards in progress, and set aside; its shards
    and bytes; `complete` if every sample asked for is in a finished shard."""

    name: str
    asked: int
    joined: int
    waiting: int
    set_aside: int
    shards: int
    bytes: int
    complete: bool


@dataclass(frozen=True, eq=False)
class DatasetInfo:
    """A data set: the recipe of its samples and what it says in short, and its splits.

    `preset` is what the parameters are called, or which real drive was lifted, `image_sizes` are as "480x360" (none of
    a drive), `cameras` the names of a rig's, and `frames_per_second` is None where scenes have one frame.
    """

    recipe: dict[str, Any]
    preset: str
    image_sizes: tuple[str, ...]
    cameras: tuple[str, ...]
    frames_per_scene: int
    frames_per_second: float | None
    splits: tuple[SplitInfo, ...]


def dataset_info(url: str) -> DatasetInfo:
    """Count the samples and bytes of a data set, or of one split, at any address that fsspec can open."""
    root_url, only = data_set_of(url)
    files, root = connect(root_url)
    where = f"{root_url}/{DESCRIPTION}"
    with translate_store_errors(where, "cannot be read"):
        recipe = parse_description(files.cat_file(f"{root}/{DESCRIPTION}"), where)
    splits = {name: entry["n"] for name, entry in recipe["splits"].items() if only in ("", name)}
    if only and not splits:
        raise FormatError(f"{url}: expected a data set or one of its splits{splits_near(url)}")
    for line in inner_data_sets(root_url, splits):
        raise FormatError(line)
    with translate_store_errors(url):
        found = tuple(_split(root_url, recipe, name, asked) for name, asked in splits.items())
    shots, drive = recipe.get("shots", {}), drive_of(recipe)
    own, frames = shots.get("cameras", []), int(shots.get("frames", 1))
    # People may have edited them: what is no camera is left out.
    cameras = [camera for camera in own or [recipe["params"].get("camera")] if isinstance(camera, dict)]
    sizes = (
        f"{camera['width_px']}x{camera['height_px']}" for camera in cameras if {"width_px", "height_px"} <= {*camera}
    )
    return DatasetInfo(
        {key: value for key, value in recipe.items() if key != "splits"},
        preset_of(recipe["params"]) if drive is None else f"real drive {drive}",
        tuple(dict.fromkeys(sizes)),
        tuple(str(camera["name"]) for camera in cameras if camera.get("name")),
        frames,
        _number(shots.get("fps")) if frames > 1 else None,
        found,
    )


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _split(place: str, description: dict[str, Any], name: str, asked: int) -> SplitInfo:
    files, root = connect(place)
    shards = read_shards(f"{place}/{name}", description, read_indices)
    indices = set[int]().union(*(shard.index for shard in shards))
    if can_list(files):
        found = files.find(f"{root}/{name}", detail=True)
        sizes = {path.removeprefix(f"{root}/{name}/"): int(entry["size"]) for path, entry in found.items()}
        failed = files.ls(f"{root}/failed/{name}") if files.isdir(f"{root}/failed/{name}") else []
    else:
        sizes = {path: int(files.size(path) or 0) for shard in shards for path in (shard.parquet, shard.tar)}
        failed = []
    parts = {path for path in sizes if ".parts/" in path and path.endswith(".tar")}
    keys = {path.rpartition("/")[2].removesuffix(".tar") for path in parts}
    waiting = {int(key) for key in keys if key.isdecimal()} - indices
    joined = sum(index < asked for index in indices)
    counts = asked, joined, len(waiting), len(failed), len(shards), sum(sizes.values())
    return SplitInfo(name, *counts, complete=joined >= asked)
