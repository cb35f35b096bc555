"""Read a split of a dataset: its length, any sample at once, any member alone. Needs neither Blender nor torch.

The folder may be any address that fsspec knows (`s3://...`). A Reader holds no open file and no connection, so it may
be pickled, forked and used by many threads.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int, Shaped, UInt8
from pydantic import ValidationError

from synth3dlanes.dataset.address import can_list, connect, read_file, splits_near, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, names_of, parse_description, pictures_per_scene
from synth3dlanes.dataset.format import (
    BLOCK,
    HEIGHT,
    LABELS,
    LIDAR,
    PASSES,
    SCENE,
    Sample,
    decode_image,
    member_name,
    read_passes,
    read_sweep,
)
from synth3dlanes.dataset.index import (
    SHOT_COLUMNS,
    check_places,
    place_columns,
    read_index,
    recipe_of,
    require_columns,
)
from synth3dlanes.dataset.listing import inner_data_sets, read_shards
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import ObjectLabel, Objects, stacked
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import AHEAD_DEG, validation_problems

KEY_DIGITS = 8
SIZE_COLUMNS = ("camera_width_px", "camera_height_px")


class Reader:
    """The samples of a split, such as `DIR/train`, in the order of their keys. Raises FormatError for files that do not
    follow the format.

    `index` is a table with a row for each sample: byte offsets, scene parameters and a summary of the labels
    (`docs/format.md`); with `columns`, only the offsets and these columns. Of 300,000 samples, offsets take 20 MB and
    the whole table 200 MB. `scene_of`, `frame_of` and `camera_of` are arrays with the scene, the frame and the camera
    of each sample. `recipes` are the recipes of the shards, as their indices have them ("" for none).
    """

    @checked
    def __init__(self, url: str | Path, columns: Sequence[str] | None = None) -> None:
        self.url = str(url).rstrip("/")
        self.description = self._describe()
        self._names = names_of(self.description)
        has_shots = pictures_per_scene(self.description) > 1
        wanted = ["key", "index", *SIZE_COLUMNS, *place_columns(self._names), *(SHOT_COLUMNS if has_shots else ())]
        chosen = () if columns is None else tuple(dict.fromkeys((*wanted, *columns)))
        shards = read_shards(self.url, self.description, partial(self._table, required=wanted, chosen=chosen))
        if not shards:
            raise FormatError(f"{self.url}: expected shards (00000.tar with 00000.parquet), got none")
        tables = [shard.index for shard in shards]
        self._tars, self._tar_bytes = [shard.tar for shard in shards], [shard.tar_bytes for shard in shards]
        self._shard = np.repeat(np.arange(len(tables)), [table.num_rows for table in tables])
        if any(table.schema != tables[0].schema for table in tables):
            raise FormatError(f"{self.url}: expected the same columns in all shards, got others")
        self.index = pa.concat_tables(tables)
        self.recipes = {recipe_of(table.schema.metadata) for table in tables}
        self._columns = {
            name: tuple(self.index[column].to_numpy() for column in place_columns([name])) for name in self._names
        }
        self._indices = self.index["index"].to_numpy()
        self.scene_of = self.index["scene"].to_numpy() if has_shots else self._indices
        self.frame_of = self.index["frame"].to_numpy() if has_shots else np.zeros(len(self), int)
        self.camera_of = self.index["camera"].to_numpy() if has_shots else np.zeros(len(self), int)

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    @checked
    def __getitem__(self, i: int) -> Sample:
        image_name, where = self._names[0], self._where(i)
        raw = self._members(i, (image_name, *(name for name in (SCENE, LABELS) if name in self._names)))
        labels = labels_module.from_json(raw[LABELS], f"{where}.{LABELS}")
        size_px = labels.camera.width_px, labels.camera.height_px
        image = decode_image(raw[image_name], f"{where}.{image_name}", size_px)
        return Sample(self.key(i), image, labels, raw.get(SCENE))

    @checked
    def key(self, i: int) -> str:
        """The key of sample i: eight digits."""
        return str(self.index["key"][self._position(i)])

    @checked
    def image(self, i: int) -> UInt8[np.ndarray, "h w 3"]:
        name = self._names[0]
        return decode_image(self.member(i, name), f"{self._where(i)}.{name}", self._size_px(i))

    @checked
    def labels(self, i: int) -> Labels:
        """The labels of sample i, read without its image."""
        return labels_module.from_json(self.member(i, LABELS), f"{self._where(i)}.{LABELS}")

    @checked
    def objects(self, i: int) -> Objects:
        """The objects of sample i as arrays; raise FormatError where its labels are older than objects."""
        return self._stacked(i, "objects")

    @checked
    def traffic_elements(self, i: int) -> Objects:
        """The traffic elements of sample i as arrays; raise FormatError where its labels are older than these."""
        return self._stacked(i, "traffic_elements")

    def _stacked(self, i: int, name: str) -> Objects:
        labels = self.labels(i)
        items: tuple[ObjectLabel, ...] | None = getattr(labels, name)
        if items is None:
            wanted = f"labels with {name.replace('_', ' ')}"
            raise FormatError(f"{self._where(i)}: expected {wanted}, got older ones; generate them again")
        return stacked(items, [segment.id for segment in labels.graph.segments])

    @checked
    def passes(self, i: int) -> dict[str, Shaped[np.ndarray, "..."]]:
        """The passes of sample i by name; empty if the data set has none."""
        found: dict[str, Shaped[np.ndarray, ...]] = {}
        for name in (PASSES, HEIGHT):
            if name in self._names:
                size_px = self._size_px(i) if name == PASSES else None
                found |= read_passes(self.member(i, name), f"{self._where(i)}.{name}", size_px)
        return found

    @property
    def has_lidar(self) -> bool:
        """Whether its samples have the sweep of a lidar."""
        return LIDAR in self._names

    @checked
    def lidar(self, i: int) -> Sweep:
        """The lidar sweep of sample i. Raises FormatError if the data set has none."""
        where = self._where(i)
        lidar = self.labels(i).lidar
        if not self.has_lidar or lidar is None:
            raise FormatError(f"{where}: expected a data set with a lidar (generate --lidar), got one without")
        return read_sweep(self.member(i, LIDAR), f"{where}.{LIDAR}", lidar)

    @checked
    def raw(self, i: int) -> dict[str, bytes]:
        """The bytes of every member of sample i, by name without the key, in one read."""
        return self._members(i, self._names)

    @checked
    def member(self, i: int, name: str) -> bytes:
        """The bytes of one member of sample i, such as `scene.json`."""
        return self._members(i, (name,))[name]

    @checked
    def position(self, key: str) -> int:
        """The position of the sample with this key."""
        is_number = key.isdecimal() and len(key) <= KEY_DIGITS
        i = int(np.searchsorted(self._indices, int(key))) if is_number else len(self)
        if i == len(self) or self._indices[i] != int(key):
            last = self.key(-1) if len(self) else "none"
            raise FormatError(f"{self.url}: expected a sample up to {last}, got {key}")
        return i

    @property
    def scenes(self) -> list[int]:
        """The numbers of all scenes in the split, in order. A clip or a single picture is one scene."""
        return [int(scene) for scene in np.unique(self.scene_of)]

    @checked
    def clip(self, scene: int, camera: int | None = None) -> list[int]:
        """The positions of a scene's samples, frame by frame: by one camera, or by all cameras of each frame in
        turn."""
        is_asked = (self.scene_of == scene) & ((self.camera_of == camera) if camera is not None else True)
        if not is_asked.any():
            by = "" if camera is None else f" by camera {camera}"
            raise FormatError(f"{self.url}: expected pictures of scene {scene}{by}, got none")
        return [int(i) for i in np.flatnonzero(is_asked)]

    @checked
    def rig(self, i: int) -> list[int]:
        """The positions of the samples by all cameras of the rig, at the scene and frame of sample i, in the rig's
        order."""
        i, n = self._position(i), max(1, len(self.cameras))
        near = range(max(0, i - n + 1), min(len(self), i + n))
        moment = self.scene_of[i], self.frame_of[i]
        return [place for place in near if (self.scene_of[place], self.frame_of[place]) == moment]

    @cached_property
    def cameras(self) -> tuple[CameraSpec, ...]:
        """The cameras of the rig, or the user's camera, that the data set was made with; empty if it was made with the
        camera of the parameters."""
        try:
            specs = self.description.get("shots", {}).get("cameras", ())
            return tuple(CameraSpec.model_validate(spec) for spec in specs)
        except ValidationError as error:
            problems = validation_problems(error, f"{self.url}: dataset.json: shots.cameras")
            raise FormatError("\n".join(problems)) from None

    @checked
    def camera_name(self, i: int) -> str:
        """The name of the camera of sample i; "" for a camera without a name."""
        return self.cameras[self.camera_of[self._position(i)]].name if self.cameras else ""

    @checked
    def taken_by(self, names: Sequence[str] = ()) -> Int[np.ndarray, " n"]:
        """The positions of the samples by these cameras; without names, by all cameras turned ahead.

        Raises InputError where there is no such camera.
        """
        known = [spec.name for spec in self.cameras]
        unknown = [name for name in names if name not in known]
        if unknown:
            expected = ", ".join(known) or "none, because this data set has no rig"
            raise InputError(f"cameras: expected some of {expected}, got {', '.join(unknown)}")
        if not known:
            return np.arange(len(self))
        chosen = [i for i, spec in enumerate(self.cameras) if (spec.name in names if names else spec.is_turned_ahead)]
        if not chosen:
            expected = f"a camera within {AHEAD_DEG:.0f} degrees of the driving direction"
            raise InputError(f"{self.url}: expected {expected}, got none")
        return np.flatnonzero(np.isin(self.camera_of, chosen))

    @checked
    def positions(self, scenes: Sequence[int]) -> list[int]:
        """The positions of all samples of these scenes, in order."""
        return [int(i) for i in np.flatnonzero(np.isin(self.scene_of, scenes))]

    def _members(self, i: int, names: tuple[str, ...]) -> dict[str, bytes]:
        """Read these adjacent members in one request, and check that the tar header before each has its name."""
        i = self._position(i)
        places = {name: (int(self._columns[name][0][i]), int(self._columns[name][1][i])) for name in names}
        start = min(offset for offset, _ in places.values()) - BLOCK
        end = max(offset + size for offset, size in places.values())
        shard = self._shard[i]
        tar = self._tars[shard]
        tar_bytes = self._tar_bytes[shard]
        if tar_bytes is not None and end > tar_bytes:
            raise FormatError(f"{tar}: expected at least {end} bytes, got {tar_bytes}")
        data = self._read(tar, start, end)
        if len(data) < end - start:
            raise FormatError(f"{tar}: expected {end - start} bytes from byte {start}, got {len(data)}")
        members = {}
        for name, (offset, size) in places.items():
            found, expected = member_name(data[offset - start - BLOCK : offset - start]), f"{self.key(i)}.{name}"
            if found != expected:
                raise FormatError(f"{tar}: expected {expected} at byte {offset}, got {found[:60]!r}")
            members[name] = data[offset - start : offset - start + size]
        return members

    def _describe(self) -> dict[str, Any]:
        """The checked contents of the `dataset.json` beside the split. Raises FormatError if the split's folder is
        missing."""
        files, root = connect(self.url)
        where = f"{root.rpartition('/')[0]}/{DESCRIPTION}"
        with translate_store_errors(self.url):
            data = read_file(files, where)
            if data is None:
                there = splits_near(self.url)
                raise FormatError(f"{self.url}: expected a split of a data set, as DIR/train, got no {where}{there}")
            if not can_list(files):
                _require_parts_of_files(files, where)
            elif not files.isdir(root):
                raise FormatError(f"{self.url}: expected a split of a data set, got no folder{splits_near(self.url)}")
            else:
                data_set, _, split = self.url.rpartition("/")
                for line in inner_data_sets(data_set or ".", [split]):
                    raise FormatError(line)
        return parse_description(data, where)

    def _table(self, data: bytes, path: str, required: Sequence[str], chosen: Sequence[str]) -> pa.Table:
        table = read_index(data, path, chosen)
        require_columns(table, required, path)
        stem, size = path.rpartition("/")[2].removesuffix(".parquet"), int(self.description["shard_size"])
        if not stem.isdecimal():
            raise FormatError(f"{path}: expected the number of a shard, as in 00000.parquet, got another name")
        check_places(table, self._names, range(int(stem) * size, (int(stem) + 1) * size), path)
        return table

    def _read(self, path: str, start: int, end: int) -> bytes:
        with translate_store_errors(path, "cannot be read"):
            return bytes(connect(self.url)[0].cat_file(path, start=start, end=end))

    def _size_px(self, i: int) -> tuple[int, int]:
        """Width and height of image i, from the index."""
        width, height = (int(self.index[name][self._position(i)].as_py()) for name in SIZE_COLUMNS)
        return width, height

    def _position(self, i: int) -> int:
        if not -len(self) <= i < len(self):
            raise IndexError(f"{self.url}: expected a sample in 0..{len(self) - 1}, got {i}")
        return i % len(self)

    def _where(self, i: int) -> str:
        return f"{self._tars[self._shard[self._position(i)]]}: {self.key(i)}"


def _require_parts_of_files(files: Any, path: str) -> None:
    """Raise FormatError for a server that sends whole files only: reading one sample would transfer its whole shard."""
    if len(files.cat_file(path, start=0, end=1)) != 1:
        raise FormatError(f"{path}: expected a server that sends parts of files (range requests), got the whole file")


def find(place: str) -> tuple[Reader, int]:
    """The split's reader and the position of a sample, by its name, as `DIR/train:00000017`."""
    url, colon, key = place.rpartition(":")
    if not (url and colon and key.isdecimal()):
        raise FormatError(f"{place}: expected a split's folder, a colon and a key, as in DIR/train:00000017")
    reader = Reader(url)
    return reader, reader.position(key)
