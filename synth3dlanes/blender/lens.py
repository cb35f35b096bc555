"""Lenses in Cycles: a screen directly before the camera redirects each camera ray along the ray of the lens.

Cycles renders a pinhole with the lens's pixels; the screen's material, a ray portal, looks up the direction of each
pixel. Nothing is resampled: the first sample of a pixel, which gives depth and ids, follows the ray of the pixel's
centre exactly.
"""

import bpy
import numpy as np
import scipy
from jaxtyping import Bool, Float

from synth3dlanes.blender.polygons import polygons
from synth3dlanes.blender.shaders import ShaderGraph, new_material
from synth3dlanes.geometry.frames import transform
from synth3dlanes.world.camera import BORDER_PX, rays_with_border
from synth3dlanes.world.world import View

# The instance id of the screen, which no pass shows, and its distance from the eye: nothing is nearer.
SCREEN_ID, SCREEN_M = 32_000, 0.055


def make_lens() -> bpy.types.Material:
    """The screen's material: a portal for rays from the camera, nothing for those that went through it. On other
    objects it has no shader, so that it can replace all materials."""
    material, graph = new_material("lens", 0)
    incoming = graph.node("ShaderNodeNewGeometry").outputs["Incoming"]
    right, up, ahead = (
        graph.vector_dot(incoming, graph.node("ShaderNodeCombineXYZ", name=name).outputs[0])
        for name in ("right", "up", "ahead")
    )
    place = graph.node(
        "ShaderNodeCombineXYZ",
        {
            i: graph.math("MULTIPLY_ADD", graph.math("DIVIDE", side, ahead), *_scaled(graph, name))
            for i, (side, name) in enumerate(((right, "u"), (up, "v")))
        },
    )
    rays = graph.node("ShaderNodeTexImage", {"Vector": place.outputs[0]}, name="rays", extension="EXTEND")
    eye = graph.node("ShaderNodeCombineXYZ", name="eye")
    portal = graph.node(
        "ShaderNodeBsdfRayPortal",
        {"Color": rays.outputs["Alpha"], "Position": eye.outputs[0], "Direction": rays.outputs["Color"]},
    )
    is_screen = graph.math("COMPARE", graph.node("ShaderNodeObjectInfo").outputs["Object Index"], SCREEN_ID, 0.5)
    through = graph.node("ShaderNodeMixShader", {0: is_screen, 2: graph.node("ShaderNodeBsdfTransparent").outputs[0]})
    passed = graph.math("MINIMUM", graph.node("ShaderNodeLightPath").outputs["Transparent Depth"], 1.0)
    graph.surface(graph.node("ShaderNodeMixShader", {0: passed, 1: portal.outputs[0], 2: through.outputs[0]}))
    return material


def _scaled(graph: ShaderGraph, name: str) -> tuple[object, object]:
    return graph.value(f"{name}_scale"), graph.value(f"{name}_shift")


def set_lens(material: bpy.types.Material, view: View, collection: bpy.types.Collection) -> None:
    """Put the screen before the camera, with the rays of a view's pixels, into a collection."""
    camera, nodes = view.camera, material.node_tree.nodes
    rays_world, is_seen = _rays_world(view)
    old = nodes["rays"].image
    if old is not None:
        bpy.data.images.remove(old)
    rows, columns = is_seen.shape
    image = bpy.data.images.new("rays", columns, rows, alpha=True, float_buffer=True, is_data=True)
    image.alpha_mode, image.use_half_precision = "CHANNEL_PACKED", False
    pixels = np.concatenate([rays_world, is_seen[..., None]], axis=-1).astype(np.float32)
    image.pixels.foreach_set(pixels[::-1].ravel())
    nodes["rays"].image = image
    # `Incoming` points back to the camera.
    axes = dict(zip(("right", "ahead", "up"), -view.world_from_cam[:3, :3].T, strict=True))
    for name, vector in (*axes.items(), ("eye", view.eye_world)):
        for i in range(3):
            nodes[name].inputs[i].default_value = vector[i]
    (fx, cx, _), (_, cy, fz), _ = view.img_from_cam
    values = {
        "u_scale": fx / columns,
        "u_shift": (cx + BORDER_PX) / columns,
        "v_scale": -fz / rows,
        "v_shift": 1 - (cy + BORDER_PX) / rows,
    }
    for name, value in values.items():
        nodes[name].outputs[0].default_value = value
    corners_img = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.6 + 0.5
    u, v = (corners_img * [camera.width_px, camera.height_px]).T
    corners_cam = SCREEN_M * np.stack([(u - cx) / fx, np.ones(4), (v - cy) / fz], axis=1)
    screen = bpy.data.objects.new(
        "screen", polygons("screen", transform(view.world_from_cam, corners_cam), np.arange(4)[None])
    )
    screen.data.materials.append(material)
    screen.pass_index = SCREEN_ID
    screen.visible_shadow = screen.visible_diffuse = screen.visible_glossy = screen.visible_transmission = False
    collection.objects.link(screen)


def _rays_world(view: View) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The rays of all pixels and of the border, and which of them the lens has; the others get the nearest one's."""
    rays_cam = rays_with_border(view.camera)
    is_seen = np.isfinite(rays_cam).all(axis=-1)
    if not is_seen.all():
        nearest = scipy.ndimage.distance_transform_edt(~is_seen, return_distances=False, return_indices=True)
        rays_cam = rays_cam[tuple(nearest)] if is_seen.any() else np.full_like(rays_cam, [0.0, 1.0, 0.0])
    return rays_cam @ view.world_from_cam[:3, :3].T, is_seen
