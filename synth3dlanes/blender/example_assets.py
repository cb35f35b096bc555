"""Write an example folder of a user's own assets (see docs/assets.md).

A box-shaped car (.glb), a round tree (.blend), a person of boxes with three poses (.glb), a road and a terrain texture,
and a small sky (.hdr). Run it in a separate process: it resets Blender for every file.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import bpy
import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.ndimage import gaussian_filter

from synth3dlanes.system.files import encoded, write

LENGTH_M, WIDTH_M, HEIGHT_M = 4.2, 1.7, 1.5
WHEELBASE_M, TRACK_M, WHEEL_RADIUS_M = 2.6, 1.48, 0.32
TRUNK_M, CROWN_M, TREE_M = 2.0, 1.5, 5.0
PERSON_M, SWING_M = 1.7, 0.25
SUN_AZIMUTH_DEG = 90.0  # from the middle column of the sky's picture to the left


def make_example(folder: Path) -> None:
    """Write the example assets into a folder."""
    for kind in ("cars", "trees", "pedestrians", "roads", "terrains/moss", "skies"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    car(folder / "cars" / "box.glb")
    tree(folder / "trees" / "ball.blend")
    for number, swing_m in enumerate((0.0, SWING_M, -SWING_M)):
        person(folder / "pedestrians" / (f"boxes.{number}.glb" if number else "boxes.glb"), swing_m)
    write(folder / "assets.yaml", b"things:\n  boxes: {stride_m: 1.2}\n")
    texture(folder / "roads", "brick_", (0.36, 0.2, 0.15))
    texture(folder / "terrains" / "moss", "", (0.16, 0.22, 0.08))
    sky(folder / "skies" / "evening.hdr")


def car(path: Path) -> None:
    """A body with the scene's paint colour, windows with a fixed colour, and four named wheels."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    body_z_m = (0.2 + 0.95) / 2
    box("body", (WIDTH_M, LENGTH_M, 0.75), (0, 0, body_z_m), material("paint", (0.8, 0.8, 0.8)))
    box(
        "cabin",
        (WIDTH_M - 0.2, 2.2, HEIGHT_M - 0.95),
        (0, -0.2, (0.95 + HEIGHT_M) / 2),
        material("glass", (0.02, 0.02, 0.02)),
    )
    rubber = material("rubber", (0.03, 0.03, 0.03))
    for side, left_right in ((-1, "left"), (1, "right")):
        for end, front_rear in ((1, "front"), (-1, "rear")):
            bpy.ops.mesh.primitive_cylinder_add(
                vertices=48, radius=WHEEL_RADIUS_M, depth=0.2, rotation=(0, np.pi / 2, 0),
                location=(side * TRACK_M / 2, end * WHEELBASE_M / 2, WHEEL_RADIUS_M),
            )  # fmt: skip
            bpy.context.object.name = f"wheel_{front_rear}_{left_right}"
            bpy.context.object.data.materials.append(rubber)
    bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB")


def person(path: Path, swing_m: float) -> None:
    """A head, a body in the scene's colours, and two legs, the left one `swing_m` ahead."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    lower = material("lower", (0.1, 0.1, 0.2))
    for side in (-1, 1):
        box(f"leg {side}", (0.16, 0.2, 0.8), (0.11 * side, -side * swing_m, 0.4), lower)
    box("body", (0.44, 0.26, 0.65), (0, 0, 1.125), material("upper", (0.5, 0.1, 0.1)))
    box("head", (0.18, 0.22, PERSON_M - 1.45), (0, 0, (PERSON_M + 1.45) / 2), material("skin", (0.6, 0.4, 0.3)))
    bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB")


def tree(path: Path) -> None:
    """A trunk that starts below the ground, and a ball of leaves."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    box("trunk", (0.25, 0.25, TRUNK_M + 0.5), (0, 0, TRUNK_M / 2), material("bark", (0.12, 0.08, 0.05)))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=CROWN_M, location=(0, 0, TREE_M - CROWN_M))
    bpy.context.object.data.materials.append(material("leaves", (0.07, 0.14, 0.03)))
    bpy.data.libraries.write(str(path), set(bpy.context.scene.objects), compress=True)


def box(name: str, size_m: Sequence[float], middle_m: Sequence[float], coat: bpy.types.Material) -> None:
    """A box of one material."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=middle_m, scale=size_m)
    bpy.context.object.name = name
    bpy.context.object.data.materials.append(coat)


def material(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    """Blender's standard material in one colour."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    made.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*color, 1)
    return made


def texture(folder: Path, prefix: str, color: tuple[float, float, float], size_px: int = 512) -> None:
    """Albedo, roughness and normal map of a grainy surface that tiles."""
    rng = np.random.default_rng(7)
    height = sum(
        gaussian_filter(rng.standard_normal((size_px, size_px)), sigma, mode="wrap") * sigma for sigma in (1, 4, 16)
    )
    height /= np.abs(height).max()
    save(folder / f"{prefix}albedo.png", np.array(color) ** (1 / 2.2) * (1 + 0.3 * height[..., None]))
    save(folder / f"{prefix}roughness.png", 0.8 + 0.1 * height)
    normal = np.dstack([-np.gradient(height, axis=1) * 8, np.gradient(height, axis=0) * 8, np.ones_like(height)])
    save(folder / f"{prefix}normal.png", 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=2, keepdims=True))


def save(path: Path, values: Float[np.ndarray, "..."]) -> None:
    """Write values in 0..1 as an 8-bit picture."""
    picture = Image.fromarray((255 * np.clip(values, 0, 1)).round().astype(np.uint8))
    write(path, encoded(partial(picture.save, format="PNG")))


def sky(path: Path, height_px: int = 256) -> None:
    """A sky with a sun, redder towards the horizon."""
    elevation = np.pi * ((np.arange(height_px) + 0.5) / height_px - 0.5)[:, None, None]
    azimuth = np.pi - np.pi * (np.arange(2 * height_px)[:, None] + 0.5) / height_px
    low, high = np.array([1.4, 0.8, 0.5]), np.array([0.2, 0.35, 0.8])
    radiance = low + (high - low) * np.clip(np.sin(elevation), 0, 1) ** 0.5
    apart = (azimuth - np.deg2rad(SUN_AZIMUTH_DEG)) ** 2 + (elevation - 0.5) ** 2
    pixels = np.ones((height_px, 2 * height_px, 4), np.float32)
    pixels[..., :3] = np.where(elevation > 0, radiance, 0.2) + 50 * np.exp(-apart / 0.002)
    image = bpy.data.images.new("sky", 2 * height_px, height_px, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"  # linear radiance
    image.pixels.foreach_set(pixels.ravel())
    image.file_format, image.filepath_raw = "HDR", str(path)
    image.save()
