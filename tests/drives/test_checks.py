"""Faults planted in the files of a drive are each found in one line of words; drives without a fault have none."""

import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.system.errors import InputError
from tests.drives import road as made
from tests.thorough import first


def edit(folder, name, *changes):
    path = folder / name
    text = path.read_text()
    for old, new in changes:
        assert re.search(old, text)
        text = re.sub(old, new, text)
    path.write_text(text)


def rewrite(folder, change):
    """The rows of the poses (time, x, y, z, qx, qy, qz, qw), changed."""
    rows = np.loadtxt(folder / "poses.txt")
    np.savetxt(folder / "poses.txt", change(rows))


def inverse(rows):
    found = rows.copy()
    for row in found:
        matrix = np.eye(4)
        x, y, z, w = row[4:]
        turn = 2 * np.arctan2(z, w)
        matrix = made.pose(turn, *row[1:4])
        back = np.linalg.inv(matrix)
        row[1:4], row[4:] = back[:3, 3], (-x, -y, -z, w)
    return found


def lying(rows):
    """Poses in a world whose y points up."""
    turn = Rotation.from_euler("x", -90, degrees=True)
    rows[:, 1:4], rows[:, 4:] = turn.apply(rows[:, 1:4]), (turn * Rotation.from_quat(rows[:, 4:])).as_quat()
    return rows


def scaled(factor, columns):
    def change(rows):
        rows[:, columns] *= factor
        return rows

    return change


def late(rows):
    """The second half of the drive is 2 s later than it was."""
    rows[4:, 0] += 2
    return rows


def jump(rows):
    rows[5, 1] += 40
    return rows


def other_lanes(change):
    def write(folder):
        document = json.loads((folder / "lanes.json").read_text())
        document["images"] = {
            name: [[change(u, v) for u, v in line] for line in lines] for name, lines in document["images"].items()
        }
        (folder / "lanes.json").write_text(json.dumps(document))

    return write


def turned(matrix):
    return lambda folder: edit(folder, "drive.yaml", (r"host_from_lidar: .*", f"host_from_lidar: {matrix}"))


BACK = "[[-1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, 1, 1.73]]"
DOWN = "[[1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, -1, 1.73]]"
LEANING = "[[0.8660254, 0, 0.5, 0.5], [0, 1, 0, 0], [-0.5, 0, 0.8660254, 1.73]]"
FAULTS = {
    "points in mm": (
        lambda folder: [np.save(path, np.load(path) * [1000, 1000, 1000, 1]) for path in folder.glob("lidar/*")],
        r"within .* m of the lidar, expected 1 to 150 m: points are in millimetres: multiply them",
    ),
    "points in km": (
        lambda folder: edit(folder, "drive.yaml", ("axes: flu", "axes: flu\n  metres: 0.001")),
        "points are in kilometres: multiply them by 1000",
    ),
    "points in feet": (
        lambda folder: edit(folder, "drive.yaml", ("axes: flu", "axes: flu\n  metres: 3.28")),
        r"the ground is 5\.6. m below the lidar, expected 0\.3 to 4\.5 m: check the unit",
    ),
    "z down": (turned(DOWN), r"the ground is 1\.73 m above the lidar: z of the points, or of its place, points down"),
    "leaning": (turned(LEANING), r"the ground leans by 30 degrees, expected 12 at most"),
    "a camera's axes": (
        lambda folder: edit(folder, "drive.yaml", ("axes: flu", "axes: rdf"), ("  host_from_lidar.*\n", "")),
        r"the ground stands upright, across the host's y axis, .* beside the lidar: the points are in other axes",
    ),
    "other axes": (
        lambda folder: edit(folder, "drive.yaml", ("axes: flu", "axes: rfu"), ("  host_from_lidar.*\n", "")),
        r"m off each other, but .* m if the points are turned left by 90 degrees",
    ),
    "looks backwards": (turned(BACK), "m off each other, but .* m if the lidar looks backwards"),
    "mirrored points": (
        lambda folder: [np.save(path, np.load(path) * [1, -1, 1, 1]) for path in folder.glob("lidar/*")],
        "m off each other, but .* m if left and right of the points are swapped",
    ),
    "inverse poses": (lambda folder: rewrite(folder, inverse), "host_from_world was given for world_from_host"),
    "y of the world is up": (
        lambda folder: rewrite(folder, lying), "what is up for the host is 90 degrees off the z of the world"),
    "poses in mm": (lambda folder: rewrite(folder, scaled(1e3, [1, 2, 3])), r"at 8\d\d\d m/s.* places in millimetres"),
    "poses in km": (lambda folder: rewrite(folder, scaled(0.001, [1, 2, 3])), "the host moves 0.00.* m in all"),
    "mirrored places": (
        lambda folder: rewrite(folder, scaled(-1, [2])), "the path turns right where the host turns left"),
    "places turned round": (
        lambda folder: rewrite(folder, scaled(-1, [1, 2])), "the host moves backwards: check the axes"),
    "poses in other axes": (
        lambda folder: edit(folder, "drive.yaml", (r"file: poses.txt", "file: poses.txt\n  axes: rfu")),
        r"the host moves 9\d degrees to the right of where it looks: check the axes",
    ),
    "a jump": (lambda folder: rewrite(folder, jump), r"the host jumps .* m in 0\.100 s after frame 0004"),
    "times in ms": (
        lambda folder: (
            rewrite(folder, scaled(1000, [0])),
            np.savetxt(folder / "times.txt", np.loadtxt(folder / "times.txt") * 1000),
        ),
        "times: 100 s between frames, expected .* in another unit",
    ),
    "missing frames": (
        lambda folder: (
            rewrite(folder, late),
            np.savetxt(folder / "times.txt", np.loadtxt(folder / "times.txt") + 2.0 * (np.arange(12) > 3)),
        ),
        r"times: 2\.10 s pass after frame 0003, 0\.10 s after most \(1 such gap\)",
    ),
    "lanes upside down": (
        other_lanes(lambda u, v: (u, 400 - v)), "100% of the lowest points of their lines look over the horizon"),
    "lanes of a larger image": (other_lanes(lambda u, v: (2 * u, 2 * v)), "belong to images of another size"),
    "lanes of a camera that looks aside": (
        other_lanes(lambda u, v: (u - 3 * (v - 200) + 270, v)),
        "on the ground, half of them cross the path at .* degrees or more",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", first(8, FAULTS))
def test_a_planted_fault_is_named(tmp_path, fault):
    plant, message = FAULTS[fault]
    plant(made.write_described(tmp_path, made.road(12)))
    findings = drive_findings(open_drive(str(tmp_path)))
    assert [line for line in findings if re.search(message, line)], findings
    assert all(len(line.splitlines()) == 1 and line.startswith("monday: ") for line in findings)


def test_lines_on_a_road_that_climbs_ahead_are_no_fault(tmp_path):
    """More than half of their points are above the horizon of the ground at the host."""
    made.write_described(tmp_path, made.road(12))

    def climbs(u, v):
        return u, v if v > 240 else 195 - (240 - v) / 5

    other_lanes(climbs)(tmp_path)
    rows = [row for frame in open_drive(str(tmp_path)).frames for line in frame.lanes_px for row in line[:, 1]]
    assert np.mean(np.array(rows) < 200) > 0.5
    assert not [line for line in drive_findings(open_drive(str(tmp_path))) if "horizon" in line]


@pytest.mark.parametrize("turn", [0.03, -0.03])
def test_lanes_lead_along_the_bend_that_the_host_drives(tmp_path, turn):
    """27 m of radius: lines 6 to 40 m ahead lead aside by 13 to 85 degrees; mirrored ones are a fault."""
    made.write_described(tmp_path, made.road(12, turn))
    radius_m, angles = made.SPEED_M_S * made.DT_S / turn, np.linspace(6, 40, 12) * turn / (made.SPEED_M_S * made.DT_S)
    lines = []
    for t in (-1.75, 1.75):
        ahead, left = (radius_m - t) * np.sin(angles), radius_m - (radius_m - t) * np.cos(angles)
        u = made.MIDDLE_PX[0] - made.FOCAL_PX * left / ahead
        v = made.MIDDLE_PX[1] + made.FOCAL_PX * made.CAMERA_HEIGHT_M / ahead
        inside = (u >= 0) & (u <= 640) & (v <= 400)
        lines.append(np.stack([u, v], -1)[inside])
    of = json.loads((tmp_path / "lanes.json").read_text())
    for sign in (1, -1):
        mirrored = [[(made.MIDDLE_PX[0] + sign * (u - made.MIDDLE_PX[0]), v) for u, v in line] for line in lines]
        images = dict.fromkeys(of["images"], mirrored)
        (tmp_path / "lanes.json").write_text(json.dumps(of | {"images": images}))
        found = drive_findings(open_drive(str(tmp_path)))
        assert [bool(re.search("cross the path", line)) for line in found] == [True] * (sign < 0)


@pytest.mark.parametrize(
    ("layout", "turn"), first(4, [(layout, turn) for turn in (0.02, 0.0, -0.03) for layout in made.WRITERS.values()])
)
def test_a_drive_without_a_fault_has_no_finding(tmp_path, layout, turn):
    assert drive_findings(open_drive(str(layout(tmp_path, made.road(12, turn))))) == []


# Scans in which nothing can be measured: their points, of shape (n, 3).
POINTLESS = {
    "all equal": np.tile([3.0, 4, -1], (200, 1)),
    "at the lidar": np.zeros((200, 3)),
    "on a line": np.linspace(2, 12, 200)[:, None] * [1.0, 0.5, -0.1],
    "three": np.array([[2.0, 1, -1], [3, 1, -1], [4, 2, -1]]),
    "far away": np.tile([90.0, 4, -1], (200, 1)),
    "too large": np.full((200, 3), 1e30),
}


@pytest.mark.parametrize("name", POINTLESS)
def test_scans_in_which_nothing_can_be_measured_are_named(tmp_path, name):
    made.write_described(tmp_path, made.road(4))
    points = np.column_stack([POINTLESS[name], np.zeros(len(POINTLESS[name]))])
    for path in tmp_path.glob("lidar/*"):
        np.save(path, points.astype(np.load(path).dtype))
    findings = drive_findings(open_drive(str(tmp_path)))
    assert [line for line in findings if re.search(r"monday: scans: .*expected", line)], findings


@pytest.mark.parametrize("metres", ["1.0e-300", "0", "-1", "1.0e+300", ".inf", ".nan"])
def test_units_of_points_are_bounded(tmp_path, metres):
    made.write_described(tmp_path, made.road(4))
    edit(tmp_path, "drive.yaml", ("axes: flu", f"axes: flu\n  metres: {metres}"))
    with pytest.raises(InputError, match=r"lidar\.metres: expected "):
        open_drive(str(tmp_path))
