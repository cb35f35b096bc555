"""Two pages for a person: lanes marked in the top view of a drive, and frames accepted or rejected. Each is a single
HTML file that loads nothing; what is done in it is saved as a download.

The top view has how strongly the ground reflects and how high it is, in square tiles of small cells: the world's x is
to the right, its y up. Scans are read one after the other; tiles are made where the ground was seen.
"""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from scipy import ndimage

from synth3dlanes.figures.page import drawing, render
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.recorded.drives.checks import ground_plane
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame
from synth3dlanes.recorded.drives.marks import REVIEW_FORMAT, REVIEW_VERSION, Review, marks_document
from synth3dlanes.system.arrays import Points3, Polyline2, RgbImage, Scalars
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import encoded

CELL_M, TILE_PX = 0.1, 256
# How far beside the lidar the ground is shown, and how far over or under its plane it may be.
REACH_M, OFF_PLANE_M = 25.0, 0.4
# The most tiles: three numbers for each of their cells take 200 MB, for 3 km of road.
MAX_TILES = 256
# Shares of the values shown that are clipped to black and to white; the least difference of black and white.
DARKER, BRIGHTER, LEAST_CONTRAST = 0.01, 0.01, 0.05
# Slope, in metres per metre, at which the shading is half of all gray.
SHADE_SLOPE = 0.5
# Cells along a side of the square from which an empty one is filled.
FILLED_CELLS = 3


class Tile(NamedTuple):
    """A square of the world from its corner of least x and y: gray and alpha of each pixel, from the top row down."""

    x_m: float
    y_m: float
    intensity: UInt8[np.ndarray, "h w 2"]
    height: UInt8[np.ndarray, "h w 2"]


@dataclass(frozen=True, eq=False)
class TopView:
    """Tiles of `tile_m`, and the path of the host through them."""

    tile_m: float
    tiles: tuple[Tile, ...]
    path: Polyline2


def top_view(drive: Drive, frames: Sequence[DriveFrame] | None = None, cell_m: float = CELL_M) -> TopView:
    """The ground that the scans of these frames, or of all, saw. Raises InputError for a drive without scans, and for
    more than 256 tiles: choose fewer frames then."""
    frames = drive.frames if frames is None else frames
    tiles: dict[tuple[int, int], np.ndarray] = {}
    path = []
    for frame in frames:
        path.append(frame.world_from_host[:2, 3])
        scan = frame.scan()
        if scan is None:
            continue
        kept = _on_ground(scan.xyz_lidar)
        points = transform(scan.world_from_host @ drive.host_from_lidar, scan.xyz_lidar[kept])
        _add(tiles, points, scan.intensity[kept], cell_m)
    if not tiles:
        raise InputError(f"{drive.name}: expected scans with ground in them, got none")
    filled = {place: _filled(tile) for place, tile in tiles.items()}
    shares = np.concatenate([_mean(tile[1], tile[0])[tile[0] > 0] for tile in filled.values()])
    low, high = np.quantile(shares, [DARKER, 1 - BRIGHTER])
    tile_m = TILE_PX * cell_m
    made = [
        Tile(
            column * tile_m,
            row * tile_m,
            _gray(_lightened((_mean(tile[1], tile[0]) - low) / max(high - low, LEAST_CONTRAST)), tile[0] > 0),
            _gray(_shade(_mean(tile[2], tile[0]), cell_m), tile[0] > 0),
        )
        for (column, row), tile in sorted(filled.items())
    ]
    return TopView(tile_m, tuple(made), np.array(path))


def png_url(pixels: UInt8[np.ndarray, "h w 2"]) -> str:
    """Gray and alpha as a PNG file in a data URL."""
    png = encoded(lambda stream: Image.fromarray(pixels, "LA").save(stream, "PNG", optimize=False, compress_level=6))
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


def _on_ground(xyz_lidar: Points3) -> np.ndarray:
    """Which points are near, and by the plane of the ground under the lidar."""
    near = np.hypot(xyz_lidar[:, 0], xyz_lidar[:, 1]) < REACH_M
    plane = ground_plane(xyz_lidar)
    if plane is None:
        return near
    # A road bends: what is farther away may be farther off the plane.
    off = np.abs(xyz_lidar @ plane.normal + plane.height_m)
    return near & (off < OFF_PLANE_M + 0.02 * np.hypot(xyz_lidar[:, 0], xyz_lidar[:, 1]))


def _add(tiles: dict[tuple[int, int], np.ndarray], points: Points3, intensity: Scalars, cell_m: float) -> None:
    """Add points to the sums of their tiles: how many, intensities, heights."""
    cells = np.floor(points[:, :2] / cell_m).astype(int)
    owners = cells // TILE_PX
    for column, row in np.unique(owners, axis=0).tolist():
        tile = tiles.get((column, row))
        if tile is None:
            if len(tiles) == MAX_TILES:
                most_m2 = MAX_TILES * (TILE_PX * cell_m) ** 2
                raise InputError(f"frames: expected ground of {most_m2:,.0f} m2 at most, got more: choose fewer frames")
            tile = tiles[column, row] = np.zeros((3, TILE_PX, TILE_PX), np.float32)
        chosen = (owners == [column, row]).all(axis=1)
        x, y = (cells[chosen] - [column * TILE_PX, row * TILE_PX]).T
        # From the top row down, where y is greatest.
        place = (TILE_PX - 1 - y) * TILE_PX + x
        for at, values in enumerate((None, intensity[chosen], points[chosen, 2])):
            tile[at] += np.bincount(place, values, TILE_PX**2).reshape(TILE_PX, TILE_PX)


def _filled(tile: Float[np.ndarray, "3 h w"]) -> Float[np.ndarray, "3 h w"]:
    """The sums of a tile. Cells without points get their neighbours' sums, so that gaps between beams close."""
    around = ndimage.uniform_filter(tile, (0, FILLED_CELLS, FILLED_CELLS), mode="constant") * FILLED_CELLS**2
    # A sum of zeros may come back as a small number.
    around[:, around[0] < 0.5] = 0
    return np.where(tile[0] > 0, tile, around)


def _mean(total: Float[np.ndarray, "h w"], count: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    return total / np.maximum(count, 1)


def _shade(height: Float[np.ndarray, "h w"], cell_m: float) -> Float[np.ndarray, "h w"]:
    """Slopes as light from the top left would show them, from 0 to 1."""
    down, right = np.gradient(height, cell_m)
    return 0.5 + (right + down) / 2 / SHADE_SLOPE


def _lightened(shares: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Asphalt reflects little: differences between dark values are stretched."""
    return np.sqrt(np.clip(shares, 0, 1))


def _gray(values: Float[np.ndarray, "h w"], is_seen: np.ndarray) -> UInt8[np.ndarray, "h w 2"]:
    gray = np.clip(values, 0, 1) * 255
    return np.stack([np.where(is_seen, gray, 0), np.where(is_seen, 255, 0)], axis=-1).astype(np.uint8)


# A lane to accept or reject is told by one place in each square of this size.
PLACES_M = 2.0


class ReviewedFrame(NamedTuple):
    """A frame to accept or reject: its name, a few words on it, its labels, and its image if there is one."""

    name: str
    words: str
    labels: Labels
    image: RgbImage | None


def marking_page(drive: Drive, view: TopView) -> str:
    """A page on which lines are drawn, moved and deleted on the top view of a drive; it begins with the drive's own
    marked lanes, and saves GeoJSON that `read_marks` reads."""
    origin = np.array(drive.origin_m)
    tiles = [
        {"x": tile.x_m, "y": tile.y_m, "intensity": png_url(tile.intensity), "height": png_url(tile.height)}
        for tile in view.tiles
    ]
    data = {
        "drive": drive.name,
        "origin": origin[:2].tolist(),
        "tile_m": view.tile_m,
        "tiles": tiles,
        "path": np.round(view.path, 2).tolist(),
        # In the drive's world, as everything on the page; the origin is added where lines are saved.
        "marks": marks_document(drive.marked, drive.name),
    }
    return render("marking.html", title=f"lanes of {drive.name}", data=data)


class ReviewedSplit(NamedTuple):
    """What is reviewed: the split, the drive that it was lifted from (empty if from none), and the place of its world
    in the frame of the drive's poses."""

    source: str
    drive: str = ""
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def review_page(split: ReviewedSplit, frames: Iterable[ReviewedFrame], before: Review | None = None) -> str:
    """A page on which frames, and the lanes of a lifted drive, are accepted or rejected; it begins with the verdicts of
    `before`, and saves JSON that `read_review` reads."""
    places: dict[str, dict[tuple[int, ...], list[float]]] = {}
    shown, told = [], []
    for frame in frames:
        lines = [lane for lane in frame.labels.lanes if split.drive and lane.kind == "delimiter"]
        for lane in lines:
            xyz = transform(frame.labels.camera.world_from_cam, lane.xyz_cam) + split.origin_m
            own = places.setdefault(_drive_id(lane), {})
            for xy in np.round(xyz[:, :2], 2).tolist():
                own.setdefault(tuple(int(value // PLACES_M) for value in xy), xy)
        ids = sorted({_drive_id(lane) for lane in lines})
        shown.append((frame.name, frame.words, ids, {**drawing(frame.labels, frame.image), "masks": []}))
        told.append({"name": frame.name, "time_s": frame.labels.time_s})
    data = {
        "format": REVIEW_FORMAT,
        "version": REVIEW_VERSION,
        "source": split.source,
        "drive": split.drive,
        "frames": told,
        "lanes": [{"id": id_, "xy": list(own.values())} for id_, own in places.items()],
        "before": None if before is None else before.model_dump(mode="json"),
    }
    return render("review.html", title=f"frames of {split.source}", frames=shown, data=data)


def _drive_id(lane: Lane) -> str:
    """A lane's id in its whole drive, without the part that names a piece of it in a frame."""
    return lane.id.partition(".")[0]
