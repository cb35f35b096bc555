"""Scenes made by hand for tests: a straight flat road, and the same with any part changed."""

from typing import Any

import numpy as np

from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import Air, Gaussian, Light, Markings, PaperRoad, Scene, Sensor, Surface, Terrain, Thing
from synth3dlanes.world.world import World

FLAT = Scene(
    format="synth3dlanes.scene",
    version=1,
    seed=0,
    split="test",
    index=0,
    terrain=Terrain(gaussians=()),
    road=PaperRoad(
        topology=1, flip_longitudinal=False, flip_lateral=False, n_lanes=3, lane_width_m=3.5, shoulder_factor=0.4,
        offset_m100_m=0, offset_m50_m=0, offset_p50_m=0, offset_p100_m=0, exit_angle_rad=0.05, exit_offset_m=5,
        ramp_height_m=4, ramp_slope=3,
    ),
    markings=Markings(dash_cycle_m=4, dash_fraction=0.5, width_m=0.12, grayscale=0.9, gloss=0.6),
    surface=Surface(
        road_texture=1, road_texture_scale=20, road_gloss=0.1, terrain_texture=1, terrain_texture_scale=10,
        texture_orientation_rad=0.3,
    ),
    cars=(),
    trees=(),
    camera=HostCamera(
        lane=2, y_m=-50, offset_m=0, height_m=1.6, pitch_rad=0.05, width_px=480, height_px=360, fx_px=415.7,
        fy_px=415.7, cx_px=240, cy_px=180,
    ),
    light=Light(sun_zenith_rad=0.5, sun_azimuth_rad=1, exposure=2, metering=0),
    air=Air(visibility_m=30_000, overcast=0),
    sensor=Sensor(motion_blur_m=0, noise=0),
)  # fmt: skip


def changed(scene: Scene = FLAT, **parts: dict[str, Any]) -> Scene:
    """The scene with fields of its parts replaced: `changed(road={"topology": 2})`."""
    updates = {name: getattr(scene, name).model_copy(update=fields) for name, fields in parts.items()}
    return Scene.model_validate(scene.model_copy(update=updates).model_dump())


def hill(x_m: float, y_m: float, magnitude_m: float, sd_m: float) -> Gaussian:
    """A round Gaussian."""
    return Gaussian(center_m=(x_m, y_m), magnitude_m=magnitude_m, sd_m=(sd_m, sd_m), orientation_rad=0)


def flat_road_places(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """What each pixel's centre shows of a flat road: metres right of the camera and ahead of it; NaN above it."""
    camera = scene.camera
    v, u = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    right, down = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    c, s = np.cos(camera.roll_rad), np.sin(camera.roll_rad)
    right, down = c * right - s * down, s * right + c * down
    c, s = np.cos(camera.pitch_rad), np.sin(camera.pitch_rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = camera.height_m / (c * down + s)
    return np.where(way > 0, right * way, np.nan), np.where(way > 0, (c - s * down) * way, np.nan)


def flat_road_depth(scene: Scene) -> np.ndarray:
    """The depth pass of a flat road; infinite above it."""
    y_m, pitch_rad = flat_road_places(scene)[1], scene.camera.pitch_rad
    depth_m = y_m * np.cos(pitch_rad) + scene.camera.height_m * np.sin(pitch_rad)
    return np.where(np.isnan(y_m), np.inf, depth_m).astype(np.float32)


def seen_on_flat_ground(world: World, points_world: np.ndarray) -> np.ndarray:
    """Where the camera's rays through points over a flat world meet the ground."""
    eye = world.view.eye_world
    return np.asarray(eye + (points_world - eye) * (eye[2] / (eye[2] - points_world[..., 2:])))


def things_ahead() -> Scene:
    """Every model of things on the flat road, beside each other, each facing its own way."""
    things = [
        Thing(
            kind=kind,
            model=number,
            x_m=0.0,
            y_m=0.0,
            yaw_rad=0.0,
            colors=tuple((0.2, 0.3, 0.1 * i) for i in range(len(model.paints))),
        )
        for kind, models in THINGS.items()
        for number, model in enumerate(models, start=1)
    ]

    def placed(i: int) -> dict[str, float]:
        """Across the picture, whatever their number, in turn 18 m and 22 m ahead of the camera."""
        ahead_m = 18.0 + 4 * (i % 2)
        return {"x_m": 1.0 * ahead_m * (i / len(things) - 0.5), "y_m": ahead_m - 50, "yaw_rad": 0.7 * i}

    own = [thing.model_copy(update=placed(i)) for i, thing in enumerate(things)]
    return Scene.model_validate(FLAT.model_copy(update={"things": tuple(own)}).model_dump())
