"""Strong lenses of every model, with every coefficient, and the focal length at which tests look through them."""

from synth3dlanes.geometry.lens import Lens

LENSES = {
    "barrel": (300.0, Lens(model="opencv", coefficients=(-0.28, 0.08, 0.004, -0.003, -0.01, 0, 0, 0))),
    "rational": (350.0, Lens(model="opencv", coefficients=(0.6, -0.1, 0.003, -0.002, 0.004, 0.9, 0.03, -0.004))),
    "fisheye": (150.0, Lens(model="fisheye", coefficients=(0.03, -0.01, 0.002, -0.0003))),
    "omni": (320.0, Lens(model="omni", coefficients=(0.4, -0.1, 0.03, 0.004, -0.003))),
}
