"""World and View -> the boxes of all objects and traffic elements, except what needs a rendered picture or a sweep; and
the seen shares of traffic elements by the ids of a picture.

A rectangle in the image is that of the box's edges within it, of the corners of the image that are before the box, and
of the places where edges cross the image's border.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Integer

from synth3dlanes.geometry.frames import inside_image, invert, quaternion, transform
from synth3dlanes.labels.labels import CameraLabel, LaneGraph
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.system.arrays import Matrix4, Points2, Points3
from synth3dlanes.system.schema import MAX_NUMBER
from synth3dlanes.world.world import Site, View

# Pieces of an edge, which a lens bends, and halvings of the piece that crosses the image's border.
PIECES, HALVINGS = 32, 24
# Farther traffic elements have no label.
LABELLED_M = 200.0
# Quads that reach closer to the camera's plane than AHEAD_M are left out; the most pixels of an element that are
# tested.
AHEAD_M, MAX_PIXELS = 0.1, 1000
# Parts of a box across, along and up, of which the share outside the image is counted.
PARTS = (8, 24, 8)

CORNERS_OF_IMAGE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
# Ends of the twelve edges: corners of CORNERS that differ in one coordinate.
EDGES = np.array([(i, j) for i in range(8) for j in range(i) if (CORNERS[i] != CORNERS[j]).sum() == 1])
INSIDE = np.stack(np.meshgrid(*((np.arange(n) + 0.5) * 2 / n - 1 for n in PARTS), indexing="ij"), axis=-1).reshape(
    -1, 3
)


def label_objects(view: View, camera: CameraLabel) -> tuple[ObjectLabel, ...]:
    """The labels of all objects of a view, in the view's order."""
    has_time, cam_from_world = view.scene.shot.n_frames > 1, invert(camera.world_from_cam)
    found = []
    for item in view.objects:
        world_from_box = item.world_from_object.copy()
        world_from_box[:3, 3] += world_from_box[:3, 2] * item.size_m[2] / 2
        found.append(
            ObjectLabel(
                id=item.id,
                category=item.category,
                **_box(camera, cam_from_world @ world_from_box, item.size_m),
                velocity_cam=cam_from_world[:3, :3] @ item.velocity_world if has_time else None,
                truncation=truncation(camera, cam_from_world @ world_from_box, item.size_m),
            )
        )
    return tuple(found)


def label_elements(site: Site, view: View, camera: CameraLabel, graph: LaneGraph) -> tuple[ObjectLabel, ...]:
    """The labels of all traffic elements near a view, in the order of their ids, with the lanes that are in a graph."""
    cam_from_world, found = invert(camera.world_from_cam), []
    known = {segment.id for segment in graph.segments}
    for id_, element in site.elements_by_id.items():
        cam_from_box = cam_from_world @ element.place.world_from_face
        if np.linalg.norm(cam_from_box[:3, 3]) > LABELLED_M:
            continue
        found.append(
            ObjectLabel(
                id=id_,
                category=element.category,
                kind=element.kind,
                state=element.state(view.scene.shot.time_s),
                lanes=tuple(lane for lane in element.lanes if lane in known),
                **_box(camera, cam_from_box, element.place.size_m),
            )
        )
    return tuple(found)


def _box(camera: CameraLabel, cam_from_box: Matrix4, size_m: Float[np.ndarray, "3"]) -> dict[str, Any]:
    """The fields of a label that follow from a box."""
    inside, whole = rectangles(camera, cam_from_box, size_m)
    return {
        "size_m": size_m,
        "center_cam": cam_from_box[:3, 3],
        "rotation_wxyz": quaternion(cam_from_box[:3, :3]),
        "box_px": inside,
        "unclipped_box_px": whole,
    }


def rectangles(
    camera: CameraLabel, cam_from_box: Matrix4, size_m: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "4"] | None, Float[np.ndarray, "4"] | None]:
    """The rectangle of what of a box is inside the image, None if nothing is; and that of the whole box, beyond the
    image's border too, None where a part of it has no place there."""
    edges = _edges(cam_from_box, size_m)
    uv = camera.project(edges)
    # Next to the plane of the camera, and to the end of a lens's field, pixels are beyond all measure.
    whole = _around(uv.reshape(-1, 2)) if (np.abs(uv) <= MAX_NUMBER).all() else None
    shown = inside_image(uv, camera.width_px, camera.height_px)
    if shown.all():
        return whole, whole
    size_px = np.array([camera.width_px, camera.height_px], float)
    corners = CORNERS_OF_IMAGE * size_px
    found = [uv[shown], corners[meets_box(_corner_rays(camera), cam_from_box, size_m)]]
    if shown.any():
        crossing = shown[:, 1:] != shown[:, :-1]
        ends = [np.where(shown[:, 1:, None] == side, edges[:, 1:], edges[:, :-1])[crossing] for side in (True, False)]
        found.append(camera.project(_border(camera, *ends)))
    inside = np.concatenate(found)
    return np.clip(_around(inside), 0, np.tile(size_px, 2)) if len(inside) else None, whole


@lru_cache(maxsize=2)
def _corner_rays(camera: CameraLabel) -> Points3:
    """The rays of the corners of the image, which all boxes of a view are compared with."""
    return camera.rays(CORNERS_OF_IMAGE * [camera.width_px, camera.height_px])


def truncation(camera: CameraLabel, cam_from_box: Matrix4, size_m: Float[np.ndarray, "3"]) -> float:
    """The share of a box that is outside the image."""
    shown = camera.shows(transform(cam_from_box, INSIDE * size_m / 2))
    return round(1 - float(shown.mean()), 3)


def meets_box(rays_cam: Points3, cam_from_box: Matrix4, size_m: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " n"]:
    """Which rays from the camera meet a box; none that are NaN."""
    box_from_cam = invert(cam_from_box)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.array([-0.5, 0.5])[:, None, None] * size_m - box_from_cam[:3, 3]) / (
            rays_cam @ box_from_cam[:3, :3].T
        )
    enters, leaves = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return np.asarray((leaves > 0) & (enters < leaves))


def _edges(cam_from_box: Matrix4, size_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "12 p 3"]:
    """Points along the edges of a box."""
    first, second = (transform(cam_from_box, CORNERS[EDGES[:, end]] * size_m / 2)[:, None] for end in (0, 1))
    share = np.linspace(0, 1, PIECES + 1)[:, None]
    return np.asarray(first + share * (second - first))


def _border(camera: CameraLabel, shown: Points3, other: Points3) -> Points3:
    """Points in the image next to where straight lines from it to points out of it cross its border."""
    for _ in range(HALVINGS):
        middle = (shown + other) / 2
        is_shown = camera.shows(middle)[:, None]
        shown, other = np.where(is_shown, middle, shown), np.where(is_shown, other, middle)
    return shown


def _around(uv: Points2) -> Float[np.ndarray, "4"]:
    return np.concatenate([uv.min(axis=0), uv.max(axis=0)])


def with_pixel_shares(
    items: Sequence[ObjectLabel], site: Site, camera: CameraLabel, instance: Integer[np.ndarray, "h w"]
) -> tuple[ObjectLabel, ...]:
    """Traffic elements with the shares of their pixels that show them, by the ids of an image. The pixels that one
    would fill alone are found by rays through their centres and the quads of its body, without Blender."""
    return tuple(replace(item, visible_fraction=_pixel_share(item, site, camera, instance)) for item in items)


def _pixel_share(item: ObjectLabel, site: Site, camera: CameraLabel, instance: Integer[np.ndarray, "h w"]) -> float:
    if item.box_px is None:
        return 0.0
    left, top = np.floor(item.box_px[:2]).astype(int)
    right, bottom = np.ceil(item.box_px[2:]).astype(int)
    shows = instance[top:bottom, left:right] == item.id
    corners_cam = transform(invert(camera.world_from_cam), site.bodies[item.id].corners_world)
    step = max(1, int(np.ceil(np.sqrt(shows.size / MAX_PIXELS))))
    v, u = np.mgrid[top:bottom:step, left:right:step]
    own = shows[::step, ::step].ravel()
    fills = own | meets_quads(camera.rays(np.column_stack([u.ravel(), v.ravel()]) + 0.5), corners_cam)
    return round(float(own.sum() / fills.sum()), 3) if fills.any() else float(shows.any())


def meets_quads(rays_cam: Points3, corners_cam: Float[np.ndarray, "f 4 3"]) -> Bool[np.ndarray, " n"]:
    """Which rays from the camera meet a flat convex quad; none that are NaN."""
    corners = corners_cam[(corners_cam[..., 1] > AHEAD_M).all(axis=1)]
    sides = np.einsum("nk,fck->nfc", rays_cam, np.cross(corners, np.roll(corners, -1, axis=1)))
    ahead = rays_cam[:, 1:2] > 0
    return np.asarray((((sides >= 0).all(axis=2) | (sides <= 0).all(axis=2)) & ahead).any(axis=1))
