"""What stands beside the road in real renders: ids, occlusion, and the checks of `validate`."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from synth3dlanes.blender.render import with_object_visibility
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.roadside import Building, Crossing, Post, Rail, Roadside
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed
from tests.validate.examining import findings

pytestmark = pytest.mark.render

GRAY = (0.3, 0.3, 0.3)
SMALL = {"width_px": 240, "height_px": 180, "fx_px": 207.0, "fy_px": 207.0, "cx_px": 120, "cy_px": 90}
WALL = Rail(
    kind="noise_wall", road="main", side="right", from_m=15.0, to_m=100.0, aside_m=0.3, height_m=4.0, color=GRAY
)
EVERYTHING = Roadside(
    rails=(
        WALL.model_copy(update={"kind": "guardrail", "side": "left", "from_m": -60.0, "height_m": 0.75}),
        WALL.model_copy(update={"kind": "kerb", "from_m": -60.0, "aside_m": 0.0, "height_m": 0.15}),
        WALL.model_copy(update={"aside_m": 3.0, "from_m": -60.0}),
    ),
    posts=(
        Post(kind="lamp", road="main", side="left", s_m=-20, aside_m=1.5, height_m=8),
        Post(kind="sign", road="main", side="right", s_m=-25, aside_m=1.8, height_m=2, face=9),
        Post(kind="delineator", road="main", side="left", s_m=-30, aside_m=1.0, height_m=1),
    ),
    crossings=(
        Crossing(kind="gantry", s_m=-10, clearance_m=5, width_m=0.9, color=(0.0, 0.1, 0.3)),
        Crossing(kind="bridge", s_m=30, clearance_m=5, width_m=9, color=GRAY),
    ),
    buildings=(
        Building(kind="hall", x_m=-40, y_m=0, yaw_rad=0.1, width_m=20, length_m=30, height_m=8, color=GRAY, roof=GRAY),
    ),
)
KINDS = ["barrier", "kerb", "barrier", "pole", "sign", "pole", "pole", "bridge", "building"]


def test_every_structure_has_its_ids_where_its_body_is():
    scene = changed(FLAT, camera=SMALL).model_copy(update={"roadside": EVERYTHING})
    world = resolve(scene)
    picture = take_picture(world, RenderSettings(samples=1, passes=("depth", "semantic", "instance")))
    semantic, instance = picture.passes["semantic"], picture.passes["instance"]
    for i, kind in enumerate(KINDS):
        # Boards of signs and gantries have ids of their own.
        own = SEMANTIC_IDS["pole" if kind == "sign" else kind]
        assert set(semantic[instance == instance_id("structure", i)].tolist()) == {own}, (i, kind)
    boards = numbers_of("structure", np.unique(instance[semantic == SEMANTIC_IDS["sign"]]))
    assert len(boards) >= 2
    assert boards.min() >= len(world.site.structures) - len(world.site.elements) == len(KINDS)
    sample = Evidence(world, picture.labels, picture.image, picture.passes)
    assert findings(sample, "ids", "points") == []
    swapped = np.where(instance == instance_id("structure", 0), instance_id("structure", 5), instance)
    found = findings(replace(sample, passes={**picture.passes, "instance": swapped}), "ids")
    assert "pixels of structure 5 within its body" in found[0].reason


def test_a_wall_hides_the_points_behind_it_and_no_others():
    """A bend behind a wall: the rendered depth says what is hidden."""
    road = {"offset_p50_m": 9.0, "offset_p100_m": 9.0}
    bare = changed(FLAT, road=road, camera={**SMALL, "lane": 3, "y_m": -40})
    walled = resolve(bare.model_copy(update={"roadside": Roadside(rails=(WALL.model_copy(update={"from_m": -20.0}),))}))
    settings = RenderSettings(samples=1, passes=("depth", "semantic"))
    without, behind = (take_picture(world, settings) for world in (resolve(bare), walled))
    semantic, depth = behind.passes["semantic"], behind.passes["depth"]
    assert (semantic == SEMANTIC_IDS["barrier"]).sum() > 300
    hidden = 0
    for free, lane in zip(without.labels.lanes, behind.labels.lanes, strict=True):
        assert free.object_visible.all()
        u, v = (lane.xyz_cam @ behind.labels.camera.img_from_cam.T)[lane.in_image].T[:2] / lane.xyz_cam[
            lane.in_image, 1
        ]
        column, row = np.clip(u.astype(int), 1, 238), np.clip(v.astype(int), 1, 178)
        around = np.stack([semantic[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
        nearer = depth[row, column] < 0.9 * lane.xyz_cam[lane.in_image, 1]
        is_wall = (around == SEMANTIC_IDS["barrier"]).all(axis=0) & nearer
        seen = lane.object_visible[lane.in_image]
        assert not seen[is_wall].any()
        assert seen[(around != SEMANTIC_IDS["barrier"]).all(axis=0)].all()
        hidden += int(is_wall.sum())
    assert hidden > 20


@pytest.mark.thorough
def test_structures_of_a_scene_are_gone_in_the_next():
    world = resolve(FLAT)
    labels = with_object_visibility(world, world.view, label(world, world.view), [])
    assert all(lane.object_visible.all() for lane in labels.lanes)
    take_picture(resolve(FLAT.model_copy(update={"roadside": EVERYTHING})), RenderSettings(samples=1))
    take_picture(world, RenderSettings(samples=1))
    assert all(item.pass_index < instance_id("structure", 0) for item in bpy.data.objects)
