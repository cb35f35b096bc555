"""A fisheye of your own: its file, a scene seen through it, and lanes in its image.

Put the numbers of your calibration into CAMERA; docs/camera.md has all keys, and the files of OpenCV, ROS and Kalibr.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import synth3dlanes as s3d

CAMERA = """
name: front_fisheye
width_px: {width}
height_px: {height}
model: fisheye
horizontal_fov_deg: 150
k1: -0.02
k2: 0.003
height_m: 1.3
pitch_deg: 4
"""


def seen(labels: s3d.Labels) -> Image.Image:
    """The visible points of all lines, drawn through the lens."""
    picture = Image.new("RGB", (labels.camera.width_px, labels.camera.height_px))
    draw = ImageDraw.Draw(picture)
    for lane in labels.lanes:
        for u, v in labels.camera.project(lane.xyz_cam[lane.visible]):
            draw.ellipse((u - 1, v - 1, u + 1, v + 1), "deepskyblue" if lane.kind == "centerline" else "red")
    return picture


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder for the camera's file and the picture")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--params", default="streets")
    parser.add_argument("--index", type=int, default=17, help="which scene")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "fisheye.yaml"
    file.write_text(CAMERA.format(width=arguments.width, height=arguments.width * 3 // 4))
    scene = s3d.sample_scene(s3d.load_params(arguments.params), index=arguments.index, camera=s3d.load_camera(file))
    rendered = s3d.render(scene)
    lines = np.array(seen(rendered.labels))
    picture = np.where(lines.any(axis=-1, keepdims=True), lines, rendered.image)
    Image.fromarray(picture).save(arguments.out / "fisheye.png")
    print(arguments.out / "fisheye.png", rendered.labels.camera.lens.model)
