"""Where features lie: homography, sampling grids, lattices, poses."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from synth3dlanes_baseline import curves
from synth3dlanes_baseline.backbone import PIXELS, ImagePathway
from synth3dlanes_baseline.config import MODELS
from synth3dlanes_baseline.curves import Pose, cam_from_road
from synth3dlanes_baseline.projection import (
    OUTSIDE,
    Projection,
    cell_centres,
    invert_rigid,
    road_from_cam,
    sampling_grid,
    top_from_road,
)

from synth3dlanes.geometry.frames import project, transform

PITCHES = st.floats(-0.05, 0.2)
HEIGHTS = st.floats(1.0, 2.5)
INTRINSICS = torch.tensor([[415.7, 415.7, 240.0, 180.0]])


@given(pitch=PITCHES, height=HEIGHTS, x=st.floats(-10, 10), y=st.floats(3, 100))
@settings(max_examples=50, deadline=None)
def test_projection_of_ground_points_is_the_homography_of_the_notes(pitch, height, x, y):
    cos, sin = math.cos(pitch), math.sin(pitch)
    h_r2i = np.array([[415.7, 0, 240.0], [0, 415.7, 180.0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, -sin, height * cos], [0, cos, height * sin]]
    )
    expected = h_r2i @ [x, y, 1]
    img_from_cam = np.array([[415.7, 240.0, 0], [0, 180.0, -415.7], [0, 1.0, 0]])
    point_cam = transform(cam_from_road(Pose(pitch, height)), np.array([x, y, 0.0]))
    assert project(img_from_cam, point_cam) == pytest.approx(expected[:2] / expected[2], abs=1e-6)
    # Inverse formulas: back to the ground from the pixel.
    u, v = expected[:2] / expected[2]
    tangent = (v - 180.0) / 415.7
    assert height * (cos - tangent * sin) / (sin + tangent * cos) == pytest.approx(y, rel=1e-6)
    assert (u - 240.0) / 415.7 * height / (sin + tangent * cos) == pytest.approx(x, abs=1e-6)


@given(pitch=PITCHES, height=HEIGHTS)
@settings(max_examples=30, deadline=None)
def test_numpy_and_torch_poses_agree_and_invert(pitch, height):
    from synth3dlanes_baseline import projection

    numpy_matrix = curves.road_from_cam(Pose(pitch, height))
    torch_matrix = projection.road_from_cam(torch.tensor([[pitch, height]]))
    assert torch_matrix[0].numpy() == pytest.approx(numpy_matrix, abs=1e-6)
    product = torch_matrix @ projection.invert_rigid(torch_matrix)
    assert torch.allclose(product, torch.eye(4).expand(1, 4, 4), atol=1e-6)


def test_a_point_to_the_right_and_ahead_of_a_turned_top_view():
    matrix = top_from_road(torch.tensor([math.pi / 2]), torch.tensor([1.0]))[0]
    # The grid faces left (road -x): a road point 5 m to the left lies 5 m ahead of it, 1 m left of its shifted middle.
    point_top = matrix @ torch.tensor([-5.0, 0.0, 0.0, 1.0])
    assert point_top[:3].tolist() == pytest.approx([-1.0, 5.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("name", ["paper", "compact", "tiny"])
def test_every_stage_reads_the_ground_position_of_its_cells(name):
    """An image whose channels are the ground position, shrunk as the backbone's lattice says, must come back as the
    cells' own positions at all four stages. Catches every shift by half a cell."""
    config = MODELS[name]
    backbone = ImagePathway(config)
    intrinsics = torch.tensor([config.reference_intrinsics])
    fx, fy, cx, cy = config.reference_intrinsics
    pose = torch.tensor([[0.05, 1.6]])
    cos, sin, height = math.cos(0.05), math.sin(0.05), 1.6
    cam_from_top = invert_rigid(road_from_cam(pose))
    for level, (lattice, (rows, columns)) in enumerate(
        zip(backbone.lattices, backbone.sizes(config.image_height_px, config.image_width_px), strict=True)
    ):
        u = lattice.offset + lattice.stride * torch.arange(columns)
        v = lattice.offset + lattice.stride * torch.arange(rows)
        tangent = ((v - cy) / fy)[:, None].expand(rows, columns)
        below = sin + tangent * cos
        depth = torch.where(below > 0.005, height / below, torch.nan)
        # x / depth and 1 / depth are linear in the pixel, so bilinear sampling of them is exact.
        inverse_depth, x_by_depth = 1 / depth, ((u - cx) / fx)[None].expand(rows, columns)
        picture = torch.stack([x_by_depth, inverse_depth])[None].nan_to_num(0.0)
        projection = Projection(2, 2, config.grid, level)
        seen = projection(picture, cam_from_top, intrinsics, lattice)[0]
        cells = cell_centres(config.grid, level)
        found_depth = 1 / seen[1]
        found_x, found_y = seen[0] * found_depth, (found_depth - height * sin) / cos
        inside = _well_inside(cells, (fx, fy, cx, cy), (cos, sin, height), lattice, (rows, columns))
        assert inside.sum() > 0.02 * inside.numel()
        tolerance = 0.01 + 2e-4 * cells[..., 1] ** 1.5
        assert ((found_x - cells[..., 0]).abs() < tolerance)[inside].all()
        assert ((found_y - cells[..., 1]).abs() < tolerance)[inside].all()


def _well_inside(cells, intrinsics, pose, lattice, size):
    fx, fy, cx, cy = intrinsics
    cos, sin, height = pose
    depth = cells[..., 1] * cos + height * sin
    u = cx + fx * cells[..., 0] / depth
    v = cy + fy * (height * cos - cells[..., 1] * sin) / depth
    horizon = cy - fy * sin / cos
    column, row = (u - lattice.offset) / lattice.stride, (v - lattice.offset) / lattice.stride
    first_row = (horizon + 0.005 * fy - lattice.offset) / lattice.stride + 1
    return (column > 0) & (column < size[1] - 1) & (row > first_row) & (row < size[0] - 1)


def test_offsets_through_the_backbones_are_half_their_strides():
    for name in ("paper", "compact", "nano"):
        assert [tuple(lattice) for lattice in ImagePathway(MODELS[name]).lattices] == [
            (2, 1.0),
            (4, 2.0),
            (8, 4.0),
            (16, 8.0),
        ]


def test_cells_behind_or_beside_the_camera_read_zero():
    pitched_up = torch.tensor([[-0.3, 1.6]])
    points = torch.tensor([[[0.0, 0.2, 0.0], [50.0, 5.0, 0.0], [0.0, 30.0, 0.0]]])
    grid = sampling_grid(points, invert_rigid(road_from_cam(pitched_up)), INTRINSICS, PIXELS, (360, 480))
    assert grid[0, 0, 0].tolist() == [OUTSIDE, OUTSIDE]
    assert grid[0, 0, 1, 0] > 1.5
    assert grid.isfinite().all()
