"""Compare the lanes that a reader finds in an OpenDRIVE map with those of its scene.

    python -m scripts.compare_map scene.json map.xodr < points.txt

`points.txt` has a line for each point of a lane's centre: the road's id, the lane's number, x, y and z.
"""

import sys
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import cKDTree

from synth3dlanes.formats.opendrive.convention import USER_DATA
from synth3dlanes.scene import from_json
from synth3dlanes.world import resolve

STATIONS_M = np.arange(-262.0, 302.0, 0.05)


def differences(scene: Path, road_map: Path, lines: list[str]) -> np.ndarray:
    """Distance from above and height difference of each point, in metres."""
    world = resolve(from_json(scene.read_text(), str(scene)))
    segments = {
        (road.get("id"), lane.get("id")): data.attrib["value"]
        for road in ElementTree.parse(road_map).getroot().iter("road")
        for lane in road.iter("lane")
        for data in lane.iter("userData")
        if data.get("code") == USER_DATA
    }
    curves = {line.id: line.points_world(STATIONS_M) for line in world.site.lines if line.kind == "centerline"}
    points = defaultdict(list)
    for line in lines:
        road, lane, *xyz = line.split()
        segment = segments[road, lane]
        points[world.network.path(segment).id].append([float(value) for value in xyz])
    return np.concatenate([_apart(np.array(read), curves[path]) for path, read in points.items()])


def _apart(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    i = np.clip(cKDTree(curve[:, :2]).query(points[:, :2])[1], 1, len(curve) - 2)
    along, to = curve[i + 1] - curve[i - 1], points - curve[i]
    share = (to[:, :2] * along[:, :2]).sum(axis=1) / (along[:, :2] ** 2).sum(axis=1)
    off = to - share[:, None] * along
    return np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])])


if __name__ == "__main__":
    found = 100 * differences(Path(sys.argv[1]), Path(sys.argv[2]), sys.stdin.readlines())
    for name, values in zip(("aside", "height"), found.T, strict=True):
        p99, most = np.percentile(values, (99, 100))
        sys.stdout.write(f"{name}: {len(values)} points, 99 % within {p99:.2f} cm, most {most:.2f} cm\n")
