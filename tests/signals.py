"""A scene with traffic elements of all kinds on a straight flat road."""

from synth3dlanes.scene.roadside import Crossing, Post, Roadside
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.traffic_elements import LaneSignal, Phase, TrafficSign, TrafficSignal
from tests.scenes import changed

STATES = ("red_cross", "green_arrow", "amber_right")
GANTRY = Crossing(
    kind="gantry",
    s_m=-18.0,
    clearance_m=5.0,
    width_m=0.8,
    color=(0.0, 0.15, 0.07),
    signals=tuple(LaneSignal(lane=f"main_{number}", state=state) for number, state in enumerate(STATES, start=1)),
)


def light(x_m: float, *states: str, **other: object) -> TrafficSignal:
    """A signal 30 m ahead of the host whose phases last a second each."""
    phases = tuple(Phase(state=state, seconds=1.0) for state in states)
    fields = {"y_m": -20.0, "yaw_rad": 0.0, "height_m": 2.4, "lanes": ("main_1",)} | other
    return TrafficSignal(x_m=x_m, phases=phases, **fields)


def sign(kind: str, x_m: float, y_m: float = -30.0, **other: object) -> TrafficSign:
    """A sign that faces the host."""
    fields = {"yaw_rad": 0.0, "height_m": 2.0, "lanes": ("main_3",)} | other
    return TrafficSign(kind=kind, x_m=x_m, y_m=y_m, **fields)


def signals_scene(**camera: object) -> Scene:
    """Signals over lanes, a light on a pole and one on an arm, and signs; of 640x480 px."""
    post = Post(kind="sign", road="main", side="right", s_m=-32.0, aside_m=2.0, height_m=2.0, face=7)
    roadside = Roadside(
        posts=(post,),
        crossings=(GANTRY,),
        signals=(light(-7.5, "red", "green"), light(8.0, "green", reach_m=-3.0, height_m=3.4)),
        signs=(sign("stop", 8.6), sign("speed_50", -7.0), sign("exit_right", 7.5, -4.0, height_m=2.6)),
    )
    view = {"width_px": 640, "height_px": 480, "fx_px": 640.0, "fy_px": 640.0, "cx_px": 320.0, "cy_px": 240.0}
    scene = changed(camera=view | {"pitch_rad": -0.02} | camera, light={"exposure": 1.0})
    return scene.model_copy(update={"roadside": roadside})
