"""The scene of a lifted sample. Nobody drew its world, so it has only what is known: the camera, and which frame of the
drive it is. All else is a placeholder, a straight flat road without anything on it, which no check compares."""

from synth3dlanes.host import Camera, Shot
from synth3dlanes.labels import CameraLabel
from synth3dlanes.scene import Light, Markings, PaperRoad, Scene, Surface, Terrain

ROAD = PaperRoad(
    topology=1,
    flip_longitudinal=False,
    flip_lateral=False,
    n_lanes=1,
    lane_width_m=3.5,
    shoulder_factor=0.0,
    offset_m100_m=0.0,
    offset_m50_m=0.0,
    offset_p50_m=0.0,
    offset_p100_m=0.0,
    exit_angle_rad=0.0,
    exit_offset_m=0.0,
    ramp_height_m=0.0,
    ramp_slope=1.0,
)
MARKINGS = Markings(dash_cycle_m=12.0, dash_fraction=0.5, width_m=0.15, grayscale=1.0, gloss=0.0)
SURFACE = Surface(
    road_texture=1,
    road_texture_scale=1.0,
    road_gloss=0.0,
    terrain_texture=1,
    terrain_texture_scale=1.0,
    texture_orientation_rad=0.0,
)


def placeholder_scene(camera: CameraLabel, shot: Shot, split: str, clip: int) -> Scene:
    """The scene of a frame of a clip of a split."""
    k = camera.img_from_cam
    return Scene(
        format="synth3dlanes.scene",
        version=1,
        seed=0,
        split=split,
        index=clip,
        terrain=Terrain(gaussians=()),
        road=ROAD,
        markings=MARKINGS,
        surface=SURFACE,
        cars=(),
        trees=(),
        camera=Camera(
            lane=1,
            y_m=0.0,
            offset_m=0.0,
            height_m=camera.height_m,
            pitch_rad=camera.pitch_rad,
            width_px=camera.width_px,
            height_px=camera.height_px,
            fx_px=float(k[0, 0]),
            fy_px=-float(k[1, 2]),
            cx_px=float(k[0, 1]),
            cy_px=float(k[1, 1]),
            roll_rad=camera.roll_rad,
            name=camera.name,
            yaw_rad=camera.yaw_rad,
            lens=camera.lens,
        ),
        light=Light(sun_zenith_rad=0.5, sun_azimuth_rad=0.0, exposure=1.0),
        shot=shot,
    )
