"""A scene's road for a simulator: OpenDRIVE, and the place of the host in the map.

docs/exports.md lists what reads the map: esmini, CARLA, SUMO and others. `odrviewer` of esmini shows it.
"""

import argparse
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import synth3dlanes as s3d


def roads(path: Path) -> list[tuple[str, float, int]]:
    """Name, length in metres and number of driving lanes of each road of a map."""
    found = []
    for road in ET.parse(path).getroot().iter("road"):
        lanes = road.find("lanes/laneSection").iter("lane")
        found.append(
            (road.get("name"), float(road.get("length")), sum(lane.get("type") == "driving" for lane in lanes))
        )
    return found


def place_of_host(labels: s3d.Labels) -> dict[str, float]:
    """Where the host's camera is in the map, whose inertial frame is the labels' world frame."""
    world_from_cam = labels.camera.world_from_cam
    x_m, y_m, z_m = world_from_cam[:3, 3]
    forward = world_from_cam[:3, 1]
    # OpenDRIVE turns headings from the x axis to the left.
    return {"x": x_m, "y": y_m, "z": z_m - labels.camera.height_m, "h": math.atan2(forward[1], forward[0])}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="new folder")
    parser.add_argument("--n", type=int, default=3, help="number of scenes")
    parser.add_argument("--params", default="streets")
    arguments = parser.parse_args()
    s3d.generate_dataset(s3d.load_params(arguments.params), arguments.out / "data", n=arguments.n)
    s3d.export_dataset(arguments.out / "data", arguments.out / "maps", "opendrive")
    for sample in s3d.open_dataset(arguments.out / "data"):
        path = arguments.out / f"maps/train/{sample.key}.xodr"
        place = " ".join(f"{name} {value:.2f}" for name, value in place_of_host(sample.labels).items())
        print(f"{path}: host at {place}")
        for name, length_m, n_lanes in roads(path):
            print(f"  road {name!r}: {length_m:.1f} m, {n_lanes} driving lanes at its start")
