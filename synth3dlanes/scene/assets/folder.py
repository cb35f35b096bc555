"""A folder of a user's own assets: its files, their digests, and `assets.yaml`. Reads files; no Blender."""

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, model_validator

from synth3dlanes.scene.assets.catalogue import KINDS, THING_FOLDERS, AssetKind, Assets, Library
from synth3dlanes.scene.things import VehicleClass
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import open_regular
from synth3dlanes.system.schema import DocumentPart, Positive, validation_problems
from synth3dlanes.system.yaml_text import read_yaml, text_of

NOTES = "assets.yaml"
SUFFIXES: dict[AssetKind, tuple[str, ...]] = {
    "cars": (".blend", ".glb"),
    "trees": (".blend", ".glb"),
    **dict.fromkeys(THING_FOLDERS, (".blend", ".glb")),
    "skies": (".hdr", ".exr"),
    "roads": (".jpg", ".jpeg", ".png", ".tif", ".tiff"),
    "terrains": (".jpg", ".jpeg", ".png", ".tif", ".tiff"),
}
TEXTURE_KINDS: tuple[AssetKind, ...] = ("roads", "terrains")
ROLES = ("albedo", "roughness", "normal")
# How the common texture libraries name the maps, with the picture's size at the end: asphalt_02_nor_gl_2k.jpg.
ROLE_WORDS = {
    "albedo": r"albedo|base_?colou?r|diffuse|diff|colou?r|col",
    "roughness": r"roughness|rough",
    "normal": r"normal[_-]?gl|nor[_-]?gl|normal",
}
ROLE_NAME = re.compile(
    r"(?:(?P<name>.+?)[_-])??(?:"
    + "|".join(f"(?P<{role}>{words})" for role, words in ROLE_WORDS.items())
    + r")(?:[_-]\d+k)?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class TextureFiles:
    """The maps of one texture; the normal map follows OpenGL's convention (y up)."""

    albedo: Path
    roughness: Path
    normal: Path


@dataclass(frozen=True)
class AssetFiles:
    """The files of a folder by kind and name, in alphabetical order; its problems; and files that are not used."""

    models: dict[AssetKind, dict[str, Path]]
    textures: dict[AssetKind, dict[str, TextureFiles]]
    problems: tuple[str, ...]
    unknown: tuple[str, ...]


class CarNotes(DocumentPart):
    """A car's wheels, if they cannot be measured from the names of its parts or from its footprint, and its class, if
    neither its name nor its size tells."""

    wheelbase_m: Positive | None = None
    track_m: Positive | None = None
    wheel_radius_m: Positive | None = None
    category: VehicleClass | None = None

    @model_validator(mode="after")
    def _has_all_wheels(self) -> "CarNotes":
        """Check that the wheels have all three measures or none."""
        missing = [name for name, value in self.wheels.items() if value is None]
        if 0 < len(missing) < len(self.wheels):
            raise ValueError(f"{missing[0]}: expected all of {', '.join(self.wheels)} or none, got it missing")
        return self

    @property
    def wheels(self) -> dict[str, float | None]:
        """The measures of the wheels by name."""
        return {name: getattr(self, name) for name in ("wheelbase_m", "track_m", "wheel_radius_m")}


class ThingNotes(DocumentPart):
    """How far a person or a rider goes in a whole cycle of its poses."""

    stride_m: Positive


class SkyNotes(DocumentPart):
    """The azimuth of the sun in a sky picture: degrees from its middle column to the left."""

    sun_azimuth_deg: Annotated[float, Field(ge=-360, le=360)]


class Notes(DocumentPart):
    """`assets.yaml`: values that replace the measured ones, by file name without suffix."""

    cars: dict[str, CarNotes] = Field(default_factory=dict)
    skies: dict[str, SkyNotes] = Field(default_factory=dict)
    things: dict[str, ThingNotes] = Field(default_factory=dict)


@dataclass(frozen=True)
class AssetRow:
    """One row of the table of assets found."""

    kind: AssetKind
    number: int
    name: str
    size: str
    triangles: int
    sha256: str


@dataclass(frozen=True)
class FolderCheck:
    """A folder after its check: the usable assets, and the problems, which prevent its use."""

    assets: Assets
    rows: tuple[AssetRow, ...] = ()
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def scan(root: Path) -> AssetFiles:
    """List the folder; raise InputError if it does not exist."""
    if not root.is_dir():
        raise InputError(f"assets {root}: expected a folder, found none")
    problems: list[str] = []
    unknown = [path.name for path in sorted(root.iterdir()) if path.name not in (*KINDS, NOTES)]
    models: dict[AssetKind, dict[str, Path]] = {kind: {} for kind in KINDS}
    textures: dict[AssetKind, dict[str, TextureFiles]] = {kind: {} for kind in TEXTURE_KINDS}
    for kind in KINDS:
        if kind in TEXTURE_KINDS:
            textures[kind] = _texture_sets(root, kind, problems, unknown)
            continue
        for path in _entries(root / kind):
            if path.suffix.lower() not in SUFFIXES[kind]:
                unknown.append(f"{kind}/{path.name}")
            elif not path.is_file():
                problems.append(f"{kind}/{path.name}: expected a file, got another kind")
            elif path.stem in models[kind]:
                problems.append(
                    f"{kind}/{path.name}: expected one file of this name, got {models[kind][path.stem].name}"
                )
            else:
                models[kind][path.stem] = path
    if not problems and not any(models.values()) and not any(textures.values()):
        problems.append(f"{root}: expected files in {', '.join(f'{kind}/' for kind in KINDS)}, found none")
    return AssetFiles(models, textures, tuple(problems), tuple(unknown))


def read_notes(root: Path, folder: AssetFiles) -> tuple[Notes, list[str]]:
    """`assets.yaml` and its problems, including names without a file."""
    path = root / NOTES
    if not path.exists():
        return Notes(), []
    document, problems = read_yaml(text_of(path, NOTES), NOTES)
    try:
        notes = Notes.model_validate(document or {})
    except ValidationError as error:
        return Notes(), problems + validation_problems(error, NOTES)
    by_kind: list[tuple[AssetKind, list[str]]] = [("cars", list(notes.cars)), ("skies", list(notes.skies))]
    for kind, names in by_kind:
        problems += [
            f"{NOTES}: {kind}.{name}: expected the name of a file in {kind}/"
            for name in names
            if name not in folder.models[kind]
        ]
    among = [name for folder_name in THING_FOLDERS for name in folder.models[folder_name]]
    problems += [
        f"{NOTES}: things.{name}: expected the name of a file in {', '.join(f'{kind}/' for kind in THING_FOLDERS)}"
        for name in notes.things
        if name not in among
    ]
    return notes, problems


def pose_files(files: dict[str, Path]) -> tuple[dict[str, list[Path]], list[str]]:
    """The files of each model of a thing by its name, NAME.glb at rest and then NAME.1.glb, NAME.2.glb, ... of its
    cycle, and problems."""
    found: dict[str, dict[int, Path]] = {}
    for stem, path in files.items():
        pose = re.fullmatch(r"(.+)\.(\d{1,3})", stem)
        name, number = (pose[1], int(pose[2])) if pose else (stem, 0)
        found.setdefault(name, {})[number] = path
    problems, whole = list[str](), dict[str, list[Path]]()
    for name, poses in found.items():
        missing = [number for number in range(max(poses)) if number not in poses]
        if missing:
            there, wanted = poses[min(poses)], f"{name}.{missing[0]}" if missing[0] else name
            where = f"{there.parent.name}/{there.name}"
            problems.append(f"{where}: expected the poses 0 to {max(poses)}, got no {wanted}")
        else:
            whole[name] = [poses[number] for number in sorted(poses)]
    return whole, problems


def digest(*paths: Path) -> str:
    """The SHA-256 of a file's bytes; for several files, the SHA-256 of their digests joined by spaces."""
    digests = []
    for path in paths:
        with open_regular(path) as stream:
            digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
    return digests[0] if len(digests) == 1 else hashlib.sha256(" ".join(digests).encode()).hexdigest()


def texture_digest(files: TextureFiles) -> str:
    """The digest of a texture set."""
    return digest(files.albedo, files.roughness, files.normal)


def require_assets(recorded: Assets, library: Library, where: str) -> None:
    """Raise InputError unless the library holds the assets that the scene was drawn for, by name and digest."""
    problems = []
    for kind in KINDS:
        expected, found = (
            [f"'{own.name}' with digest {own.sha256[:12]}" for own in assets.own(kind)]
            for assets in (recorded, library.assets)
        )
        if expected != found:
            wanted, given = (", ".join(names) or "the built-in ones" for names in (expected, found))
            problems.append(
                f"{where}: {kind}: expected {wanted}, got {given}; use the assets folder that the scene was drawn with"
            )
    if problems:
        raise InputError(*problems)


def verified(path: Path, sha256: str) -> Path:
    """The path, if the file still has the digest of its check; raise FormatError otherwise."""
    if digest(path) != sha256:
        raise FormatError(f"{path}: the file has changed since it was checked: expected SHA-256 {sha256[:12]}...")
    return path


def _entries(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if not path.name.startswith(".")) if folder.is_dir() else []


def _texture_sets(root: Path, kind: AssetKind, problems: list[str], unknown: list[str]) -> dict[str, TextureFiles]:
    """The texture sets of one kind; each incomplete set adds a problem."""
    maps: dict[str, dict[str, Path]] = {}
    for path, folder_name in _texture_files(root / kind):
        relative = path.relative_to(root)
        found = ROLE_NAME.fullmatch(path.stem) if path.suffix.lower() in SUFFIXES[kind] else None
        name = folder_name or (found and found["name"])
        if found is None or not name:
            unknown.append(str(relative))
            continue
        role = next(role for role in ROLES if found[role])
        if role in maps.setdefault(name, {}):
            problems.append(f"{relative}: expected one {role} map of {name}, got {maps[name][role].name}, too")
        maps[name][role] = path
    for name, found_maps in maps.items():
        missing = [role for role in ROLES if role not in found_maps]
        if missing:
            there = ", ".join(path.name for path in found_maps.values())
            problems.append(
                f"{kind}/{name}: expected albedo, roughness and normal, got no {', no '.join(missing)} ({there})"
            )
    return {
        name: TextureFiles(*(maps[name][role] for role in ROLES))
        for name in sorted(maps)
        if len(maps[name]) == len(ROLES)
    }


def _texture_files(folder: Path) -> Iterator[tuple[Path, str]]:
    """Every file with the name of its sub-folder, "" for none."""
    for path in _entries(folder):
        if path.is_dir():
            yield from ((below, path.name) for below in _entries(path))
        else:
            yield path, ""
