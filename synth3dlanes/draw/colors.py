"""Colours of vehicles as sold, and of clothes, skin, hair, umbrellas, helmets, bicycles. Display values from 0 to 1."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from synth3dlanes.params.distributions import Choice
from synth3dlanes.scene.assets.catalogue import TALL_M, CarModel, ThingModel

DisplayColor = tuple[float, float, float]


@dataclass(frozen=True)
class CarColor:
    """A named colour: its share of vehicles, and the two ends of its shades."""

    name: str
    share: float
    dark: DisplayColor
    light: DisplayColor

    def shade(self, u: float) -> DisplayColor:
        """The shade at u in [0, 1)."""
        red, green, blue = (round(low + (high - low) * u, 6) for low, high in zip(self.dark, self.light, strict=True))
        return red, green, blue


# Shares in per cent of new cars worldwide; sources and the split of the last four: docs/decisions.md.
PASSENGER = (
    CarColor("white", 38, (0.84, 0.84, 0.83), (0.97, 0.97, 0.96)),
    CarColor("black", 19, (0.03, 0.03, 0.04), (0.12, 0.12, 0.13)),
    CarColor("gray", 15, (0.26, 0.27, 0.29), (0.48, 0.49, 0.50)),
    CarColor("silver", 9, (0.62, 0.63, 0.64), (0.76, 0.77, 0.78)),
    CarColor("blue", 7, (0.05, 0.10, 0.26), (0.16, 0.34, 0.62)),
    CarColor("red", 5, (0.38, 0.03, 0.05), (0.74, 0.08, 0.08)),
    CarColor("brown", 3, (0.24, 0.17, 0.12), (0.60, 0.52, 0.42)),
    CarColor("green", 2, (0.07, 0.18, 0.13), (0.34, 0.42, 0.30)),
    CarColor("yellow", 1, (0.80, 0.62, 0.10), (0.93, 0.80, 0.20)),
    CarColor("orange", 1, (0.74, 0.28, 0.06), (0.88, 0.42, 0.10)),
)
COMMERCIAL = (
    CarColor("white", 55, (0.84, 0.84, 0.83), (0.97, 0.97, 0.96)),
    CarColor("silver", 9, (0.55, 0.56, 0.57), (0.76, 0.77, 0.78)),
    CarColor("blue", 10, (0.06, 0.16, 0.40), (0.20, 0.42, 0.70)),
    CarColor("red", 10, (0.55, 0.05, 0.06), (0.78, 0.12, 0.10)),
    CarColor("yellow", 6, (0.85, 0.66, 0.10), (0.95, 0.80, 0.18)),
    CarColor("green", 5, (0.08, 0.34, 0.18), (0.42, 0.62, 0.20)),
    CarColor("orange", 3, (0.80, 0.34, 0.06), (0.90, 0.46, 0.10)),
    CarColor("black", 2, (0.04, 0.04, 0.05), (0.12, 0.12, 0.13)),
)


def sold_color(model: CarModel, u_paint: float, u_shade: float) -> DisplayColor:
    """The colour of a vehicle as sold, from two numbers in [0, 1): a passenger car's paint, or a livery."""
    return _drawn(COMMERCIAL if model.height_m > TALL_M else PASSENGER, u_paint, u_shade)


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
    numbers = rng.random((len(model.paints), 2)).tolist()
    return tuple(_drawn(PAINTS[name], *own) for name, own in zip(model.paints, numbers, strict=True))


def _drawn(among: Sequence[CarColor], u_color: float, u_shade: float) -> DisplayColor:
    """A shade of one of some colours."""
    number = Choice(tuple(range(len(among))), tuple(color.share for color in among)).draw(u_color)
    return among[number].shade(u_shade)
