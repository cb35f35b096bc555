"""Which lane points a camera sees over the ground. World frame."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.world.ground import Ground

# Lines of sight are compared with the ground at points SIGHT_STEP_M apart, at every sixth first: most lines that the
# ground hides are in it at one of these.
SIGHT_STEP_M, FIRST_STEPS = 2.0, 6
# Ground above the line of sight by less than this does not count: points lie on the ground themselves.
TOLERANCE_M = 0.01
# Lines of sight are tested against a crest also if they miss the direction of its end by less than this.
TOLERANCE_RAD = 1e-9


def seen_over_ground(
    ground: Ground, eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """True where the straight line from the eye to the point stays above terrain, embankments and roads."""
    to = points_world - eye_world
    ray, step, sight = along_sights(eye_world, to, SIGHT_STEP_M)
    is_first, seen = step % FIRST_STEPS == 0, np.ones(len(to), dtype=bool)
    limits_m = ground.paved.limits(sight[:, :2])
    for some in (is_first, ~is_first):
        asked = np.flatnonzero(some & seen[ray])
        least_m, most_m = (at[asked] for at in limits_m)
        hidden = ground.is_in(sight[asked] + np.array([0.0, 0.0, TOLERANCE_M]), (least_m, most_m))
        seen[ray[asked[hidden]]] = False
    seen[seen] = ~_behind_crests(eye_world, to[seen], ground.paved.crests())
    return seen


def along_sights(
    eye_world: Float[np.ndarray, "3"], to: Float[np.ndarray, "n 3"], step_m: float
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Points inside lines of sight (vectors from the eye to their ends), at most a step apart from above: the number of
    the line of each, its own number on that, from 1 on, and their places."""
    n_steps = np.maximum(np.ceil(np.linalg.norm(to[:, :2], axis=1) / step_m).astype(int), 2)
    ray = np.repeat(np.arange(len(to)), n_steps - 1)
    step = np.arange(len(ray)) - np.repeat(np.cumsum(n_steps - 1) - (n_steps - 1), n_steps - 1) + 1
    return ray, step, eye_world + to[ray] * (step / n_steps[ray])[:, None]


def _behind_crests(
    eye_world: Float[np.ndarray, "3"], to: Float[np.ndarray, "n 3"], crests_world: Sequence[Float[np.ndarray, "_ 3"]]
) -> Bool[np.ndarray, " n"]:
    """Which lines of sight (vectors from the eye to their ends) pass below a crest before they end. Crests are narrower
    than SIGHT_STEP_M, so that crossings seen from above are computed instead of sampled."""
    hidden, to_rad = np.zeros(len(to), dtype=bool), np.arctan2(to[:, 1], to[:, 0])
    for crest_world in crests_world:
        toward = crest_world - eye_world
        turned = np.unwrap(np.arctan2(toward[:, 1], toward[:, 0]))
        after = (to_rad - turned.min() + TOLERANCE_RAD) % (2 * np.pi)
        asked = np.flatnonzero((after < np.ptp(turned) + 2 * TOLERANCE_RAD) & ~hidden)
        start, along = toward[:-1], np.diff(crest_world, axis=0)
        x, y, z = to[asked].T[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            across = x * along[:, 1] - y * along[:, 0]
            share = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / across
            place = (start[:, 0] * y - start[:, 1] * x) / across
            below = share * z < start[:, 2] + place * along[:, 2] - TOLERANCE_M
        hidden[asked] = ((share > 0) & (share < 1) & (place >= 0) & (place <= 1) & below).any(axis=1)
    return hidden
