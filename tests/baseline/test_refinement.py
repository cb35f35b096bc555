"""Lanes corrected by what the image has around their points."""

import math

import numpy as np
import pytest
import torch
from synth3dlanes_baseline.anchors import Targets, anchor_positions_m
from synth3dlanes_baseline.backbone import Lattice
from synth3dlanes_baseline.config import TINY, LossConfig, improved
from synth3dlanes_baseline.heads import ASIDE_M, ASIDE_PX, STEP_PX, WIDTH, CloseLook, Lanes, Refinement
from synth3dlanes_baseline.loss import loss
from synth3dlanes_baseline.model import LaneNet, Output
from synth3dlanes_baseline.projection import ImageMaps, invert_rigid, road_from_cam


def _lanes(config, x_m=0.0, z_m=0.0):
    shape = (2, len(config.types), 16, len(config.knots_y_m))
    return Lanes(torch.full(shape, x_m), torch.full(shape, z_m), torch.zeros(shape[:3]), torch.zeros(shape))


def _places(axis, lattice, wide, high):
    """A map whose features are their own place in the image, right (axis 0) or down."""
    n_rows, n_columns = high // lattice.stride, wide // lattice.stride
    place = torch.arange(n_columns if axis == 0 else n_rows) * float(lattice.stride) + lattice.offset
    grid = place.expand(n_rows, n_columns) if axis == 0 else place[:, None].expand(n_rows, n_columns)
    return grid.expand(2, 1, n_rows, n_columns)


def _looked_at(look, lanes, strides, f_px, size_px, pose):
    """The places in the image, right and down, whose features are mixed, each (image, type, anchor, map, aside, point).
    `pose` is pitch and height; the principal point is the middle of the image."""
    anchors_m, (wide, high) = torch.tensor(anchor_positions_m(improved(TINY))), size_px
    lattices = [Lattice(stride, stride / 2) for stride in strides]
    cam_from_top = invert_rigid(road_from_cam(torch.tensor([pose] * 2)))
    intrinsics = torch.tensor([[f_px, f_px, wide / 2, high / 2]] * 2)
    # The first reduced channel is the map itself, the others are zero.
    for reduce in look.reduce:
        torch.nn.init.zeros_(reduce.bias)
        torch.nn.init.zeros_(reduce.weight)
        reduce.weight.data[0] = 1.0
    given = []
    look.mix.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0].detach()))
    for axis in (0, 1):
        maps = [_places(axis, lattice, wide, high) for lattice in lattices]
        look(lanes, anchors_m, ImageMaps(maps, lattices, cam_from_top, intrinsics))
    shape = (len(strides), WIDTH, len(look.aside))
    return [value[:, : math.prod(shape)].reshape(2, 3, 16, *shape, -1)[:, :, :, :, 0] for value in given]


def test_it_looks_where_the_points_of_a_lane_are_in_the_image():
    config = improved(TINY)
    anchors_m = torch.tensor(anchor_positions_m(config))
    fx, cx, cy = 400.0, 800.0, 600.0
    pitch, height_m, x_m, z_m = 0.05, 1.6, 0.3, 2.0
    lanes = _lanes(config, x_m, z_m)
    seen = _looked_at(Refinement((1, 1, 1), config), lanes, (2, 4, 8), fx, (1600, 1200), (pitch, height_m))
    # The camera looks down by the pitch from above the road's origin; image rows count downwards.
    anchor = int(np.argmin(np.abs(anchors_m.numpy())))
    for knot, y_m in enumerate(config.knots_y_m):
        for i, aside_m in enumerate(ASIDE_M):
            right_m, above_m = float(anchors_m[anchor]) + x_m + aside_m, z_m - height_m
            depth_m = y_m * math.cos(pitch) - above_m * math.sin(pitch)
            up_m = y_m * math.sin(pitch) + above_m * math.cos(pitch)
            expected = (cx + fx * right_m / depth_m, cy - fx * up_m / depth_m)
            for level in range(3):
                found = [float(value[0, 1, anchor, level, i, knot]) for value in seen]
                assert found == pytest.approx(expected, abs=0.02), (y_m, aside_m, level)


def test_a_close_look_is_at_pixels_across_the_line_at_and_between_knots():
    config = improved(TINY)
    anchors_m = torch.tensor(anchor_positions_m(config))
    f_px, cx, cy, height_m = 400.0, 1600.0, 1200.0, 1.6
    knots_y_m = np.array(config.knots_y_m)
    lanes = _lanes(config)
    for name, step in (("x_m", 0.01), ("z_m", 0.02)):
        lanes = lanes._replace(**{name: torch.tensor(step * knots_y_m).float().expand(lanes.x_m.shape)})
    seen = _looked_at(CloseLook((1, 1), config), lanes, (2, 4), f_px, (3200, 2400), (0.0, height_m))
    points_y_m = np.interp(np.arange(28) / 3, np.arange(10), knots_y_m)
    for point, y_m in enumerate(points_y_m):
        u_px = cx + f_px * (float(anchors_m[8]) / y_m + 0.01)
        v_px = cy - f_px * (0.02 - height_m / y_m)
        for i, aside_px in enumerate(ASIDE_PX):
            for level in range(2):
                found = [float(value[0, 1, 8, level, i, point]) for value in seen]
                assert found == pytest.approx((u_px + aside_px, v_px), abs=0.02), (y_m, aside_px, level)


def test_a_close_look_moves_points_by_pixels_and_leaves_the_confidence_alone():
    config = improved(TINY)
    network = LaneNet(config).eval()
    image, intrinsics = torch.rand(1, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]])
    with torch.no_grad():
        before = network(image, intrinsics)
        torch.nn.init.ones_(network.close_look.points.bias)
        after = network(image, intrinsics)
    pixel_m = torch.tensor(config.knots_y_m) / 138.6
    for name in ("x_m", "z_m"):
        moved_px = (getattr(after, name) - getattr(before, name)) / pixel_m
        assert moved_px.flatten().tolist() == pytest.approx([STEP_PX] * moved_px.numel(), rel=1e-3), name
    assert after.logit.equal(before.logit)
    assert after.visible_logit.equal(before.visible_logit)


def test_untrained_it_changes_nothing_and_flat_lanes_stay_flat():
    torch.manual_seed(3)
    for has_elevation in (True, False):
        network = LaneNet(
            improved(TINY).model_copy(
                update={"refinements": 2, "has_elevation": has_elevation, "has_close_look": False}
            )
        ).eval()
        image, intrinsics = torch.rand(1, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]])
        with torch.no_grad():
            output = network(image, intrinsics)
            assert len(output.earlier) == 2
            for lanes in output.earlier:
                assert lanes.x_m.equal(output.x_m)
                assert lanes.z_m.equal(output.z_m)
                assert lanes.logit.equal(output.logit)
            torch.nn.init.ones_(network.refinements[1].points.bias)
            trained = network(image, intrinsics)
        assert (trained.x_m > output.x_m).all(), "a correction to the right moves lanes to the right"
        assert bool((trained.z_m > output.z_m).all()) == has_elevation


@pytest.mark.parametrize("variant", ["full", "top_view", "early_ipm", "late_ipm", "image_view"])
@pytest.mark.parametrize("pose_target", ["plane", "fixed"])
def test_every_variant_can_have_it(variant, pose_target):
    changes = {"refinements": 1, "has_close_look": True, "variant": variant, "pose_target": pose_target}
    changes |= {"fixed_pitch_deg": 4.0, "fixed_height_m": 1.5}
    with torch.no_grad():
        output = LaneNet(TINY.model_copy(update=changes)).eval()(
            torch.rand(1, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]])
        )
    assert output.x_m.isfinite().all()
    assert len(output.earlier) == 2
    if pose_target == "fixed":
        assert output.pose.tolist() == [pytest.approx([math.radians(4.0), 1.5])]


def test_every_stage_is_trained():
    lanes = _lanes(TINY)._replace(visible_logit=None)
    shape = lanes.x_m.shape
    yes, all_lanes = torch.ones(shape, dtype=torch.bool), torch.ones(shape[:3], dtype=torch.bool)
    targets = Targets(torch.zeros(shape), torch.zeros(shape), yes, yes, all_lanes, all_lanes)
    pose = torch.zeros(2, 2)

    def geometry(*errors_m: float) -> float:
        *earlier, last = (lanes._replace(x_m=torch.full(shape, error_m)) for error_m in errors_m)
        output = Output(*last, pose, torch.eye(4).expand(2, 4, 4), tuple(earlier))
        return float(loss(output, targets, pose, output.cam_from_top, TINY, LossConfig())["geometry"].mean())

    one = geometry(1.0)
    assert one == pytest.approx(shape[1] * shape[2] * shape[3])
    assert geometry(1.0, 0.0) == geometry(0.0, 1.0) == pytest.approx(one)
    assert geometry(1.0, 2.0) == pytest.approx(3 * one)
