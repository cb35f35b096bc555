"""The top view: what is painted in the world is bright at its place in the tiles."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.recorded.drives import pages as module
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, Scan
from synth3dlanes.recorded.drives.pages import TILE_PX, top_view
from synth3dlanes.system.errors import InputError

HEIGHT_M = 1.8


def drive(n: int = 3) -> Drive:
    """A lidar turned to the right of a host that drives to the upper right of the world, over a stripe at world x = 7
    to 7.4 and a kerb of 12 cm along y = 9."""
    rng = np.random.default_rng(1)
    host_from_lidar = np.eye(4)
    host_from_lidar[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    host_from_lidar[:3, 3] = (0.2, 0.5, HEIGHT_M)
    frames = []
    for number in range(n):
        c, s = np.cos(-0.7), np.sin(-0.7)
        world_from_host = np.array([[c, -s, 0, 2 + number], [s, c, 0, 3 + number], [0, 0, 1, 5.0], [0, 0, 0, 1]])
        world = np.column_stack([rng.uniform([-20, -20], [25, 25], (40_000, 2)), np.zeros(40_000)])
        world[:, 2] = 5 + 0.12 * (world[:, 1] > 9)
        is_paint = (world[:, 0] > 7) & (world[:, 0] < 7.4)
        pose = np.linalg.inv(world_from_host @ host_from_lidar)
        xyz = world @ pose[:3, :3].T + pose[:3, 3]
        # A car's roof over the stripe is not shown.
        roof = pose[:3, :3] @ [7.2, 2.0, 6.5] + pose[:3, 3]
        points = np.concatenate([xyz, roof + rng.uniform(-0.3, 0.3, (500, 3)) * [1, 1, 0]])
        shares = np.concatenate([np.where(is_paint, 0.9, 0.2), np.zeros(500)])
        scan = Scan(points, shares, float(number), world_from_host)
        frames.append(DriveFrame(str(number), float(number), world_from_host, load_scan=lambda scan=scan: scan))
    camera = DriveCamera(10, 10, np.eye(3), np.eye(4))
    return Drive("d", frames, camera, host_from_lidar)


def pixel(view, x: float, y: float, what: str) -> tuple[int, int]:
    """Gray and alpha at a place of the world, by the tiles' definition."""
    for tile in view.tiles:
        right, up = (x - tile.x_m) / view.tile_m, (y - tile.y_m) / view.tile_m
        if 0 <= right < 1 and 0 <= up < 1:
            return tuple(getattr(tile, what)[TILE_PX - 1 - int(up * TILE_PX), int(right * TILE_PX)].tolist())
    return (0, 0)


def test_paint_and_kerbs_are_where_they_are_in_the_world():
    view = top_view(drive(), cell_m=0.2)
    assert view.path.tolist() == [[2, 3], [3, 4], [4, 5]]
    for y in np.arange(-8, 8, 0.7):
        assert pixel(view, 7.3, y, "intensity")[0] > 110
        for x in (6.5, 7.9, -4.0):
            assert pixel(view, x, y, "intensity")[0] < 10
    ground, kerb = ([pixel(view, x, y, "height")[0] for x in np.arange(-8, 6, 0.9)] for y in (4.1, 9.1))
    assert max(abs(gray - 127) for gray in ground) < 8
    assert np.median(kerb) < 90 or np.median(kerb) > 165
    assert pixel(view, 60, 60, "intensity") == (0, 0)


def test_too_large_an_area_and_none_are_told(monkeypatch):
    monkeypatch.setattr(module, "MAX_TILES", 2)
    with pytest.raises(InputError, match="frames: expected ground of 328 m2 at most, got more: choose fewer frames"):
        top_view(drive(), cell_m=0.05)
    empty = replace(drive(), frames=[DriveFrame("0", 0.0, np.eye(4))])
    with pytest.raises(InputError, match="d: expected scans with ground in them, got none"):
        top_view(empty)
