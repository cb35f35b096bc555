"""Somebody at a crosswalk through a clip: walks up to the kerb, waits there until the way is free, and crosses. World
frame, metres and seconds; lengths are along the way, from where one waits."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from synth3dlanes.system.arrays import Points2, Scalars

# Where one waits, behind the kerb, and where ways from and to crosswalks turn.
WAIT_M, BEHIND_M = 0.75, 1.4
# Steps of time; accelerations; whoever is this near to where one waits is seen to want to cross.
STEP_S, ACCELERATION_M_S2, NEAR_M = 0.2, 1.5, 1.5
# Half of a stride, and some room.
BODY_M = 0.6
# The longest way up to a crosswalk.
MOST_BEFORE_M = 12.0


@dataclass(eq=False)
class Crosser:
    """Somebody who crosses from a kerb to the one beyond; negative lengths are before the place where one waits.
    `track_m` are the lengths at every step from the clip's start on."""

    kerb: Float[np.ndarray, "2"]
    beyond: Float[np.ndarray, "2"]
    wish_m_s: float
    gone_m: float
    speed_m_s: float = 0.0
    started: bool = False
    track_m: list[float] = field(default_factory=list)

    @classmethod
    def draw(cls, kerb: Points2, speed_m_s: float, share: float, duration_s: float) -> "Crosser":
        """Somebody who may be anywhere from far enough before the kerb to the other one when a clip begins."""
        width_m = float(np.linalg.norm(kerb[1] - kerb[0]))
        before_m = min(speed_m_s * duration_s, MOST_BEFORE_M)
        return cls(kerb[0], kerb[1], speed_m_s, -before_m + share * (before_m + WAIT_M + width_m))

    @property
    def ahead(self) -> Float[np.ndarray, "2"]:
        """The direction in which it crosses."""
        along = self.beyond - self.kerb
        return np.asarray(along / np.linalg.norm(along))

    @property
    def across_m(self) -> float:
        """The length at the kerb beyond."""
        return WAIT_M + float(np.linalg.norm(self.beyond - self.kerb))

    @property
    def wants_to_cross(self) -> bool:
        """Whether it is about to cross, or waits for it."""
        return not self.started and self.gone_m > -NEAR_M

    def within(self, sides: Points2) -> tuple[float, float]:
        """The lengths between which its body is between both sides of a lane."""
        low_m, high_m = sorted(((sides - self.kerb) @ self.ahead).tolist())
        return WAIT_M + low_m - BODY_M, WAIT_M + high_m + BODY_M

    def seconds_to(self, length_m: float) -> float:
        """The time until it is at a length, if it crosses from now on; 0 behind it."""
        return max(length_m - self.gone_m, 0.0) / self.wish_m_s

    def begin(self, may_start: Callable[[], bool]) -> None:
        """Note where it is at the clip's start. Whoever is on the street then, but should not be, still waits."""
        if self.gone_m > -self._braking_m:
            self.started = may_start()
            self.gone_m = self.gone_m if self.started else min(self.gone_m, 0.0)
        self.speed_m_s = self.wish_m_s if self.started else self._most_m_s
        self.track_m = [self.gone_m]

    def step(self, may_start: Callable[[], bool]) -> None:
        """Go on by STEP_S; `may_start` is asked when it is at the kerb."""
        if not self.started and self.gone_m > -self._braking_m - self.wish_m_s * STEP_S:
            self.started = may_start()
        most_m_s = self.wish_m_s if self.started else self._most_m_s
        speed_m_s = min(most_m_s, self.speed_m_s + ACCELERATION_M_S2 * STEP_S)
        self.gone_m += (self.speed_m_s + speed_m_s) / 2 * STEP_S
        self.gone_m = self.gone_m if self.started else min(self.gone_m, 0.0)
        self.speed_m_s = speed_m_s
        self.track_m.append(self.gone_m)

    def gone_at(self, times_s: Scalars) -> Scalars:
        """The lengths at times of the clip."""
        return np.interp(times_s, STEP_S * np.arange(len(self.track_m)), self.track_m)

    @property
    def _braking_m(self) -> float:
        return self.wish_m_s**2 / (2 * ACCELERATION_M_S2)

    @property
    def _most_m_s(self) -> float:
        """The highest speed at which it stops where one waits."""
        return min(self.wish_m_s, float(np.sqrt(2 * ACCELERATION_M_S2 * max(-self.gone_m, 0.0))))


def kept_after(gone_m: Scalars, from_m: float) -> Scalars:
    """Lengths of somebody who stands at a length until another one would pass it, and then goes on smoothly."""
    return _eased(gone_m - from_m) + from_m


def kept_before(gone_m: Scalars, to_m: float) -> Scalars:
    """Lengths of somebody who stops smoothly at a length, where another one would go on."""
    return to_m - _eased(to_m - gone_m)


def _eased(length_m: Scalars) -> Scalars:
    """0 below -BODY_M, the length above BODY_M, and a parabola between."""
    within = np.clip(length_m, -BODY_M, BODY_M)
    return np.maximum(length_m - BODY_M, 0.0) + (within + BODY_M) ** 2 / (4 * BODY_M)
