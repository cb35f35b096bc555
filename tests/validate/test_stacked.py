"""Measures that know roads over roads: lines of maps that fold but do not jump, wheels below a deck; trees on the bank
of a road, whose edge the faces of the terrain cut off."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.labels.labels import Lane
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.scene import Tree
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.validate.labels import order
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, map_scene, sections_road

LABELS = ground_truth(map_scene(FOUR_WAY, 95.0))
LANE = next(lane for lane in LABELS.lanes if lane.connector)


def beside_an_arc(radius_m: float, aside_m: float, grade: float) -> np.ndarray:
    """A line beside an arc, to its left where positive: a point every metre of the arc, which begins after a straight
    stretch."""
    turned = np.maximum(np.arange(-5.0, 12.0), 0.0) / radius_m
    straight = np.minimum(np.arange(-5.0, 12.0), 0.0)
    x, y = (radius_m - aside_m) * np.cos(turned) - radius_m, (radius_m - aside_m) * np.sin(turned) + straight
    return np.column_stack([x, y + 10, grade * np.arange(17.0)])


def found(xyz_cam: np.ndarray) -> str:
    n = len(xyz_cam)
    masks = {name: np.ones(n, bool) for name in ("in_image", "terrain_visible", "object_visible")}
    lane: Lane = replace(LANE, xyz_cam=xyz_cam, **masks)
    return " ".join(finding.reason for finding in order(LABELS.camera, lane))


@given(radius_m=st.floats(3, 500), aside_m=st.floats(-7, 30), grade=st.floats(-0.3, 0.3))
def test_a_line_that_folds_beside_a_tight_arc_is_right(radius_m: float, aside_m: float, grade: float) -> None:
    if abs(radius_m - aside_m) > 0.001 * radius_m and (radius_m - aside_m) / radius_m**2 > -1.4:
        assert found(beside_an_arc(radius_m, aside_m, grade)) == ""


@pytest.mark.parametrize("step", [(3.5, 0, 0), (-2, 0, 0), (0, 0, 3)])
@pytest.mark.parametrize("first", [16, 8])
def test_a_line_that_jumps_is_found(step: tuple[float, float, float], first: int) -> None:
    points = beside_an_arc(100, 3, 0.05)
    points[first:] += step
    assert "got a jump" in found(points)


def test_what_stands_below_a_deck_stands_on_the_road_there() -> None:
    square, faces = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]]), np.array([[0, 1, 2, 3]])
    levels = [Mesh(np.column_stack([square, np.full(4, z)]), faces, square, np.zeros(1, int)) for z in (0.0, 6.0)]
    points = np.array([[5, 5, 0.1], [5, 5, 6.1], [5, 5, 5.0], [5, 5, -9.0], [15, 5, 0]])
    np.testing.assert_allclose(
        MeshFaces(levels).height(points[:, :2], points[:, 2] + 3), [0, 6, 6, 0, np.nan], atol=1e-9
    )
    np.testing.assert_allclose(MeshFaces(levels).height(points[:, :2])[:4], 6, atol=1e-9)


def test_trees_on_a_bank_have_their_roots_in_the_faces_that_are_drawn() -> None:
    """Far from the host, where the ground itself is up to a metre over its faces."""
    values = sections_road().model_dump()
    values["roads"][0]["heights"] = ({"s_m": 0.0, "a": 4.0},)
    ground = resolve(map_scene(RoadMap.model_validate(values), 2.0)).ground
    xy = np.random.default_rng(0).uniform((-30, 0), (50, 70), (2000, 2))
    xy = xy[(ground.clearance(xy) > 1) & (ground.clearance(xy) < 12)]
    trees = tuple(Tree(model=1, x_m=x, y_m=y, yaw_rad=0, scale=1) for x, y in xy.tolist())
    world = resolve(map_scene(RoadMap.model_validate(values), 2.0, trees=[tree.model_dump() for tree in trees]))
    drawn_m = MeshFaces([world.site.surfaces.terrain]).height(xy)
    base_m = world.site.trees_world[:, 2]
    assert (ground.height(xy) - drawn_m).max() > 0.9
    assert (base_m - drawn_m).max() < 0.2
    is_lower = base_m < ground.height(xy) - 0.1001
    assert (base_m - drawn_m)[is_lower].min() > -0.4
    assert 0 < is_lower.mean() < 0.2, "others stand where they stood"
