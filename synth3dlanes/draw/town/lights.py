"""When the signals of a junction are green: phases one after the other, each for a group of lanes."""

from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.draws import Draw
from synth3dlanes.draw.town.rules import JunctionRules, LightGroup
from synth3dlanes.scene.traffic_elements import Phase, SignalState

AMBER_S, RED_AMBER_S, CLEAR_S = 3.0, 1.0, 2.0


class Lights(NamedTuple):
    """The green times of a junction's groups, one after the other, from `shift_s` seconds before time 0."""

    groups: tuple[LightGroup, ...]
    green_s: tuple[float, ...]
    shift_s: float

    @classmethod
    def draw(cls, rules: JunctionRules, own: Draw, rng: np.random.Generator) -> "Lights":
        """The lights of a junction."""
        has_arrow = any(rules.has_arrow(i) for i in rules.major)
        groups: tuple[LightGroup, ...] = ("major", "major_left", "minor") if has_arrow else ("major", "minor")
        green_s = tuple(round(own.at(f"green_{group}_s", rng.random()), 1) for group in groups)
        cycle_s = sum(green_s) + len(groups) * (AMBER_S + CLEAR_S)
        return cls(groups, green_s, round(float(rng.uniform(0, cycle_s)), 1))

    def phases(self, group: LightGroup) -> tuple[Phase, ...]:
        """What the signals of a group show through a cycle, which begins with the first group's green."""
        before_s = 0.0
        for other, green_s in zip(self.groups, self.green_s, strict=True):
            if other == group:
                break
            before_s += green_s + AMBER_S + CLEAR_S
        else:
            raise ValueError(f"group: expected one of {', '.join(self.groups)}, got {group}")
        after_s = self.cycle_s - before_s - green_s - AMBER_S - RED_AMBER_S
        own: list[tuple[SignalState, float]] = [("green", green_s), ("amber", AMBER_S)]
        if before_s < RED_AMBER_S:
            order = [*own, ("red", after_s), ("red_amber", RED_AMBER_S)]
        else:
            order = [("red", before_s - RED_AMBER_S), ("red_amber", RED_AMBER_S), *own, ("red", after_s + RED_AMBER_S)]
        return tuple(Phase(state=state, seconds=round(seconds, 3)) for state, seconds in order if seconds > 0.01)

    @property
    def cycle_s(self) -> float:
        """Seconds of a cycle."""
        return sum(self.green_s) + len(self.groups) * (AMBER_S + CLEAR_S)

    def state(self, group: LightGroup, time_s: float) -> SignalState:
        """What a group shows at a time."""
        left_s = (time_s + self.shift_s) % self.cycle_s
        for phase in self.phases(group):
            if left_s < phase.seconds:
                return phase.state
            left_s -= phase.seconds
        return "red"
