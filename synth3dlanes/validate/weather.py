"""Check that what follows from the weather and the time of day fits them."""

import math
from collections.abc import Iterator

from synth3dlanes.params.distributions import Choice, extent
from synth3dlanes.scene.change import value_at
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding

# Values of scenes are rounded to 1e-6.
ROUNDED = 1e-4


def check_weather(evidence: Evidence) -> Iterator[Finding]:
    """Findings for values that this weather and this time of day do not give; none for the user's own."""
    assert evidence.follows is not None
    weather = evidence.scene.weather
    for path, distribution in evidence.follows.items():
        value = value_at(evidence.scene, path.replace("_deg", "_rad"))
        value = math.degrees(value) if path.endswith("_deg") else value
        low, high = extent(distribution)
        possible = distribution.values if isinstance(distribution, Choice) else (min(max(value, low), high),)
        if min(abs(value - other) for other in possible) > ROUNDED:
            by = f"weather {weather.kind}, daytime {weather.daytime}"
            given = f"{low:g} to {high:g}" if low != high else f"{low:g}"
            yield Finding("", f"{path}: expected {given} ({by}), got {value:g}")
