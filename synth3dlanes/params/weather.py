"""What follows from the weather and the time of day: the ranges that replace those of keys which the user left open
(docs/params.md).

So fog comes with a closed sky, rain with a wet road, and night with headlights, a noisy sensor and a longer exposure.
"""

from typing import Any

from synth3dlanes.params.distributions import Choice, Distribution, Uniform


def _always(value: Any) -> Choice[Any]:
    return Choice((value,), (1.0,))


# By kind and by daytime: group.key -> distribution. No key is in both.
KINDS: dict[str, dict[str, Distribution]] = {
    "any": {},
    "clear": {
        "air.visibility_m": Uniform(8000.0, 60000.0),
        "air.overcast": Choice((0.0, 0.2), (3.0, 1.0)),
        "surface.wetness": Choice((0.0, 0.3), (6.0, 1.0)),
    },
    "cloudy": {
        "air.visibility_m": Uniform(4000.0, 40000.0),
        "air.overcast": Uniform(0.6, 1.0),
        "surface.wetness": Choice((0.0, 0.3, 0.6), (4.0, 1.0, 1.0)),
    },
    "fog": {
        "air.visibility_m": Uniform(100.0, 800.0),
        "air.overcast": _always(1.0),
        "surface.wetness": Choice((0.0, 0.3, 0.6), (2.0, 2.0, 1.0)),
    },
    "rain": {
        "air.visibility_m": Uniform(700.0, 6000.0),
        "air.overcast": Uniform(0.9, 1.0),
        "surface.wetness": Uniform(0.6, 1.0),
        "weather.rain": Uniform(0.15, 1.0),
        "sensor.drops": Uniform(0.0, 1.0),
    },
    "snow": {
        "air.visibility_m": Uniform(500.0, 5000.0),
        "air.overcast": Uniform(0.8, 1.0),
        "surface.wetness": Choice((0.0, 0.3, 0.6), (1.0, 1.0, 1.0)),
        "weather.snowfall": Choice((0.0, 0.3, 0.6, 1.0), (2.0, 1.0, 1.0, 1.0)),
        "weather.snow": Uniform(0.4, 1.0),
        "weather.snow_on_road": Choice((0.0, 0.15, 0.4, 0.7), (2.0, 2.0, 2.0, 1.0)),
        "sensor.drops": Choice((0.0, 0.3), (3.0, 1.0)),
    },
}
DAYTIMES: dict[str, dict[str, Distribution]] = {
    "any": {},
    "day": {"light.sun_zenith_deg": Uniform(15.0, 84.0)},
    "dusk": {
        "light.sun_zenith_deg": Uniform(86.0, 95.0),
        "light.metering": _always(1.0),
        "light.exposure": Uniform(0.8, 1.6),
        "sensor.noise": Uniform(1.0, 5.0),
        "sensor.motion_blur_m": Uniform(0.1, 0.6),
        "weather.headlights": _always(True),
    },
    "night": {
        "light.sun_zenith_deg": Uniform(98.0, 110.0),
        "light.metering": _always(1.0),
        "light.exposure": Uniform(0.9, 1.8),
        "sensor.noise": Uniform(2.0, 8.0),
        "sensor.flare": Uniform(0.2, 0.8),
        "sensor.motion_blur_m": Uniform(0.3, 0.9),
        "weather.headlights": _always(True),
    },
}


def replaced(kind: str, daytime: str) -> dict[str, Distribution]:
    """The distributions in this weather at this time of day, by `group.key`."""
    return KINDS[kind] | DAYTIMES[daytime]
