"""Write nuScenes: for each picture its image and lines of which rows are made, for each instant a sweep, and with the
first picture of a scene its map."""

import json
from typing import Any

import numpy as np

from synth3dlanes.formats.format import SampleFormat, SampleFrame
from synth3dlanes.formats.nuscenes.convention import (
    CATEGORIES,
    EGO_FROM_LIDAR,
    FRONT_CAMERA,
    HOST_FROM_EGO,
    LIDAR,
    LOCATIONS,
    MORE_SCENES,
    OF_BOXES,
    OF_PICTURES,
    PATHS,
    REACH_M,
    REAR_M,
    ROOM_US,
    START_US,
    VERSIONS,
    attributes_of,
    map_file,
    mask_file,
    pose_record,
    table_file,
)
from synth3dlanes.formats.nuscenes.maps import map_layers
from synth3dlanes.formats.nuscenes.read import read
from synth3dlanes.formats.nuscenes.tables import document
from synth3dlanes.formats.nuscenes.verify import LIMIT_PX, RULE, verify
from synth3dlanes.formats.writing import (
    PARTS,
    FrameAnnotation,
    expect_objects,
    expect_pinhole,
    img_from_cv_centred,
    objects_of,
    with_cv_axes,
    with_flu_axes,
    world_from_vehicle,
)
from synth3dlanes.geometry.frames import invert
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import resolve

README = f"""nuScenes (v1.0) with its map expansion: a scene for each of ours, a sample for each frame of its clip.

- `v1.0-trainval` (and `v1.0-test`): the tables; `samples/CHANNEL/*`: images and sweeps; `maps/expansion/*.json` and
  `maps/*.png`: the maps and their masks. All samples are key frames; there are no sweeps between them and no radar.
- Scenes have the names of the original's train, val and test scenes, and the names of its four places, because tools
  tell parts and maps by these: train is in {" and ".join(LOCATIONS["train"])}, val in {LOCATIONS["val"][0]}, test in
  {LOCATIONS["test"][0]}. Nothing else is of these places. Scenes beyond the original's number (700, 150 and 150, less
  four that converters leave out) are named from scene-{MORE_SCENES["train"]} on: `splits.json` beside the tables lists
  all of a part under `synth3dlanes_train`, `synth3dlanes_val` and `synth3dlanes_test`.
- Vehicle frame: x forward, y left, z up, on the road below the rear axle, {REAR_M:g} m behind the middle of the host.
  Global frame: that of the vehicle at the first sample of a scene is level and at height 0, so the map's plane is the
  road plane there. Poses are 3D; the road leaves the plane where it bends up or down.
- Tools of map learners want the six cameras and `{LIDAR}`: generate with `--rig nuscenes`. One camera is
  `{FRONT_CAMERA}`. Without a lidar sweeps are empty, and `num_lidar_pts` is 1 for a box that a camera sees and 0 for
  others: tools leave out boxes without points.
- Boxes are those of all objects of the labels; barrels and barricades are barriers, a rider is what he rides.
  Attributes are by speed; single pictures have none.
- `visibility` is the greatest share that one camera sees.
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The image of a picture and its lines; with the first of an instant also its sweep, with the first of a scene its
    map."""
    labels, shot, objects = frame.labels, frame.scene.shot, expect_objects(frame)
    expect_pinhole(labels.camera, frame.where)
    before = shot.frame * shot.n_cameras + shot.camera
    first, log = frame.number - before, f"{frame.split}-{int(frame.key) - before:08d}"
    time_us, reach_m = (
        START_US + first * ROOM_US + round(shot.time_s * 1e6),
        REACH_M + host_driven(shot, shot.duration_s),
    )
    world_from_ego = world_from_vehicle(labels.camera, frame.scene, HOST_FROM_EGO)
    head = f"{first} {frame.part} {reach_m:.1f}"

    def data(channel: str, ending: str, ego_from_sensor: Matrix4) -> dict[str, Any]:
        name = f"samples/{channel}/{log}__{channel}__{time_us}.{ending}"
        return {"channel": channel, "file": name, "pose": pose_record(ego_from_sensor)}

    ego_from_cam = invert(world_from_ego) @ labels.camera.world_from_cam
    camera = data(labels.camera.name or FRONT_CAMERA, frame.image_format, with_cv_axes(ego_from_cam))
    size_px = {"width": labels.camera.width_px, "height": labels.camera.height_px}
    camera |= {"camera_intrinsic": img_from_cv_centred(labels.camera).tolist(), **size_px}
    picture: dict[str, Any] = {
        "log": log,
        "frame": shot.frame,
        "time_us": time_us,
        "world_from_ego": world_from_ego.tolist(),
        "data": [camera],
    }
    files, n_lanes = dict[str, str | bytes](), 0
    if frame.cameras:
        ego_from_lidar = EGO_FROM_LIDAR
        if labels.lidar is not None:
            ego_from_lidar = ego_from_cam @ labels.lidar.cam_from_lidar
        lidar = data(LIDAR, "pcd.bin", ego_from_lidar)
        files[lidar["file"]], picture["data"] = _sweep(frame), [camera, lidar]
    # Cars come first among the objects.
    parked = {item.id for item, car in zip(objects, frame.scene.cars, strict=False) if not car.track}
    boxes = [
        _box(item, item.id in parked, ego_from_cam if frame.cameras else None)
        for item in objects_of(labels, CATEGORIES)
    ]
    versions = dict.fromkeys(VERSIONS[part] for part in PARTS if frame.serves_as(part))
    shared = [
        (
            f"{head} {json.dumps(picture)}",
            tuple(table_file(version, name) for version in versions for name in OF_PICTURES),
        ),
        (
            f"{head} {json.dumps(picture | {'boxes': boxes})}",
            tuple(table_file(version, name) for version in versions for name in OF_BOXES),
        ),
    ]
    if frame.is_first:
        layers = map_layers(resolve(frame.scene), labels.graph, log, world_from_ego, reach_m)
        n_lanes = len(layers[PATHS])
        places = LOCATIONS[frame.part]
        shared.append(
            (f"{head} {json.dumps(layers)}", tuple(path(at) for at in places for path in (map_file, mask_file)))
        )
    return FrameAnnotation(camera["file"], n_lanes, files=files, shared=tuple(shared))


def _sweep(frame: SampleFrame) -> bytes:
    """Points in the lidar's frame: x, y, z, no intensity, the number of the beam."""
    if frame.sweep is None:
        return b""
    points = frame.sweep.points()
    columns = np.column_stack([points.xyz_lidar, np.zeros(len(points.beam)), points.beam])
    return columns.astype("<f4").tobytes()


def _box(item: ObjectLabel, parks: bool, ego_from_cam: Matrix4 | None) -> dict[str, Any]:
    """An object as a picture sees it; for the first of an instant with its box, whose frame is x forward, y left, z
    up."""
    seen = {"id": item.id, "visible": item.visible_fraction}
    if ego_from_cam is None:
        return seen
    speed_m_s = None if item.velocity_cam is None else float(np.linalg.norm(item.velocity_cam))
    class_ = CATEGORIES[item.category]
    attributes = attributes_of(class_, speed_m_s)
    return seen | {
        "category": class_,
        "size": item.size_m.tolist(),
        "pose": pose_record(with_flu_axes(ego_from_cam @ item.cam_from_object)),
        "attribute": attributes[-1 if parks else 0] if attributes else None,
        "points": item.lidar_points,
    }


PLACES = [place for places in LOCATIONS.values() for place in places]

FORMAT = SampleFormat(
    title="nuScenes with its map expansion: cameras, lidar, boxes and maps",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    lists=tuple(path(place) for place in PLACES for path in (map_file, mask_file)),
    document=document,
    takes_sweeps=True,
    counted="lanes",
)
