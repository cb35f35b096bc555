"""A clip as a video: every frame with its lanes, beside the lanes and the way of the host from above.

Writes an animated GIF, or an MP4 where ffmpeg is installed.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation

import synth3dlanes as s3d


def world_xy(labels: s3d.Labels, points_cam: np.ndarray) -> np.ndarray:
    """Points from above, in the world frame, which all frames of a clip share."""
    world_from_cam = labels.camera.world_from_cam
    return (points_cam @ world_from_cam[:3, :3].T + world_from_cam[:3, 3])[:, :2]


def video(reader: s3d.Reader, scene: int, fps: float, path: Path) -> None:
    """Write the clip of a scene."""
    frames = reader.clip(scene)
    figure, (image, above) = plt.subplots(1, 2, figsize=(9, 3.6), width_ratios=(2, 1), layout="constrained")
    eyes: list[np.ndarray] = []

    def draw(i: int) -> None:
        sample = reader[i]
        eyes.append(sample.labels.camera.world_from_cam[:2, 3])
        image.cla()
        image.imshow(s3d.draw_overlay(sample.image, sample.labels))
        image.set_axis_off()
        above.cla()
        for lane in sample.labels.lanes:
            above.plot(*world_xy(sample.labels, lane.xyz_cam).T, "C0" if lane.kind == "centerline" else "C3", lw=0.7)
        above.plot(*np.array(eyes).T, "k.-", label="host")
        above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"{sample.labels.time_s:.1f} s")

    writer = "pillow" if path.suffix == ".gif" else "ffmpeg"
    FuncAnimation(figure, draw, frames, init_func=lambda: None).save(path, writer, fps=fps)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="new folder for the clip and its video")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--fps", type=float, default=10)
    parser.add_argument("--params", default="appendix_i")
    parser.add_argument("--type", choices=["gif", "mp4"], default="gif")
    asked = parser.parse_args()
    params = s3d.load_params(asked.params)
    s3d.generate_dataset(params, asked.out / "clip", n=asked.frames, frames=asked.frames, fps=asked.fps)
    path = asked.out / f"clip.{asked.type}"
    video(s3d.open_dataset(asked.out / "clip"), 0, asked.fps, path)
    print(path)
