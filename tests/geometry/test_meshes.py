"""The meshes against the geometry that labels are made from: two ways to the same surface."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import invert, project, transform
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import SINGLE, Shots, clips
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill

HILLS = (hill(30, -20, 25, 50), hill(-60, 60, -30, 40), hill(10, 90, 15, 30))
CURVED = {"offset_m50_m": 6, "offset_p50_m": -7, "offset_p100_m": 9, "exit_offset_m": 6, "ramp_height_m": 5}


def world_of(topology, **road):
    return resolve(changed(terrain={"gaussians": HILLS}, road={**CURVED, "topology": topology, **road}))


def heights_at(mesh, xy):
    """Heights of a mesh straight above or below points; NaN where it does not reach."""
    return MeshFaces([mesh]).height(xy)


def gaps_m(world):
    """Distances, straight up or down, of all label points from the nearest pavement; and how far they are away."""
    labels = label(world, world.view)
    points = np.concatenate([transform(labels.camera.world_from_cam, lane.xyz_cam) for lane in labels.lanes])
    gaps = np.abs([heights_at(mesh, points[:, :2]) - points[:, 2] for mesh in world.site.surfaces.pavement])
    away_m = np.hypot(*(points - world.view.eye_world)[:, :2].T)
    return np.where(np.isnan(gaps), np.inf, gaps).min(axis=0), away_m


STEEP = ("road.topology={2: 1, 3: 1, 4: 1}", "road.ramp_slope=[0.5, 1.5]", "road.exit_angle_deg=[3, 5]")


@pytest.mark.parametrize(
    ("overrides", "shots", "indices"),
    [
        ((), SINGLE, range(6)),
        (STEEP, SINGLE, range(6)),
        (STEEP, clips(5, 1), range(4, 30, 10)),
        (STEEP, Shots(cameras=load_rig("nuscenes")), range(3, 30, 18)),
    ],
)
def test_label_points_of_drawn_scenes_lie_on_the_pavement(overrides, shots, indices):
    """Within 5 mm to 40 m, and 1 cm up to the last, on ramps that rise 6 m over 3 m too."""
    params = load_params("appendix_i", ["trees.n=40", "cars.n=1", *overrides])
    steepest = 0
    for index in indices:
        world = sample_world(Scenes(params, 4, "test", shots=shots), index)
        steepest += world.network.roads[-1].ramp is not None
        gaps, away_m = gaps_m(world)
        assert gaps[away_m < 40].max() < 0.005, index
        assert gaps.max() < 0.01, (index, away_m[gaps.argmax()])
    assert steepest > 1


@pytest.mark.parametrize("topology", [1, 2, 3, 4])
def test_no_terrain_comes_through_a_road(topology):
    world = world_of(topology)
    ground, terrain = world.ground, world.site.surfaces.terrain
    x0, _, x1, _ = ground.paved.grid.area
    near = (np.abs(terrain.vertices_world[:, 0] - (x0 + x1) / 2) < 100) & (np.abs(terrain.vertices_world[:, 1]) < 130)
    kept = near[terrain.faces].all(axis=1)
    terrain = replace(terrain, faces=terrain.faces[kept], material=terrain.material[kept])
    for mesh in world.site.surfaces.pavement:
        middles = mesh.vertices_world[mesh.faces].mean(axis=1)[::7]
        # At its edges, where the terrain begins to go down, a steep slope of another road may cover a hand's breadth.
        inside = ground.clearance(middles[:, :2]) < -0.2
        points = middles[inside & (middles[:, 1] > -50) & (middles[:, 1] < 100)]
        points[:, 2] = heights_at(mesh, points[:, :2])
        above = points[:, 2] - heights_at(terrain, points[:, :2])
        assert np.nanmin(above) > 0.005
        assert np.nanmedian(above) > 0.25


def test_the_eye_sees_paint_in_its_place_on_hills_and_ramps():
    """Across its line, within a tenth of a pixel, wherever the road is not seen edge on."""
    for topology in (2, 3, 4):
        world = world_of(topology)
        view = world.view
        strips = world.paint(view)
        for curve in world.site.lines:
            if curve.kind == "delimiter" and len(strips[curve.id].faces):
                mesh = strips[curve.id]
                s = mesh.uv_m[0::2, 1]
                middle = (mesh.vertices_world[0::2] + mesh.vertices_world[1::2]) / 2
                # Where a line goes on along another road it may stand still for some centimetres.
                near = (s > -47) & (s < 10) & ((s < -0.1) | (s > 0))
                on_road, onwards, floating = (
                    project(view.img_from_cam, transform(invert(view.world_from_cam), points[near]))
                    for points in (curve.points_world(s), curve.points_world(s + 0.01), middle)
                )
                along = onwards - on_road
                off = floating - on_road
                aside_px = np.abs(off[:, 0] * along[:, 1] - off[:, 1] * along[:, 0]) / np.hypot(*along.T)
                steep = np.hypot(*along.T) > 0.005
                assert aside_px[steep].max(initial=0) < 0.1, curve.id


@pytest.mark.parametrize("index", range(4))
def test_far_roads_lie_on_the_ground_and_not_above_it(index):
    """A road on a high dam would stand out of a ridge like a ramp; one in the ground would show in pieces."""
    world = sample_world(
        Scenes(load_params("streets", ["trees.n=0", "cars.n=0", "road.topology=1"]), 5, "train"), index
    )
    terrain, (road,) = world.site.surfaces.terrain, world.site.surfaces.pavement
    corners = road.vertices_world[road.faces]
    # Upright faces at the edges end in the ground.
    across, along = np.moveaxis(corners[:, 2:, :2] - corners[:, :2, :2], 1, 0)
    corners = corners[np.abs(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]) > 1e-6]
    places = np.concatenate([corners.mean(axis=1), (corners[:, 0] + corners[:, 1]) / 2])
    away_m = np.hypot(places[:, 0], places[:, 1])
    for low_m, high_m, most_m in ((460, 800, 4), (800, 1600, 4), (1600, 3800, 6)):
        far = places[(away_m > low_m) & (away_m < high_m)]
        above_m = far[:, 2] - heights_at(terrain, far[:, :2])
        # The ground's mesh is pressed down by up to 2.4 m under a pavement.
        assert np.nanmax(above_m) < most_m
        assert np.nanmean(above_m > 0) > 0.999
