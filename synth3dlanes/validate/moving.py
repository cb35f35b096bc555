"""Check that from picture to picture of a scene or drive objects move as the velocities of their labels say, and that
lines stay. Labels alone are compared."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.polylines import feet_of
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding, Instant, MovingObject

# The most that tyres hold, in metres per second squared. The mean speed between two pictures differs from the mean of
# both speeds by at most a quarter of the change that this allows.
MOST_ACCELERATION_M_S2 = 10.0
# Rounding of places, and of velocities in metres per second.
PLACE_ROUNDING_M, SPEED_ROUNDING_M_S = 0.002, 0.005
# A labelled velocity is along the body's axis. Where ramps begin, both axles stand on ground of different slopes, and
# the middle moves in another direction: by 0.1 radians in one of 350 cars, by 0.0003 in most.
OFF_AXIS = 0.15
# Every LINE_STEP-th point of a line is compared. In 34 pictures of clips and rigs no line is farther than 0.6 mm away.
LINE_STEP, LINE_M = 5, 0.02


def instant(evidence: Evidence) -> Iterator[Instant]:
    """What a picture of a clip or a rig tells of its objects and lines."""
    labels, world_from_cam = evidence.labels, evidence.camera.world_from_cam
    lines = {lane.id: transform(world_from_cam, lane.xyz_cam) for lane in labels.lanes}
    if evidence.known_world is None:
        if evidence.entry is not None and evidence.numbers is not None:
            yield Instant(f"{evidence.entry.split}:{evidence.numbers[0]}", labels.time_s or 0.0, {}, lines)
        return
    scene = evidence.scene
    if scene.shot.n_frames * scene.shot.n_cameras * scene.shot.n_views > 1:
        objects = {item.id: _object(world_from_cam, item) for item in labels.objects or ()}
        yield Instant(f"{scene.split}:{scene.index}", scene.shot.time_s, objects, lines)


def _object(world_from_cam: Float[np.ndarray, "4 4"], item: ObjectLabel) -> MovingObject:
    """An object by its place on the road, whose velocity is labelled."""
    foot_cam = transform(item.cam_from_object, np.array([[0.0, 0.0, -item.size_m[2] / 2]]))
    velocity = None if item.velocity_cam is None else world_from_cam[:3, :3] @ item.velocity_cam
    return MovingObject(transform(world_from_cam, foot_cam)[0], velocity)


def between(before: Instant, after: Instant) -> Iterator[Finding]:
    """Findings where an object is not where both of its velocities lead to, or a line not where it was."""
    step_s = after.time_s - before.time_s
    if before.scene != after.scene or step_s < 0:
        return
    for id_, points_world in after.lines.items():
        away_m = _from_line(before.lines[id_], points_world[::LINE_STEP]) if id_ in before.lines else np.zeros(0)
        if away_m.max(initial=0) > LINE_M:
            reason = f"expected it where the picture before has this line, got it up to {away_m.max():.2f} m away"
            yield Finding(id_, reason)
    least_m = PLACE_ROUNDING_M + SPEED_ROUNDING_M_S * step_s + MOST_ACCELERATION_M_S2 * step_s**2 / 4
    for number, now in after.objects.items():
        then = before.objects.get(number)
        if then is None:
            continue
        moved_m, expected_m = now.foot_world - then.foot_world, np.zeros(3)
        if step_s:
            if now.velocity_world is None or then.velocity_world is None:
                continue
            expected_m = step_s * (now.velocity_world + then.velocity_world) / 2
        level_m, up_m = np.hypot(*expected_m[:2]), abs(expected_m[2])
        off_level_m, off_up_m = np.hypot(*(moved_m - expected_m)[:2]), abs(moved_m[2] - expected_m[2])
        if not (off_level_m <= least_m + OFF_AXIS * up_m and off_up_m <= least_m + OFF_AXIS * level_m):
            yield Finding(
                "",
                f"objects.{number}: expected it moved by {_text(expected_m)} m in the {step_s:.3g} s since the picture "
                f"before, as its velocities say, got {_text(moved_m)} m",
            )


def _from_line(line: Float[np.ndarray, "m 3"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " _"]:
    """Distances of the points that are beside a line, not beyond its ends."""
    away_m, step, share = feet_of(points, line)
    at = step + share
    return away_m[(at > 0) & (at < len(line) - 1)]


def _text(vector: Float[np.ndarray, "3"]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in vector) + ")"
