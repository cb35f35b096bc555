"""Check that rails, posts and buildings stand beside the pavement, by their places in the scene."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import transform
from synth3dlanes.validate.boxes import beside_world, structure_boxes
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.places import places
from synth3dlanes.world import World

# Kerbs stand at the very edge.
ROOM_M = 0.05


def check_roadside(world: World) -> Iterator[Finding]:
    """Findings about structures on a pavement. What stands on a median is left to the road's own checks."""
    for name, feet in _feet(world):
        inside_m = -np.nan_to_num(places(world.ground, feet).outside(), nan=np.inf)
        wrong = int((inside_m > ROOM_M).sum())
        if wrong:
            reason = (
                f"expected it beside the pavement, got {wrong} of {len(feet)} places up to {inside_m.max():.2f} m on it"
            )
            yield Finding("", f"roadside.{name}: {reason}")


def _feet(world: World) -> Iterator[tuple[str, Float[np.ndarray, "n 2"]]]:
    """The name of every structure with a place beside the road, and points where it stands."""
    roadside = world.scene.roadside
    for i, rail in enumerate(roadside.rails):
        if rail.side != "median":
            s = np.linspace(rail.from_m, rail.to_m, 2 + int(abs(rail.to_m - rail.from_m) / 2))
            yield f"rails.{i}", beside_world(world, rail.road, rail.side, s, rail.aside_m)
    for i, post in enumerate(roadside.posts):
        if post.side != "median":
            yield f"posts.{i}", beside_world(world, post.road, post.side, np.array([post.s_m]), post.aside_m)
    boxes = structure_boxes(world).boxes
    first = len(boxes.low) - len(roadside.buildings)
    share = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), [0.0]), -1).reshape(-1, 3)
    for i, (pose, low, high) in enumerate(zip(*(values[first:] for values in boxes), strict=True)):
        yield f"buildings.{i}", transform(pose, low + share * (high - low))[:, :2]
