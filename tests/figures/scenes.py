"""Scenes made by hand for the tests of figures: everything about them is known in closed form or by eye."""

from typing import Any

from synth3dlanes.scene import Scene


def make_scene(**changes: Any) -> Scene:
    """A straight, flat, three-lane road with two cars and a tree; `changes` replace fields of its road and terrain."""
    document: dict[str, Any] = {
        "format": "synth3dlanes.scene", "version": 1, "seed": 3, "split": "train", "index": 7,
        "terrain": {"gaussians": changes.pop("gaussians", [])},
        "road": {
            "topology": 1, "flip_longitudinal": False, "flip_lateral": False, "n_lanes": 3, "lane_width_m": 3.6,
            "shoulder_factor": 0.4, "offset_m100_m": 0.0, "offset_m50_m": 0.0, "offset_p50_m": 0.0,
            "offset_p100_m": 0.0, "exit_angle_rad": 0.05, "exit_offset_m": 8.0, "ramp_height_m": 4.0, "ramp_slope": 4.0,
        },
        "markings": {"dash_cycle_m": 4.0, "dash_fraction": 0.5, "width_m": 0.12, "grayscale": 0.9, "gloss": 0.7},
        "surface": {
            "road_texture": 1, "road_texture_scale": 20.0, "road_gloss": 0.1,
            "terrain_texture": 2, "terrain_texture_scale": 9.0, "texture_orientation_rad": 0.3,
        },
        "cars": [
            {"model": 2, "scale": 1.0, "color": [0.8, 0.1, 0.1], "gloss": 0.5, "lane": changes.pop("lane", "main_1"), "s_m": -20.0},
            {"model": 6, "scale": 1.0, "color": [0.2, 0.3, 0.9], "gloss": 0.5, "lane": "main_2", "s_m": 30.0},
        ],
        "trees": [{"model": 1, "x_m": 14.0, "y_m": 0.0, "yaw_rad": 0.0, "scale": 1.0}],
        "camera": {
            "lane": 2, "y_m": -50.0, "offset_m": 0.0, "height_m": 1.5, "pitch_rad": 0.03, "width_px": 480,
            "height_px": 360, "fx_px": 415.7, "fy_px": 415.7, "cx_px": 240.0, "cy_px": 180.0,
        },
        "light": {"sun_zenith_rad": 0.5, "sun_azimuth_rad": 1.0, "exposure": 2.0},
    }  # fmt: skip
    document["road"].update(changes)
    return Scene.model_validate_json(__import__("json").dumps(document))


def hilly_scene(**changes: Any) -> Scene:
    """A hilly, curved road whose right lanes split off onto a ramp."""
    hills = [
        {"center_m": [20.0, 30.0], "magnitude_m": 9.0, "sd_m": [40.0, 30.0], "orientation_rad": 0.4},
        {"center_m": [-60.0, -40.0], "magnitude_m": -12.0, "sd_m": [60.0, 45.0], "orientation_rad": 0.9},
    ]
    road = {"topology": 4, "offset_p50_m": 4.0, "offset_m50_m": 3.0, "offset_p100_m": 7.0, "lane": "stem_1"} | changes
    return make_scene(gaussians=hills, **road)
