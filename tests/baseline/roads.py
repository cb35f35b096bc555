"""Roads in closed form for the baseline's tests: no renderer, every lane a polynomial over the road plane."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from synth3dlanes_baseline.curves import Pose, cam_from_road, plane_pose, road_from_cam
from synth3dlanes_baseline.lanes import Detection, Prediction

from synth3dlanes.geometry.frames import project, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph

FOCAL_PX = 415.7


@dataclass(frozen=True)
class DrawnSample:
    """What a dataset reader yields, as far as the baseline looks."""

    key: str
    image: Any
    labels: Any


def labels(centers, delimiters=(), *, pitch_rad=0.04, height_m=1.6, size_px=(480, 360), hidden=None):
    """Labels of lanes given as functions y -> (x, z) in the road frame, or (function, y_from, y_to).
    `hidden` is an interval of y that the ground hides."""
    pose = Pose(pitch_rad, height_m)
    width_px, height_px = size_px
    focal_px = FOCAL_PX * width_px / 480
    img_from_cam = np.array([[focal_px, width_px / 2, 0], [0, height_px / 2, -focal_px], [0, 1.0, 0]])

    def lane(index, kind, spec):
        curve, start_m, end_m = spec if isinstance(spec, tuple) else (spec, 0.0, 110.0)
        y_m = np.arange(start_m, end_m + 1e-9)
        x_m, z_m = (np.broadcast_to(np.asarray(v, dtype=float), y_m.shape) for v in curve(y_m))
        xyz_road = np.stack([x_m, y_m, z_m], axis=1)
        seen = np.ones(len(y_m), dtype=bool)
        if hidden is not None:
            seen &= ~((y_m > hidden[0]) & (y_m < hidden[1]))
        xyz_cam = transform(cam_from_road(pose), xyz_road)
        inside = xyz_cam[:, 1] > 1.0
        return Lane(f"{kind}{index}", kind, "main", "none", None, None, xyz_cam, inside, seen, None)

    return Labels(
        camera=CameraLabel(width_px, height_px, img_from_cam, height_m, pitch_rad, road_from_cam(pose), np.eye(4)),
        lanes=tuple(
            [lane(i, "centerline", c) for i, c in enumerate(centers)]
            + [lane(i, "delimiter", d) for i, d in enumerate(delimiters)]
        ),
        graph=LaneGraph((), {}, None),
    )


def random(rng, size_px=(480, 360)):
    """Two to four parallel lanes on a gently bending, gently climbing road."""
    n_lanes = int(rng.integers(2, 5))
    width_m = rng.uniform(3.2, 4.0)
    host = int(rng.integers(0, n_lanes))
    bend, cubic, slope, climb = rng.uniform(-1e-3, 1e-3), rng.uniform(-5e-6, 5e-6), rng.uniform(-0.02, 0.02), 2e-4
    heading, offset_m, climb = rng.uniform(-0.01, 0.01), rng.uniform(-0.4, 0.4), rng.uniform(-climb, climb)

    def curve(shift_m):
        return lambda y: (shift_m + heading * y + bend * y**2 + cubic * y**3, slope * y * (y > 0) + climb * y**2)

    return labels(
        [curve((k - host) * width_m + offset_m) for k in range(n_lanes)],
        [curve((k - host - 0.5) * width_m + offset_m) for k in range(n_lanes + 1)],
        pitch_rad=rng.uniform(0.0, 0.087),
        height_m=rng.uniform(1.4, 1.9),
        size_px=size_px,
    )


def samples(rng, n, size_px=(480, 360)):
    """Samples whose images show the delimiters as bright lines and the centre lines as dark ones, on grey."""
    drawn = []
    for index in range(n):
        truth = random(rng, size_px)
        picture = Image.new("RGB", size_px, (110, 110, 110))
        draw = ImageDraw.Draw(picture)
        for lane in truth.lanes:
            points_img = project(truth.camera.img_from_cam, lane.xyz_cam)
            points_img = points_img[np.isfinite(points_img).all(1)]
            colour = (250, 250, 250) if lane.kind == "delimiter" else (60, 30, 30)
            draw.line([tuple(p) for p in points_img], fill=colour, width=2)
        drawn.append(DrawnSample(f"{index:08d}", np.asarray(picture), truth))
    return drawn


def as_prediction(truth, key="0", score=0.9, shift_m=0.0):
    """The labels as a detector would report them, moved sideways by `shift_m`."""
    shift = np.array([shift_m, 0.0, 0.0])
    lanes = tuple(Detection(lane.kind, score, lane.xyz_cam + shift) for lane in truth.lanes)
    return Prediction(key, lanes, plane_pose(truth))
