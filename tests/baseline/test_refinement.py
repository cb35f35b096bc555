"""Lanes corrected by what the image has around their points."""

import math

import numpy as np
import pytest
import torch
from synth3dlanes_baseline.anchors import Targets, anchor_positions_m
from synth3dlanes_baseline.config import TINY, LossConfig, improved
from synth3dlanes_baseline.lane_head import Lanes
from synth3dlanes_baseline.layers import Lattice
from synth3dlanes_baseline.loss import loss
from synth3dlanes_baseline.model import LaneNet, Output
from synth3dlanes_baseline.projection import invert_rigid, road_from_cam
from synth3dlanes_baseline.refinement import ASIDE_M, WIDTH, Refinement


def _lanes(config, x_m=0.0, z_m=0.0):
    shape = (2, len(config.types), 16, len(config.knots_y_m))
    return Lanes(torch.full(shape, x_m), torch.full(shape, z_m), torch.zeros(shape[:3]), torch.zeros(shape))


def test_it_looks_where_the_points_of_a_lane_are_in_the_image():
    config = improved(TINY)
    anchors_m = torch.tensor(anchor_positions_m(config))
    refinement = Refinement((1, 1, 1), config)
    lattices = [Lattice(stride, stride / 2) for stride in (2, 4, 8)]
    # Maps whose features are their own place in the image, right and then down.
    wide, high, fx, cx, cy = 1600, 1200, 400.0, 800.0, 600.0
    pitch, height_m, x_m, z_m = 0.05, 1.6, 0.3, 2.0
    cam_from_top = invert_rigid(road_from_cam(torch.tensor([[pitch, height_m]] * 2)))
    given = []
    refinement.mix.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0].detach()))
    for axis in (0, 1):
        for reduce in refinement.reduce:
            torch.nn.init.zeros_(reduce.bias)
            torch.nn.init.zeros_(reduce.weight)
            reduce.weight.data[0] = 1.0
        maps = []
        for stride, offset in lattices:
            n_rows, n_columns = high // stride, wide // stride
            place = torch.arange(n_columns if axis == 0 else n_rows) * float(stride) + offset
            grid = place.expand(n_rows, n_columns) if axis == 0 else place[:, None].expand(n_rows, n_columns)
            maps.append(grid.expand(2, 1, n_rows, n_columns))
        intrinsics = torch.tensor([[fx, fx, cx, cy]] * 2)
        refinement(_lanes(config, x_m, z_m), anchors_m, maps, lattices, cam_from_top, intrinsics)
    seen = [value[:, : 3 * len(ASIDE_M) * WIDTH].reshape(2, 3, 16, 3, WIDTH, len(ASIDE_M), -1) for value in given]
    # The camera looks down by the pitch from above the road's origin; image rows count downwards.
    anchor = int(np.argmin(np.abs(anchors_m.numpy())))
    for knot, y_m in enumerate(config.knots_y_m):
        for i, aside_m in enumerate(ASIDE_M):
            right_m, above_m = float(anchors_m[anchor]) + x_m + aside_m, z_m - height_m
            depth_m = y_m * math.cos(pitch) - above_m * math.sin(pitch)
            up_m = y_m * math.sin(pitch) + above_m * math.cos(pitch)
            expected = (cx + fx * right_m / depth_m, cy - fx * up_m / depth_m)
            for level in range(3):
                found = [float(value[0, 1, anchor, level, 0, i, knot]) for value in seen]
                assert found == pytest.approx(expected, abs=0.02), (y_m, aside_m, level)


def test_untrained_it_changes_nothing_and_flat_lanes_stay_flat():
    torch.manual_seed(3)
    for has_elevation in (True, False):
        network = LaneNet(improved(TINY).model_copy(update={"refinements": 2, "has_elevation": has_elevation})).eval()
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
    changes = {"refinements": 1, "variant": variant, "pose_target": pose_target}
    with torch.no_grad():
        output = LaneNet(TINY.model_copy(update=changes)).eval()(
            torch.rand(1, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]])
        )
    assert output.x_m.isfinite().all()
    assert len(output.earlier) == 1


def test_every_stage_is_trained():
    lanes = _lanes(TINY)._replace(visible_logit=None)
    shape = lanes.x_m.shape
    yes, all_lanes = torch.ones(shape, dtype=torch.bool), torch.ones(shape[:3], dtype=torch.bool)
    targets = Targets(torch.zeros(shape), torch.zeros(shape), yes, yes, all_lanes, all_lanes)
    pose = torch.zeros(2, 2)

    def geometry(*errors_m: float) -> float:
        *earlier, last = (lanes._replace(x_m=torch.full(shape, error_m)) for error_m in errors_m)
        output = Output(*last, pose, torch.eye(4).expand(2, 4, 4), tuple(earlier))
        return float(loss(output, targets, pose, TINY.types, LossConfig())["geometry"].mean())

    one = geometry(1.0)
    assert one == pytest.approx(shape[1] * shape[2] * shape[3])
    assert geometry(1.0, 0.0) == geometry(0.0, 1.0) == pytest.approx(one)
    assert geometry(1.0, 2.0) == pytest.approx(3 * one)
