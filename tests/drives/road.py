"""A drive in closed form, and its files as the formats define them: written here with numpy and pyarrow alone, in the
axes of vehicles (x forward, y left, z up) and of cameras (x right, y down, z forward)."""

import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from PIL import Image

DT_S, SPEED_M_S = 0.1, 8.0
LIDAR_HEIGHT_M, REACH_M = 1.73, 40.0
CAMERA_FLU = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
EARTH_M = 6378137.0
START_S = 1_317_042_145.5


def pose(yaw: float, x: float, y: float, z: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """A pose in a world whose z points up: turned left by `yaw` from x."""
    cy, sy, cp, sp, cr, sr = (f(angle) for angle in (yaw, pitch, roll) for f in (np.cos, np.sin))
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rz @ ry @ rx, (x, y, z)
    return found


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """x, y, z, w of a rotation by less than half a turn."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    x, y, z = (rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1])
    return np.array([x, y, z, 4 * w * w]) / (4 * w)


@dataclass
class Road:
    """Poses of a lidar along a road that turns left, and what it sees: ground, poles and walls that stand anywhere."""

    lidar_poses: list[np.ndarray]
    world: np.ndarray

    def seen(self, number: int) -> np.ndarray:
        """The points within reach in the lidar's frame, and what they reflect: (n, 4), float32."""
        at = self.lidar_poses[number]
        local = (self.world - at[:3, 3]) @ at[:3, :3]
        near = (np.linalg.norm(local, axis=1) < REACH_M) & (np.linalg.norm(local[:, :2], axis=1) > 2)
        return np.concatenate([local[near], np.full((near.sum(), 1), 0.25)], axis=1).astype(np.float32)


def road(n: int = 8, turn: float = 0.02, heading: float = 0.4) -> Road:
    """A drive of n scans that turns left by `turn` radians between two of them."""
    rng = np.random.default_rng(5)
    poses, x, y, yaw = [], 0.0, 0.0, heading
    for _ in range(n):
        poses.append(pose(yaw, x, y, LIDAR_HEIGHT_M))
        yaw += turn / 2
        x, y = x + SPEED_M_S * DT_S * np.cos(yaw), y + SPEED_M_S * DT_S * np.sin(yaw)
        yaw += turn / 2
    ground = np.column_stack([rng.uniform(-45, 45, (12_000, 2)), rng.normal(0, 0.01, 12_000)])
    parts = [ground]
    for _ in range(60):
        foot = rng.uniform(-45, 45, 2)
        if min(np.hypot(*(foot - at[:2, 3])) for at in poses) > 4:
            pole = np.column_stack([np.tile(foot, (40, 1)) + rng.normal(0, 0.05, (40, 2)), rng.uniform(0, 4, 40)])
            parts.append(pole)
    for _ in range(10):
        foot, along = rng.uniform(-45, 45, 2), rng.uniform(-np.pi, np.pi)
        wall = foot + rng.uniform(0, 8, (400, 1)) * [np.cos(along), np.sin(along)]
        if min(np.hypot(*(wall - at[:2, 3]).T).min() for at in poses) > 4:
            parts.append(np.column_stack([wall, rng.uniform(0, 3, 400)]))
    return Road(poses, np.concatenate(parts))


# Calibration: rectified camera 0 from the lidar, camera 2 beside it, the lidar from the IMU.
CAM_FROM_VELO = np.eye(4)
CAM_FROM_VELO[:3, :3] = CAMERA_FLU @ pose(0.01, 0, 0, 0, 0.02)[:3, :3]
CAM_FROM_VELO[:3, 3] = (-0.004, -0.08, -0.27)
VELO_FROM_IMU = pose(-0.0008, -0.81, 0.32, -0.8, 0.002, 0.0148)
RECTIFYING = pose(0.004, 0, 0, 0, -0.007, 0.0099)
P2 = np.array([[721.5, 0, 609.6, 44.86], [0, 721.5, 172.9, 0.2164], [0, 0, 1, 0.002746]])
SIZE = (1242, 375)


def feather(columns: dict[str, np.ndarray | list]) -> bytes:
    table, stream = pa.table(columns), io.BytesIO()
    with pa.ipc.new_file(stream, table.schema, options=pa.ipc.IpcWriteOptions(compression="lz4")) as file:
        file.write_table(table)
    return stream.getvalue()


def write_feather(path: Path, columns: dict[str, np.ndarray | list]) -> None:
    path.write_bytes(feather(columns))


def words(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))


def image(path: Path, size: tuple[int, int] = SIZE) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (90, 90, 90)).save(path)


def write_sequence(folder: Path, drive: Road) -> Path:
    """A sequence of KITTI's odometry benchmark."""
    sequence = folder / "sequences" / "07"
    (sequence / "velodyne").mkdir(parents=True)
    (folder / "poses").mkdir()
    first = drive.lidar_poses[0] @ np.linalg.inv(CAM_FROM_VELO)
    lines, times = [], []
    for number, at in enumerate(drive.lidar_poses):
        drive.seen(number).tofile(sequence / "velodyne" / f"{number:06d}.bin")
        image(sequence / "image_2" / f"{number:06d}.png")
        lines.append(words((np.linalg.inv(first) @ at @ np.linalg.inv(CAM_FROM_VELO))[:3]))
        times.append(f"{number * DT_S:.6e}")
    (folder / "poses" / "07.txt").write_text("\n".join(lines) + "\n")
    (sequence / "times.txt").write_text("\n".join(times) + "\n")
    zero = np.hstack([P2[:, :3], np.zeros((3, 1))])
    keys = {"P0": zero, "P1": zero, "P2": P2, "P3": P2, "Tr": CAM_FROM_VELO[:3]}
    (sequence / "calib.txt").write_text("".join(f"{key}: {words(values)}\n" for key, values in keys.items()))
    return sequence


def stamp(time_s: float) -> str:
    return str(np.datetime64(round((START_S + time_s) * 1e9), "ns")).replace("T", " ")


def write_raw(folder: Path, drive: Road, latitude: float = 49.01, is_twisted: bool = False) -> Path:
    """A drive of KITTI's raw data; with `is_twisted` points are where the lidar saw them while it turned."""
    name = folder / "2011_09_26" / "2011_09_26_drive_0005_sync"
    for place in ("velodyne_points/data", "oxts/data", "image_02/data"):
        (name / place).mkdir(parents=True)
    scale = np.cos(np.radians(latitude))
    north0 = scale * EARTH_M * np.log(np.tan(np.radians(90 + latitude) / 2))
    stamps = []
    for number, at in enumerate(drive.lidar_poses):
        points = drive.seen(number)
        if is_twisted and 0 < number < len(drive.lidar_poses) - 1:
            points = twisted(points, drive.lidar_poses, number)
        points.tofile(name / "velodyne_points" / "data" / f"{number:010d}.bin")
        image(name / "image_02" / "data" / f"{number:010d}.png")
        imu = at @ VELO_FROM_IMU
        east, north, up = imu[:3, 3]
        lat = np.degrees(2 * np.arctan(np.exp((north + north0) / scale / EARTH_M))) - 90
        lon = np.degrees(east / scale / EARTH_M) + 8.43
        pitch = np.arcsin(-imu[2, 0])
        angles = (np.arctan2(imu[2, 1], imu[2, 2]), pitch, np.arctan2(imu[1, 0], imu[0, 0]))
        rest = [0.0] * 19 + [4, 10, 4, 4, 0]
        packet = [f"{value:.14g}" for value in (lat, lon, up + 116.0, *angles, *rest)]
        (name / "oxts" / "data" / f"{number:010d}.txt").write_text(" ".join(packet) + "\n")
        stamps.append(stamp(number * DT_S))
    for place in ("velodyne_points", "oxts", "image_02"):
        (name / place / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    if is_twisted:
        for what, shift in (("start", -DT_S / 2), ("end", DT_S / 2)):
            lines = [stamp(number * DT_S + shift) for number in range(len(stamps))]
            (name / "velodyne_points" / f"timestamps_{what}.txt").write_text("\n".join(lines) + "\n")
    velo = np.linalg.inv(RECTIFYING) @ CAM_FROM_VELO
    day = name.parent
    size = words(np.array(SIZE))
    (day / "calib_cam_to_cam.txt").write_text(
        f"calib_time: 09-Jan-2012 13:57:47\nR_rect_00: {words(RECTIFYING[:3, :3])}\n"
        f"S_rect_02: {size}\nP_rect_02: {words(P2)}\n"
    )
    for file, matrix in (("velo_to_cam", velo), ("imu_to_velo", VELO_FROM_IMU)):
        text = f"calib_time: 15-Mar-2012 11:37:16\nR: {words(matrix[:3, :3])}\nT: {words(matrix[:3, 3])}\n"
        (day / f"calib_{file}.txt").write_text(text)
    return name


def twisted(points: np.ndarray, poses: list[np.ndarray], number: int) -> np.ndarray:
    """Points as a lidar sees them that turns clockwise from straight back, while the car drives on between poses."""
    at = poses[number]
    world = points[:, :3] @ at[:3, :3].T + at[:3, 3]
    after = (np.pi - np.arctan2(points[:, 1], points[:, 0])) / (2 * np.pi) - 0.5
    found = np.zeros_like(world)
    for is_later, other in ((False, poses[number - 1]), (True, poses[number + 1])):
        chosen = (after > 0) == is_later
        share = np.abs(after[chosen])
        yaw = np.arctan2(at[1, 0], at[0, 0]) + share * np.arctan2(*(other @ np.linalg.inv(at))[[1, 0], 0])
        moved = world[chosen] - at[:3, 3] - share[:, None] * (other[:3, 3] - at[:3, 3])
        c, s = np.cos(yaw), np.sin(yaw)
        found[chosen] = np.column_stack(
            [c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0], moved[:, 2]]
        )
    return np.column_stack([found, points[:, 3]]).astype(np.float32)


EGO_FROM_LIDAR = pose(0.0, 1.35, 0.0, 1.35)
CITY_M = np.array([4210.0, -1507.0, 12.0])
NS0 = 315_968_112_437_425_433


def write_argoverse(folder: Path, drive: Road, camera: str = "ring_front_center") -> Path:
    """A log of Argoverse 2's sensor data set: images at twice the lidar's rate, poses at five times."""
    log = folder / "54bc6dbc-ebfb-3fba-b5b3-57f88b4b79ca"
    for place in ("sensors/lidar", f"sensors/cameras/{camera}", "calibration"):
        (log / place).mkdir(parents=True)
    ego = [at @ np.linalg.inv(EGO_FROM_LIDAR) for at in drive.lidar_poses]
    rows = []
    for number, at in enumerate(ego):
        ns = NS0 + number * 100_000_000
        local = drive.seen(number)
        xyz = local[:, :3] @ EGO_FROM_LIDAR[:3, :3].T + EGO_FROM_LIDAR[:3, 3]
        columns = {axis: xyz[:, i].astype(np.float16) for i, axis in enumerate("xyz")}
        columns |= {"intensity": np.full(len(xyz), 51, np.uint8), "laser_number": np.zeros(len(xyz), np.uint8)}
        columns["offset_ns"] = np.zeros(len(xyz), np.int32)
        write_feather(log / "sensors" / "lidar" / f"{ns}.feather", columns)
        for shift in (7_000_000, 57_000_000):
            image(log / "sensors" / "cameras" / camera / f"{ns + shift}.jpg", (200, 250))
        for shift in range(0, 100_000_000, 20_000_000):
            after = ego[min(number + 1, len(ego) - 1)]
            place = at[:3, 3] + shift / 1e8 * (after[:3, 3] - at[:3, 3]) + CITY_M
            x, y, z, w = quaternion(at[:3, :3])
            rows.append((ns + shift, w, x, y, z, *place))
    names = ("timestamp_ns", "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
    poses = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    write_feather(log / "city_SE3_egovehicle.feather", poses)
    sensors = {camera: ego_from_camera(), "up_lidar": EGO_FROM_LIDAR, "down_lidar": EGO_FROM_LIDAR}
    places = [(name, *np.roll(quaternion(at[:3, :3]), 1), *at[:3, 3]) for name, at in sensors.items()]
    columns = {name: [row[i] for row in places] for i, name in enumerate(("sensor_name", *names[1:]))}
    write_feather(log / "calibration" / "egovehicle_SE3_sensor.feather", columns)
    lens = {"sensor_name": camera, "fx_px": 177.0, "fy_px": 177.0, "cx_px": 99.0, "cy_px": 126.0}
    lens |= {"k1": -0.3, "k2": -0.2, "k3": 0.3, "height_px": 250, "width_px": 200}
    write_feather(log / "calibration" / "intrinsics.feather", {key: [value] for key, value in lens.items()})
    return log


def ego_from_camera() -> np.ndarray:
    found = pose(0.02, 1.63, 0.0, 1.43, 0.01)
    found[:3, :3] = found[:3, :3] @ CAMERA_FLU.T
    return found


CAMERA_HEIGHT_M, FOCAL_PX, MIDDLE_PX = 1.5, 500.0, (320.0, 200.0)
CAMERA_YAML = f"""name: front
width_px: 640
height_px: 400
fx: {FOCAL_PX}
cx: {MIDDLE_PX[0]}
cy: {MIDDLE_PX[1]}
height_m: {CAMERA_HEIGHT_M}
"""
DRIVE_YAML = """name: monday
lidar:
  files: lidar/*.npy
  times: times.txt
  axes: flu
  host_from_lidar: [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 1.73]]
images:
  files: front/*.png
  times: times.txt
  camera: camera.yaml
poses:
  file: poses.txt
lanes: lanes.json
marked: lanes.geojson
"""
HOST_FROM_LIDAR = pose(0, 0.5, 0, LIDAR_HEIGHT_M)
LANES_M = (-1.75, 1.75, 5.25)


def lanes_px() -> list[list[list[float]]]:
    """Straight lanes beside the host, as the level camera sees them: to its left where y > 0."""
    ahead = np.linspace(6, 40, 12)
    u = [MIDDLE_PX[0] - FOCAL_PX * y / ahead for y in LANES_M]
    v = MIDDLE_PX[1] + FOCAL_PX * CAMERA_HEIGHT_M / ahead
    inside = [(columns >= 0) & (columns <= 640) & (v <= 400) for columns in u]
    return [np.stack([columns, v], -1)[kept].tolist() for columns, kept in zip(u, inside, strict=True)]


def write_described(folder: Path, drive: Road) -> Path:
    """A drive as our own file describes it: poses of the host in TUM's form, lanes in our JSON."""
    (folder / "lidar").mkdir()
    lines, times, lanes = [], [], {}
    for number, at in enumerate(drive.lidar_poses):
        np.save(folder / "lidar" / f"{number:04d}.npy", drive.seen(number))
        image(folder / "front" / f"{number:04d}.png", (640, 400))
        host = at @ np.linalg.inv(HOST_FROM_LIDAR)
        lines.append(f"{number * DT_S:.3f} {words(host[:3, 3])} {words(quaternion(host[:3, :3]))}")
        times.append(f"{number * DT_S:.3f}")
        lanes[f"front/{number:04d}.png"] = lanes_px()
    (folder / "poses.txt").write_text("# time x y z qx qy qz qw\n" + "\n".join(lines) + "\n")
    (folder / "times.txt").write_text("\n".join(times) + "\n")
    (folder / "lanes.json").write_text(json.dumps({"format": "synth3dlanes.lines", "version": 1, "images": lanes}))
    line = {"type": "LineString", "coordinates": [[0, 1], [10, 5.5], [20, 10]]}
    feature = {"type": "Feature", "properties": {"color": "yellow"}, "geometry": line}
    (folder / "lanes.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    (folder / "camera.yaml").write_text(CAMERA_YAML)
    (folder / "drive.yaml").write_text(DRIVE_YAML)
    return folder


WRITERS = {"described": write_described, "sequence": write_sequence, "raw": write_raw, "argoverse": write_argoverse}
