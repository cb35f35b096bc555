"""Two pages for a person: lanes marked in the top view of a drive, and frames accepted or rejected. Each is a single
HTML file that loads nothing; what is done in it is saved as a download."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from synth3dlanes.figures.page import drawing, render
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.drives.marks import marks_document
from synth3dlanes.recorded.drives.review import REVIEW_FORMAT, REVIEW_VERSION, Review
from synth3dlanes.recorded.drives.top_view import TopView, png_url
from synth3dlanes.system.arrays import RgbImage

# Of a lane to accept or reject, a place is kept for each square of this size.
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
        shown.append((frame.name, frame.words, ids, drawing(frame.labels, frame.image)._replace(masks=[])))
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
    """A lane's id in its whole drive: that of a frame may name a piece of it."""
    return lane.id.partition(".")[0]
