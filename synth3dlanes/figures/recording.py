"""A sample with its whole clip and rig as a recording for the viewer of Rerun (rerun.io), the extra `rerun`.

World frame, metres. Each frame has, at its time, cameras with images, lanes, boxes, traffic elements and lidar. A
sample with a scene has, once, the ground, the roads and their paint.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from synth3dlanes.dataset.address import SAMPLE
from synth3dlanes.dataset.description import clip_of
from synth3dlanes.dataset.format import encode_image
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.figures import colors
from synth3dlanes.figures.describe import shows
from synth3dlanes.figures.overlay import color_of, objects_in_image, stretches_img
from synth3dlanes.figures.passes import semantic_colors
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.figures.space import triangles
from synth3dlanes.geometry.frames import invert, quaternion, rotation, transform
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.scene import from_json
from synth3dlanes.system.arrays import Matrix4, RgbImage
from synth3dlanes.system.errors import InputError, MissingPackageError, how_to_install

if TYPE_CHECKING:
    import rerun

# The two groups of boxes.
GROUPS = ("objects", "traffic_elements")
# Entities that do not move: they are recorded without a time.
STILL = ("terrain", "road", "paint", "trees", "structures")
LANE_RADIUS_M, POINT_RADIUS_M, IMAGE_PLANE_M = 0.06, 0.04, 3.0
# The viewer's camera: x right, y down, z along the viewing direction.
CAM_FROM_RDF = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def sample_recording(where: str) -> bytes:
    """The bytes of an .rrd file that shows a sample `DIR/SPLIT:KEY`, all frames of its clip and all cameras of its rig.

    Raises InputError for what is no sample, MissingPackageError without Rerun.
    """
    if SAMPLE.fullmatch(where) is None:
        raise InputError(f"{where}: expected a sample of a data set, such as DIR/train:00000017, for a recording")
    rr = _rerun()
    reader, i = find(where)
    # A name that depends on the sample alone: the viewer shows a recording that is made again in place of the first.
    recording = rr.RecordingStream("synth3dlanes", recording_id=f"{reader.key(i)}-{reader.scene_of[i]}")
    memory = recording.memory_recording()
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_still(rr, recording, reader, i)
    is_clip = clip_of(reader.description)[0] > 1
    for position in reader.clip(int(reader.scene_of[i])) if is_clip else reader.rig(i):
        labels = reader.labels(position)
        recording.set_time("time", duration=labels.time_s or 0.0)
        _log_camera(rr, recording, labels, reader.image(position))
        if reader.camera_of[position] == reader.camera_of[i]:
            _log_labels(rr, recording, labels)
            if reader.has_lidar:
                _log_sweep(rr, recording, labels.camera, reader.lidar(position))
    return bytes(memory.drain_as_bytes())


def _log_still(rr: ModuleType, recording: "rerun.RecordingStream", reader: Reader, i: int) -> None:
    """The surfaces of a sample's scene near its host; nothing of a sample without a scene."""
    sample = reader[i]
    if sample.scene_json is None:
        return
    view = SceneView(from_json(sample.scene_json, sample.key), sample.labels)
    world_from_road = invert(view.road_from_world)
    for group in triangles(view):
        if group.name in STILL and len(group.faces):
            mesh = rr.Mesh3D(
                vertex_positions=transform(world_from_road, group.vertices_road),
                triangle_indices=group.faces,
                vertex_colors=group.colors.astype(np.uint8),
            )
            recording.log(f"world/{group.name}", mesh, static=True)


def _log_camera(rr: ModuleType, recording: "rerun.RecordingStream", labels: Labels, image: RgbImage) -> None:
    """A camera's pose and image with the labels drawn on it. The viewer knows no lenses: where there is one, the image
    stands alone."""
    camera = labels.camera
    name = f"world/cameras/{camera.name or 'camera'}"
    if camera.lens.is_pinhole:
        pose = camera.world_from_cam @ CAM_FROM_RDF
        recording.log(name, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        pinhole = rr.Pinhole(
            image_from_camera=camera.img_from_cam @ CAM_FROM_RDF[:3, :3],
            resolution=[camera.width_px, camera.height_px],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=IMAGE_PLANE_M,
        )
        recording.log(name, pinhole)
    else:
        name = f"images/{camera.name or 'camera'}"
    recording.log(f"{name}/image", rr.EncodedImage(contents=encode_image(image, "jpg"), media_type="image/jpeg"))
    for kind, color in colors.KINDS.items():
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        seen = [line for lane in lanes for is_seen, line in stretches_img(camera, lane) if is_seen]
        recording.log(f"{name}/image/{kind}s", rr.LineStrips2D(seen, colors=color))
    drawn = [(item, line) for item, lines in objects_in_image(labels) for line in lines]
    for is_element, group in enumerate(GROUPS):
        own = [(item, line) for item, line in drawn if item.is_element == is_element]
        strips = rr.LineStrips2D([line for _, line in own], colors=[color_of(item) for item, _ in own])
        recording.log(f"{name}/image/{group}", strips)


def _log_labels(rr: ModuleType, recording: "rerun.RecordingStream", labels: Labels) -> None:
    """The lanes, objects and traffic elements of a frame."""
    world_from_cam = labels.camera.world_from_cam
    for kind, color in colors.KINDS.items():
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        lines = [transform(world_from_cam, lane.xyz_cam) for lane in lanes]
        ids = [lane.id for lane in lanes]
        strips = rr.LineStrips3D(lines, colors=color, radii=LANE_RADIUS_M, labels=ids, show_labels=False)
        recording.log(f"world/{kind}s", strips)
    for group, items in zip(GROUPS, (labels.objects, labels.traffic_elements), strict=True):
        recording.log(f"world/{group}", _boxes(rr, world_from_cam, items or ()))


def _boxes(rr: ModuleType, world_from_cam: Matrix4, items: Sequence[ObjectLabel]) -> "rerun.Boxes3D":
    """The boxes of labels, each with its class, or what it shows."""
    turns = [quaternion(world_from_cam[:3, :3] @ rotation(item.rotation_wxyz)) for item in items]
    return rr.Boxes3D(
        centers=transform(world_from_cam, np.array([item.center_cam for item in items]).reshape(-1, 3)),
        half_sizes=np.array([item.size_m / 2 for item in items]).reshape(-1, 3),
        quaternions=np.roll(np.array(turns).reshape(-1, 4), -1, axis=1),
        colors=[color_of(item) for item in items],
        labels=[shows(item) if item.is_element else item.category for item in items],
        show_labels=False,
    )


def _log_sweep(rr: ModuleType, recording: "rerun.RecordingStream", camera: CameraLabel, sweep: Sweep) -> None:
    """The points of a lidar's turn in the colours of their semantic ids."""
    points = sweep.points()
    xyz_world = transform(camera.world_from_cam, points.xyz_cam)
    recording.log("world/lidar", rr.Points3D(xyz_world, colors=semantic_colors(points.semantic), radii=POINT_RADIUS_M))


def _rerun() -> ModuleType:
    try:
        import rerun
    except ModuleNotFoundError:
        raise MissingPackageError(f"Rerun is not installed: {how_to_install('rerun')}") from None
    return rerun
