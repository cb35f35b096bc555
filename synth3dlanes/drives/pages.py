"""Two pages for a person: lanes marked in the top view of a drive, and frames accepted or rejected. Each is a single
HTML file that loads nothing; what is done in it is saved as a download."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from synth3dlanes.arrays import RgbImage
from synth3dlanes.drives.drive import Drive
from synth3dlanes.drives.marks import marks_document
from synth3dlanes.drives.review import REVIEW_FORMAT, REVIEW_VERSION
from synth3dlanes.drives.top_view import TopView, png_url
from synth3dlanes.figures.page import drawing, render
from synth3dlanes.labels import Labels


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


def review_page(source: str, frames: Iterable[ReviewedFrame]) -> str:
    """A page on which frames are accepted or rejected; it saves JSON that `read_review` reads."""
    shown = [(frame.name, frame.words, drawing(frame.labels, frame.image)._replace(masks=[])) for frame in frames]
    data = {
        "format": REVIEW_FORMAT,
        "version": REVIEW_VERSION,
        "source": source,
        "names": [name for name, _, _ in shown],
    }
    return render("review.html", title=f"frames of {source}", frames=shown, data=data)
