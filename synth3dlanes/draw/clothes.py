"""The looks of people and riders: colours of clothes, skin, hair, umbrellas, helmets, bicycles. Display values."""

import numpy as np

from synth3dlanes.draw.car_colors import PASSENGER, CarColor
from synth3dlanes.params.distributions import Choice
from synth3dlanes.scene.assets.catalogue import ThingModel

# Shares are ours: what people wear in the streets of towns is mostly dark, gray and blue (docs/decisions.md).
UPPER = (
    CarColor("black", 24, (0.05, 0.05, 0.06), (0.14, 0.14, 0.15)),
    CarColor("navy", 16, (0.06, 0.08, 0.16), (0.16, 0.20, 0.34)),
    CarColor("gray", 15, (0.28, 0.29, 0.30), (0.56, 0.56, 0.57)),
    CarColor("white", 11, (0.80, 0.79, 0.77), (0.93, 0.92, 0.90)),
    CarColor("beige", 9, (0.52, 0.45, 0.36), (0.76, 0.69, 0.58)),
    CarColor("blue", 7, (0.14, 0.26, 0.50), (0.32, 0.48, 0.72)),
    CarColor("green", 6, (0.17, 0.22, 0.14), (0.38, 0.44, 0.30)),
    CarColor("red", 6, (0.42, 0.06, 0.08), (0.74, 0.14, 0.14)),
    CarColor("pink", 3, (0.70, 0.42, 0.48), (0.88, 0.64, 0.68)),
    CarColor("yellow", 3, (0.78, 0.60, 0.14), (0.90, 0.76, 0.28)),
)
LOWER = (
    CarColor("jeans", 36, (0.12, 0.17, 0.28), (0.30, 0.40, 0.54)),
    CarColor("black", 30, (0.05, 0.05, 0.06), (0.13, 0.13, 0.14)),
    CarColor("gray", 14, (0.24, 0.24, 0.25), (0.48, 0.48, 0.49)),
    CarColor("beige", 12, (0.46, 0.40, 0.31), (0.70, 0.63, 0.52)),
    CarColor("brown", 8, (0.22, 0.16, 0.11), (0.38, 0.29, 0.21)),
)
SKIN = (
    CarColor("light", 50, (0.80, 0.62, 0.52), (0.92, 0.76, 0.66)),
    CarColor("medium", 30, (0.62, 0.44, 0.32), (0.78, 0.60, 0.46)),
    CarColor("dark", 20, (0.26, 0.16, 0.11), (0.48, 0.32, 0.23)),
)
HAIR = (
    CarColor("black", 34, (0.06, 0.05, 0.05), (0.13, 0.11, 0.10)),
    CarColor("brown", 36, (0.20, 0.13, 0.08), (0.38, 0.26, 0.17)),
    CarColor("blond", 16, (0.52, 0.40, 0.24), (0.74, 0.62, 0.42)),
    CarColor("gray", 14, (0.48, 0.47, 0.46), (0.78, 0.77, 0.75)),
)
UMBRELLA = (
    CarColor("black", 50, (0.05, 0.05, 0.06), (0.12, 0.12, 0.13)),
    CarColor("blue", 16, (0.08, 0.14, 0.32), (0.22, 0.36, 0.60)),
    CarColor("red", 14, (0.45, 0.06, 0.08), (0.72, 0.14, 0.14)),
    CarColor("light", 12, (0.60, 0.58, 0.54), (0.84, 0.82, 0.78)),
    CarColor("green", 8, (0.10, 0.26, 0.16), (0.28, 0.46, 0.30)),
)
PAINTS = {
    "upper": UPPER,
    "lower": LOWER,
    "skin": SKIN,
    "hair": HAIR,
    "umbrella": UMBRELLA,
    "helmet": PASSENGER,
    "vehicle": PASSENGER,
}


def dressed(model: ThingModel, rng: np.random.Generator) -> tuple[tuple[float, float, float], ...]:
    """The colours of a model's paints, two random numbers each."""
    found = []
    for name, (u_color, u_shade) in zip(model.paints, rng.random((len(model.paints), 2)).tolist(), strict=True):
        among = PAINTS[name]
        number = Choice(tuple(range(len(among))), tuple(color.share for color in among)).draw(u_color)
        found.append(among[number].shade(u_shade))
    return tuple(found)
