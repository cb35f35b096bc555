"""World and View -> the labels of all traffic elements near the camera; and what the ids of a rendered picture add.

What an element would fill were it alone is found by rays through pixels' centres and the quads of its body: no call of
Blender.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Integer

from synth3dlanes.geometry.frames import invert, quaternion, transform
from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.labels import CameraLabel, LaneGraph
from synth3dlanes.labels.object_labels import rectangle_around
from synth3dlanes.scene.instance_ids import instance_id, thing_of
from synth3dlanes.system.arrays import Points3
from synth3dlanes.truth.object_truth import rectangles
from synth3dlanes.world.world import Site, View

# Farther elements have no label.
LABELLED_M = 200.0
# Quads that reach closer to the camera's plane are left out; the most pixels that are asked of an element.
AHEAD_M, MAX_PIXELS = 0.1, 1000


def label_elements(site: Site, view: View, camera: CameraLabel, graph: LaneGraph) -> tuple[ElementLabel, ...]:
    """The labels of all traffic elements near a view, in the order of their ids, with the lanes that are in a graph."""
    cam_from_world, found = invert(camera.world_from_cam), []
    known = {segment.id for segment in graph.segments}
    time_s = view.scene.shot.time_s
    for number, element in enumerate(site.elements):
        cam_from_element = cam_from_world @ element.place.world_from_face
        if np.linalg.norm(cam_from_element[:3, 3]) > LABELLED_M:
            continue
        inside, whole = rectangles(camera, cam_from_element, element.place.size_m)
        found.append(
            ElementLabel(
                id=instance_id("structure", site.first_element + number),
                category=element.category,
                kind=element.kind,
                state=element.state(time_s),
                lanes=tuple(lane for lane in element.lanes if lane in known),
                size_m=element.place.size_m,
                center_cam=cam_from_element[:3, 3],
                rotation_wxyz=quaternion(cam_from_element[:3, :3]),
                box_px=inside,
                unclipped_box_px=whole,
            )
        )
    return tuple(found)


def seen_elements(
    items: Sequence[ElementLabel], site: Site, camera: CameraLabel, instance: Integer[np.ndarray, "h w"]
) -> tuple[ElementLabel, ...]:
    """The elements with the rectangles and shares of them that the ids of an image show."""
    found = []
    for item in items:
        if item.box_px is None:
            found.append(replace(item, visible_fraction=0.0))
            continue
        left, top = np.floor(item.box_px[:2]).astype(int)
        right, bottom = np.ceil(item.box_px[2:]).astype(int)
        shows = instance[top:bottom, left:right] == item.id
        rows, columns = np.nonzero(shows)
        body = site.structures[thing_of(item.id)[1]]
        corners_cam = transform(invert(camera.world_from_cam), body.corners_world)
        step = max(1, int(np.ceil(np.sqrt(shows.size / MAX_PIXELS))))
        v, u = np.mgrid[top:bottom:step, left:right:step]
        own = shows[::step, ::step].ravel()
        fills = own | meets_quads(camera.rays(np.column_stack([u.ravel(), v.ravel()]) + 0.5), corners_cam)
        share = round(float(own.sum() / fills.sum()), 3) if fills.any() else float(rows.size > 0)
        found.append(replace(item, seen_box_px=rectangle_around(rows + top, columns + left), visible_fraction=share))
    return tuple(found)


def meets_quads(rays_cam: Points3, corners_cam: Float[np.ndarray, "f 4 3"]) -> Bool[np.ndarray, " n"]:
    """Which rays from the camera meet a flat convex quad; none that are NaN."""
    corners = corners_cam[(corners_cam[..., 1] > AHEAD_M).all(axis=1)]
    sides = np.einsum("nk,fck->nfc", rays_cam, np.cross(corners, np.roll(corners, -1, axis=1)))
    ahead = rays_cam[:, 1:2] > 0
    return np.asarray((((sides >= 0).all(axis=2) | (sides <= 0).all(axis=2)) & ahead).any(axis=1))
