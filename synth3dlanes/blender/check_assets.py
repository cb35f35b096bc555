"""Check a folder of a user's own assets: measure usable files, and report the problems of the others.

Run it in a separate process: it resets Blender for every file.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError

from synth3dlanes.blender.load_assets import read_sky
from synth3dlanes.blender.user_models import ImportedMesh, ModelKind, import_model, points_of
from synth3dlanes.imaging.user_sky import brightest_azimuth
from synth3dlanes.scene.assets.catalogue import (
    THING_FOLDERS,
    AssetKind,
    Assets,
    CarModel,
    Sky,
    Texture,
    ThingModel,
    TreeModel,
    vehicle_class,
)
from synth3dlanes.scene.assets.folder import (
    AssetFiles,
    AssetRow,
    CarNotes,
    FolderCheck,
    Notes,
    digest,
    pose_files,
    read_notes,
    scan,
    texture_digest,
)
from synth3dlanes.system.errors import FormatError

CAR_LENGTH_M, TREE_HEIGHT_M, THING_HEIGHT_M = (2.5, 20.0), (0.3, 60.0), (0.2, 3.0)
TRIANGLES: dict[ModelKind, int] = {"car": 15_000, "tree": 10_000, **dict.fromkeys(THING_FOLDERS.values(), 5_000)}
TOO_MANY = 10  # this many times the limit is an error
# Tolerances: of a car's lowest point around z = 0 (it is moved there), of a tree's above it, and of its roots below it,
# as a share of its height.
STANDS_M, FLOATS_M, ROOTS = 0.05, 0.02, 0.15
# Without a material named as tyres, these are the vertices within CONTACT_M of the ground; without any, wheels have
# these shares of the body's size.
CONTACT_M, WHEELBASE, TRACK, WHEEL_RADIUS = 0.03, 0.6, 0.84, 0.2
MIN_TEXTURE_PX = 256
SIZE_DECIMALS = 4
UNITS = ((100.0, "centimetres"), (1000.0, "millimetres"), (39.37, "inches"), (0.01, "units of 100 m"))


@dataclass
class AssetFindings:
    """The assets, problems and warnings found so far."""

    rows: list[AssetRow] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class PoseFile(NamedTuple):
    """What a file of a thing has: its vertices, the names of its paints, and the number of its triangles."""

    points: Float[np.ndarray, "v 3"]
    paints: tuple[str, ...]
    n_triangles: int


def check_folder(root: Path) -> FolderCheck:
    """Check a folder; raise InputError if it does not exist."""
    folder = scan(root)
    notes, note_problems = read_notes(root, folder)
    found = AssetFindings(problems=[*folder.problems, *note_problems])
    found.warnings += [f"{name}: not used: unknown name or suffix" for name in folder.unknown]
    cars = [_car(name, path, notes, found) for name, path in folder.models["cars"].items()]
    trees = [_tree(name, path, found) for name, path in folder.models["trees"].items()]
    assets = Assets(
        tuple(car for car in cars if car),
        tuple(tree for tree in trees if tree),
        tuple(_textures(folder, "roads", found)),
        tuple(_textures(folder, "terrains", found)),
        tuple(_skies(folder, notes, found)),
        *(tuple(_things(kind, folder, notes, found)) for kind in THING_FOLDERS),
    )
    return FolderCheck(assets, tuple(found.rows), tuple(found.problems), tuple(found.warnings))


def _car(name: str, path: Path, notes: Notes, found: AssetFindings) -> CarModel | None:
    where = f"cars/{path.name}"
    imported = _model(path, "car", where, found)
    if imported is None:
        return None
    points = points_of(imported.mesh)
    width_m, length_m, height_m = (points.max(axis=0) - points.min(axis=0)).tolist()
    problems = _out_of_scale(where, "a length (along y)", length_m, CAR_LENGTH_M)
    if length_m <= width_m:
        problems.append(f"{where}: expected its front towards +y, got {width_m:.2f} m by x, {length_m:.2f} m by y")
    low_m = -float(imported.moved[2])
    if not problems and abs(low_m) > STANDS_M:
        problems.append(f"{where}: expected its wheels on z = 0, got its lowest point at {low_m:.2f} m")
    found.problems += problems
    if problems:
        return None
    noted = notes.cars.get(name, CarNotes())
    measured = [value for value in noted.wheels.values() if value is not None]
    wheelbase_m, track_m, radius_m = measured or _wheels(points, imported.wheels)
    model = CarModel(
        name,
        length_m=round(length_m, SIZE_DECIMALS),
        width_m=round(width_m, SIZE_DECIMALS),
        height_m=round(height_m, SIZE_DECIMALS),
        wheelbase_m=round(wheelbase_m, SIZE_DECIMALS),
        track_m=round(track_m, SIZE_DECIMALS),
        wheel_radius_m=round(radius_m, SIZE_DECIMALS),
        sha256=digest(path),
        category=noted.category or vehicle_class(name, length_m, height_m),
    )
    size = f"{model.category}, "
    size += f"{model.length_m:.2f} x {model.width_m:.2f} x {model.height_m:.2f} m, wheelbase {model.wheelbase_m:.2f} m"
    _add_row(found, "cars", model, size, _triangles(imported.mesh))
    return model


def _tree(name: str, path: Path, found: AssetFindings) -> TreeModel | None:
    where = f"trees/{path.name}"
    imported = _model(path, "tree", where, found)
    if imported is None:
        return None
    points = points_of(imported.mesh)
    low_m, height_m = float(points[:, 2].min()), float(points[:, 2].max())
    crown_m = float(np.quantile(np.hypot(points[:, 0], points[:, 1]), 0.999))
    problems = _out_of_scale(where, "a height", height_m, TREE_HEIGHT_M)
    if not problems and not -ROOTS * height_m <= low_m <= FLOATS_M:
        problems.append(f"{where}: expected its trunk to begin at z = 0, got its lowest point at {low_m:.2f} m")
    middle = (points.min(axis=0) + points.max(axis=0))[:2] / 2
    if not problems and np.hypot(*middle) > 0.5 * crown_m:
        problems.append(
            f"{where}: expected its trunk at x = y = 0, got its middle at ({middle[0]:.2f}, {middle[1]:.2f}) m"
        )
    found.problems += problems
    if problems:
        return None
    model = TreeModel(name, round(height_m, SIZE_DECIMALS), round(crown_m, SIZE_DECIMALS), digest(path))
    _add_row(found, "trees", model, f"{height_m:.2f} m high, crown {2 * crown_m:.2f} m", _triangles(imported.mesh))
    return model


def _things(kind: AssetKind, folder: AssetFiles, notes: Notes, found: AssetFindings) -> Iterator[ThingModel]:
    """The models of a folder of things, with the poses of each."""
    models, problems = pose_files(folder.models[kind])
    found.problems += problems
    for name, paths in models.items():
        where = f"{kind}/{paths[0].name}"
        poses = list[PoseFile]()
        for path in paths:
            imported = _model(path, THING_FOLDERS[kind], f"{kind}/{path.name}", found)
            # The next file takes the mesh away.
            if imported is not None:
                poses.append(PoseFile(points_of(imported.mesh), imported.paints, _triangles(imported.mesh)))
        if len(poses) < len(paths):
            continue
        points = np.concatenate([pose.points for pose in poses])
        low, high = points.min(axis=0), points.max(axis=0)
        problems = _out_of_scale(where, "a height", float(high[2]), THING_HEIGHT_M)
        if not problems and not -STANDS_M <= low[2] <= STANDS_M:
            problems.append(f"{where}: expected its lowest point at z = 0, got it at {low[2]:.2f} m")
        middle = (low + high)[:2] / 2
        if not problems and np.hypot(*middle) > 0.25 * np.hypot(*(high - low)[:2]):
            problems.append(
                f"{where}: expected its middle at x = y = 0, got it at ({middle[0]:.2f}, {middle[1]:.2f}) m"
            )
        for path, pose in zip(paths, poses, strict=True):
            if pose.paints != poses[0].paints:
                wanted, got = (", ".join(paints) or "none" for paints in (poses[0].paints, pose.paints))
                problems.append(f"{kind}/{path.name}: expected the paints of {paths[0].name} ({wanted}), got {got}")
        noted = notes.things.get(name)
        if not problems and (len(poses) > 1) != (noted is not None):
            got = "no stride_m" if noted is None else "one pose"
            problems.append(f"{where}: expected things.{name}.stride_m in assets.yaml with a cycle of poses, got {got}")
        found.problems += problems
        if problems:
            continue
        reach_x_m, reach_y_m = np.maximum(-low, high)[:2].tolist()
        model = ThingModel(
            name,
            width_m=round(2 * reach_x_m, SIZE_DECIMALS),
            length_m=round(2 * reach_y_m, SIZE_DECIMALS),
            height_m=round(float(high[2]), SIZE_DECIMALS),
            paints=poses[0].paints,
            n_poses=len(poses) - 1,
            stride_m=noted.stride_m if noted else 1.0,
            sha256=digest(*paths),
        )
        size = f"{model.width_m:.2f} x {model.length_m:.2f} x {model.height_m:.2f} m, {len(poses)} poses"
        _add_row(found, kind, model, size, max(pose.n_triangles for pose in poses))
        yield model


def _model(path: Path, kind: ModelKind, where: str, found: AssetFindings) -> ImportedMesh | None:
    """The file's mesh in an empty Blender; None, with a problem added, if it cannot be used."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        imported = import_model(path, kind, "model")
    except (RuntimeError, OSError) as error:
        found.problems.append(f"{where}: cannot read it: {' '.join(str(error).split())}")
        return None
    if imported is None:
        found.problems.append(f"{where}: expected a mesh, found no face in it")
        return None
    problems = list(_lost_pictures(where))
    triangles, limit = _triangles(imported.mesh), TRIANGLES[kind]
    if triangles > TOO_MANY * limit:
        problems.append(f"{where}: expected at most {limit:,} triangles, got {triangles:,}; decimate it")
    elif triangles > limit:
        found.warnings.append(f"{where}: {triangles:,} triangles, more than {limit:,}, cost time and memory")
    found.problems += problems
    return None if problems else imported


def _lost_pictures(where: str) -> Iterator[str]:
    """The pictures that are not packed into the file, and so would be missing on another machine."""
    for image in bpy.data.images:
        if image.source in ("FILE", "SEQUENCE", "TILED", "MOVIE") and not image.packed_files:
            yield f"{where}: expected its pictures packed (File > External Data > Pack Resources), got {image.filepath}"
        elif image.source == "FILE" and not image.size[0]:
            yield f"{where}: cannot read its picture {image.name}"


def _out_of_scale(where: str, what: str, metres: float, limits: tuple[float, float]) -> list[str]:
    low, high = limits
    if low <= metres <= high:
        return []
    unit = next((unit for factor, unit in UNITS if low <= metres / factor <= high), None)
    guess = f"; modelled in {unit}?" if unit else ""
    return [f"{where}: expected {what} of {low:g} to {high:g} m, got {metres:.4g} m{guess}"]


def _wheels(points: Float[np.ndarray, "v 3"], named: Float[np.ndarray, "n 3"]) -> tuple[float, float, float]:
    """Wheelbase, track and radius: from the vertices of parts named wheel*, else from the vertices at the ground, else
    as shares of the body's size."""
    width_m, length_m, height_m = (points.max(axis=0) - points.min(axis=0)).tolist()
    radius_m = min(WHEEL_RADIUS * height_m, 0.5)
    for tyres, is_whole in ((named, True), (points[points[:, 2] < CONTACT_M], False)):
        corners = [tyres[(sx * tyres[:, 0] > 0) & (sy * tyres[:, 1] > 0)] for sy in (1, -1) for sx in (-1, 1)]
        if all(map(len, corners)):
            low, high = (np.array([reach(corner, axis=0) for corner in corners]) for reach in (np.min, np.max))
            (x0, y0, _), (x1, y1, _), (x2, y2, _), (x3, y3, _) = (low + high) / 2
            if is_whole:
                radius_m = float((high - low)[:, 2].mean() / 2)
            return float(y0 + y1 - y2 - y3) / 2, float(x1 + x3 - x0 - x2) / 2, radius_m
    return WHEELBASE * length_m, TRACK * width_m, radius_m


def _textures(folder: AssetFiles, kind: AssetKind, found: AssetFindings) -> Iterator[Texture]:
    for name, files in folder.textures[kind].items():
        problems, sizes = [], []
        for path in (files.albedo, files.roughness, files.normal):
            size, problem = _picture_size(path)
            sizes.append(f"{size[0]} px")
            problems += [f"{kind}/{path.name}: {problem}"] if problem else []
        found.problems += problems
        if not problems:
            texture = Texture(name, texture_digest(files))
            _add_row(found, kind, texture, " ".join(dict.fromkeys(sizes)), 0)
            yield texture


def _picture_size(path: Path) -> tuple[tuple[int, int], str]:
    """A texture's size in pixels, and its problem ("" for none)."""
    try:
        with Image.open(path) as picture:
            picture.load()
            width, height = picture.size
    except (UnidentifiedImageError, OSError) as error:
        return (0, 0), f"cannot read it: {error}"
    if width != height:
        return (width, height), f"expected a square picture, got {width}x{height}"
    wrong = f"expected at least {MIN_TEXTURE_PX} px, got {width}" if width < MIN_TEXTURE_PX else ""
    return (width, height), wrong


def _skies(folder: AssetFiles, notes: Notes, found: AssetFindings) -> Iterator[Sky]:
    for name, path in folder.models["skies"].items():
        try:
            upper = read_sky(path)
        except (FormatError, RuntimeError) as error:
            found.problems.append(f"skies/{error}")
            continue
        noted = notes.skies.get(name)
        azimuth_rad = math.radians(noted.sun_azimuth_deg) if noted else brightest_azimuth(upper)
        sky = Sky(name, round(azimuth_rad, 6), digest(path))
        _add_row(found, "skies", sky, f"sun at {math.degrees(azimuth_rad):.0f} deg", 0)
        yield sky


def _triangles(mesh: bpy.types.Mesh) -> int:
    mesh.calc_loop_triangles()
    return len(mesh.loop_triangles)


def _add_row(
    found: AssetFindings,
    kind: AssetKind,
    model: CarModel | TreeModel | ThingModel | Texture | Sky,
    size: str,
    triangles: int,
) -> None:
    number = 1 + sum(row.kind == kind for row in found.rows)
    found.rows.append(AssetRow(kind, number, model.name, size, triangles, model.sha256))
