"""Read OpenLane-V2: the frames of a collection and the lanes of a label file as plain arrays."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.openlane_v2.convention import COLLECTIONS, ROOT
from synth3dlanes.formats.reading import MALFORMED, json_object, read_text


@dataclass(frozen=True, eq=False)
class TopologyFrame:
    """One label file: images by camera, the polylines of each lane (the centre line, and in `-ls` files left and right
    boundary) in the vehicle frame, and which lane (column) follows which (row)."""

    images: dict[str, str]
    lanes_ego: tuple[tuple[Float[np.ndarray, "_ 3"], ...], ...]
    follows: Float[np.ndarray, "n n"]


def frames(out: Path) -> dict[str, list[Path]]:
    """The label files of centre lines of each part."""
    root = out / ROOT
    paths = [root / f"{name}.json" for name in COLLECTIONS]
    path = next((path for path in paths if path.exists()), paths[0])
    listed = json_object(read_text(path), str(path))
    return {
        part: [root / part / segment / "info" / name for segment, names in segments.items() for name in names]
        for part, segments in listed.items()
    }


def parse(text: str, where: str) -> TopologyFrame:
    """One label file, of centre lines or of lane segments; FormatErrors begin with `where`."""
    document = json_object(text, where)
    try:
        annotation, keys = document["annotation"], ["points"]
        if is_segments := "lane_segment" in annotation:
            keys = ["centerline", "left_laneline", "right_laneline"]
        lanes = annotation["lane_segment" if is_segments else "lane_centerline"]
        return TopologyFrame(
            {name: sensor["image_path"] for name, sensor in document["sensor"].items()},
            tuple(tuple(np.array(lane[key], dtype=float).reshape(-1, 3) for key in keys) for lane in lanes),
            np.array(annotation["topology_lsls" if is_segments else "topology_lclc"], dtype=float).reshape(
                len(lanes), len(lanes)
            ),
        )
    except MALFORMED as error:
        raise FormatError(f"{where}: not an OpenLane-V2 frame: {type(error).__name__}: {error}") from None
