"""The network's shapes, its start, the loss, and what augmentation does to image and labels."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from synth3dlanes_baseline import projection
from synth3dlanes_baseline.anchors import Targets, anchor_positions_m, encode
from synth3dlanes_baseline.augment import augment, flip, generator_for, rotate, saturate, sharpen
from synth3dlanes_baseline.config import OUR_AUGMENTATION, PAPER, TINY, Augmentation, LossConfig, train_config
from synth3dlanes_baseline.curves import Y_REF_M
from synth3dlanes_baseline.data import annotation_of, pack
from synth3dlanes_baseline.loading import Example, collate
from synth3dlanes_baseline.loss import ALONG, loss
from synth3dlanes_baseline.model import LaneNet, Output
from synth3dlanes_baseline.projection import ImageMaps, invert_rigid, road_from_cam

from synth3dlanes.geometry import frames
from synth3dlanes.geometry.frames import invert, project, transform
from tests.baseline import roads


def _batch(n=2, size_px=(160, 120), seed=0):
    def example(sample):
        annotation = annotation_of(sample.key, sample.labels, (size_px[1], size_px[0]), "plane")
        return Example(np.asarray(sample.image), annotation)

    samples = roads.samples(np.random.default_rng(seed), n, size_px)
    return collate([example(sample) for sample in samples]).to(torch.device("cpu"))


def _targets(batch, config):
    return encode(batch.curves, road_from_cam(batch.target_pose), config)[0]


@pytest.mark.parametrize(
    "row", ["full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position", "no_supervision"]
)
def test_every_ablation_gives_39_values_per_anchor_from_the_same_start(row):
    batch = _batch()
    torch.manual_seed(0)
    model = LaneNet(train_config("tiny", ablation=row).model).eval()
    torch.manual_seed(0)
    full = LaneNet(TINY)
    n_anchors = 30 if row == "image_view" else 16
    with torch.no_grad():
        output = model(batch.image, batch.intrinsics)
    assert output.x_m.shape == output.z_m.shape == (2, 3, n_anchors, 6)
    assert output.logit.shape == (2, 3, n_anchors)
    assert model.head.out.out_channels == 39
    for mine, its in zip(model.image.parameters() if model.image else [], full.image.parameters(), strict=False):
        assert mine.equal(its)


@pytest.mark.parametrize("name", ["paper", "tiny"])
def test_anchors_of_the_image_view_read_the_columns_where_they_meet_the_road(name):
    config = train_config(name, ablation="image_view").model
    model = LaneNet(config)
    rows, columns = config.image_height_px // 16, config.image_width_px // 16
    u_px = (16 * torch.arange(columns) + 8.0).expand(1, 1, rows, columns)
    image, intrinsics = torch.zeros(1, 3, 16, 16), torch.tensor([config.reference_intrinsics])
    seen = model._top_features(image, ImageMaps([u_px] * 4, [], torch.eye(4)[None], intrinsics))
    fx, fy, cx, cy = config.reference_intrinsics
    pose = frames.road_from_cam(config.fixed_height_m, math.radians(config.fixed_pitch_deg))
    points_road = np.array([[x_m, Y_REF_M, 0.0] for x_m in model.anchors_m.tolist()])
    img_from_cam = np.array([[fx, cx, 0], [0, cy, -fy], [0, 1.0, 0]])
    expected = project(img_from_cam, transform(invert(pose), points_road))[:, 0]
    assert expected.shape == (30,)
    # The outermost columns have no neighbour to interpolate with.
    assert seen[0, 0, 0, 1:-1].tolist() == pytest.approx(expected[1:-1], abs=1e-3)
    assert np.diff(model.anchors_m.numpy()) == pytest.approx(np.full(29, 0.7718), abs=2e-4)


COMPILED = """
import torch
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.model import LaneNet

image, intrinsics = torch.rand(2, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]] * 2)
for row in ("full", "improved"):
    found, gradients = [], []
    for is_compiled in (False, True):
        torch.manual_seed(0)
        model = LaneNet(train_config("tiny", {}, row).model)
        if is_compiled:
            model.compile(backend="aot_eager", fullgraph=True)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = model(image, intrinsics, torch.tensor([[0.04, 1.6]] * 2), torch.eye(4).expand(2, 4, 4))
        sum(lanes.x_m.sum() + lanes.logit.sum() for lanes in (*output.earlier, output)).backward()
        found.append(output.x_m.detach())
        gradients.append(next(model.parameters()).grad)
    assert gradients[0].abs().max() > 0
    torch.testing.assert_close(found[1], found[0])
    torch.testing.assert_close(gradients[1], gradients[0])
"""


@pytest.mark.thorough
def test_compiled_it_is_one_graph_with_the_same_lanes_and_gradients():
    # Apart from this process, whose checks of every array's shape the compiler cannot follow.
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1"}
    run = subprocess.run([sys.executable, "-c", COMPILED], env=one_thread, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_paper_has_the_sizes_of_the_notes():
    model = LaneNet(PAPER)
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(23.7e6, rel=0.005)
    assert [layer[0].kernel_size[0] for layer in model.head.reduce] == [3, 3, 3, 5, 5, 5, 5]
    assert model.head.fold[0].kernel_size == (4, 5)
    assert LaneNet(PAPER.model_copy(update={"variant": "image_view"})).anchors_m.shape == (30,)


def test_the_network_starts_at_the_mean_pose_and_a_low_confidence():
    batch = _batch()
    with torch.no_grad():
        output = LaneNet(TINY).eval()(batch.image, batch.intrinsics)
    assert torch.rad2deg(output.pose[:, 0]).tolist() == pytest.approx([2.5, 2.5])
    assert output.pose[:, 1].tolist() == pytest.approx([1.65, 1.65])
    assert output.logit.sigmoid().mean() == pytest.approx(0.05, abs=0.02)


def test_lane_loss_reaches_the_pose_only_through_a_grid_with_gradient():
    batch = _batch()
    for row, has_gradient in (("full", False), ("no_supervision", True)):
        torch.manual_seed(1)
        config = train_config("tiny", ablation=row)
        assert (config.loss.pose == config.label_pose_fraction == 0) == has_gradient, "it is all that teaches the pose"
        model = LaneNet(config.model)
        model(batch.image, batch.intrinsics).x_m.sum().backward()
        gradient = model.pose.residual.bias.grad
        assert (gradient is not None and bool(gradient.abs().sum() > 0)) == has_gradient


def test_loss_of_perfect_output_is_only_the_confidence():
    batch = _batch()
    targets = _targets(batch, TINY)
    terms = _loss(_output(targets, batch), targets, batch.target_pose, LossConfig())
    assert terms["geometry"].abs().max() == 0
    assert terms["pose"].abs().max() == 0
    assert terms["detection"].max() < 1e-3
    off = _output(targets, batch)._replace(pose=batch.target_pose + torch.tensor([math.radians(1.0), 0.1]))
    terms = _loss(off, targets, batch.target_pose, LossConfig())
    assert terms["pose"].tolist() == pytest.approx([1.1, 1.1], rel=1e-4), "a degree counts as much as a metre"


def test_the_image_term_is_what_the_camera_sees():
    # One straight line on a level road, seen from above it without pitch: all of it is in one direction of the image.
    right_m, height_m = 1.8, 1.6
    knots_y_m, anchors_m = torch.tensor(TINY.knots_y_m), torch.tensor(anchor_positions_m(TINY))
    assigned = torch.zeros(1, 3, 16, dtype=torch.bool)
    assigned[0, 2, 9] = True
    known = assigned[..., None].expand(1, 3, 16, len(knots_y_m))
    x_m, z_m = (right_m - anchors_m)[:, None].expand(known.shape), torch.zeros(known.shape)
    targets = Targets(x_m, z_m, known, known, assigned, assigned)
    pose = torch.tensor([[0.0, height_m]])

    def image(dx_m: float, dz_m: float) -> float:
        output = _output(targets, None)._replace(x_m=x_m + dx_m, z_m=z_m + dz_m)
        return float(_loss(output, targets, pose, LossConfig(image=1.0))["image"])

    # The line leads right and down from the vanishing point; what is wider and lower by one share lies on it, too.
    for dx_m, dz_m in ((0, 0), (0.1, 0), (-0.1, 0), (0.09, -0.08), (0.09, 0.08), (0.03, -0.07)):
        across_m, along_m = abs(dx_m * height_m + dz_m * right_m), abs(dx_m * right_m - dz_m * height_m)
        seen_m = (across_m + ALONG * along_m) / math.hypot(right_m, height_m)
        assert image(dx_m, dz_m) == pytest.approx(seen_m * float((1000 / knots_y_m).sum()), rel=1e-4, abs=1e-4)
    assert "image" not in _loss(_output(targets, None), targets, pose, LossConfig())


def test_hidden_knots_and_ignored_lanes_get_no_gradient():
    labels = roads.labels([lambda y: (0.1, 0 * y), (lambda y: (4.1, 0 * y), 0.0, 15.0), lambda y: (10.6, 0 * y)],
                          hidden=(50.0, 200.0))  # fmt: skip
    pose = torch.tensor([[labels.camera.pitch_rad, labels.camera.height_m]])
    targets, _ = encode(pack([annotation_of("", labels, (360, 480), "plane")]), road_from_cam(pose), TINY)
    x_m, z_m, logit = (torch.randn(1, 3, 16, *tail, requires_grad=True) for tail in ((6,), (6,), ()))
    output = _output(targets, None)._replace(x_m=x_m, z_m=z_m, logit=logit, pose=pose)
    _loss(output, targets, pose, LossConfig())["total"].sum().backward()
    touched = torch.nonzero(x_m.grad[0]).tolist()
    assert touched == [[0, 8, 0], [0, 8, 1], [0, 8, 2]]
    assert torch.nonzero(z_m.grad[0]).tolist() == touched
    assert bool((logit.grad != 0).all()), "these ignored lanes pass no anchor within 0.64 m at Y_ref"


def test_unlabelled_kinds_enter_no_term():
    batch = _batch()
    targets = _targets(batch, TINY)
    logit = torch.zeros_like(targets.x_m[..., 0]).requires_grad_()
    x_m = torch.zeros_like(targets.x_m).requires_grad_()
    output = _output(targets, batch)._replace(logit=logit, x_m=x_m)
    config = LossConfig(kinds=("delimiter",))
    _loss(output, targets, batch.target_pose, config)["total"].sum().backward()
    assert logit.grad[:, :2].abs().max() == x_m.grad[:, :2].abs().max() == 0
    assert logit.grad[:, 2].abs().min() > 0


def test_flip_twice_is_the_identity_and_once_mirrors_the_targets():
    batch = _batch(n=4)
    chosen = torch.tensor([True, False, True, True])
    once, twice = flip(batch, chosen), flip(flip(batch, chosen), chosen)
    assert twice.image.equal(batch.image)
    assert twice.curves.xyz_cam.equal(batch.curves.xyz_cam)
    assert twice.intrinsics.equal(batch.intrinsics)
    before, after = _targets(batch, TINY), _targets(once, TINY)
    assert after.assigned[0].any(0).equal(before.assigned[0].any(0).flip(0))
    assert after.assigned[1].equal(before.assigned[1])
    where = before.assigned[0, 0]
    assert torch.allclose(after.x_m[0, 0].flip(0)[where], -before.x_m[0, 0][where], atol=1e-4)


@pytest.mark.parametrize(("pitch_deg", "yaw_deg"), [(1.5, 0.0), (0.0, 4.0), (-1.0, -3.0)])
def test_virtual_rotation_moves_picture_and_labels_together(pitch_deg, yaw_deg):
    batch = _batch(n=1, size_px=(480, 360))
    point_cam = torch.tensor([[1.0, 18.0, -0.8]])
    curves = batch.curves._replace(xyz_cam=point_cam.expand(batch.curves.xyz_cam.shape).clone())
    batch = batch._replace(image=_spot(_pixel(batch.intrinsics, point_cam)), curves=curves)
    turned = rotate(batch, torch.tensor([math.radians(pitch_deg)]), torch.tensor([math.radians(yaw_deg)]))
    expected = _pixel(turned.intrinsics, turned.curves.xyz_cam[0, 0, :1])
    assert _centroid(turned.image) == pytest.approx(expected.tolist(), abs=0.15)
    # Looking further down lifts the world in the picture; turning right moves it left.
    before = _pixel(batch.intrinsics, point_cam)
    if pitch_deg:
        assert (expected[1] < before[1]) == (pitch_deg > 0)
    if yaw_deg:
        assert (expected[0] < before[0]) == (yaw_deg > 0)
    # No roll arises: relative to the new pose's plane, the point stands as high as it stood.
    old_road = road_from_cam(batch.plane_pose)[0] @ torch.tensor([*point_cam[0], 1.0])
    new_road = road_from_cam(turned.plane_pose)[0] @ torch.tensor([*turned.curves.xyz_cam[0, 0, 0], 1.0])
    assert new_road[2] == pytest.approx(float(old_road[2]), abs=1e-5)
    assert new_road[:2].norm() == pytest.approx(float(old_road[:2].norm()), abs=1e-5)
    assert math.degrees(float(turned.plane_pose[0, 0] - batch.plane_pose[0, 0])) == pytest.approx(pitch_deg, abs=1e-4)


def test_augmentation_of_a_step_repeats():
    batch = _batch()
    first, second, other = (
        augment(batch, OUR_AUGMENTATION, generator_for(3, step, 0, torch.device("cpu"))) for step in (7, 7, 8)
    )
    assert first.batch.image.equal(second.batch.image)
    assert not first.batch.image.equal(other.batch.image)


def test_differences_between_cameras_change_colours_and_edges_alone():
    batch = _batch()
    image, twice = batch.image, torch.ones(2)
    gray = saturate(image, torch.full((len(image),), -1.0))
    assert torch.allclose(gray, image.mean(1, keepdim=True).expand_as(image), atol=1e-6)
    assert torch.allclose(saturate(image, twice) - gray, 2 * (image - gray), atol=1e-6), "farther from gray"
    edge = torch.zeros(1, 3, 9, 9)
    edge[..., 4:] = 0.8
    blurred, sharp = (sharpen(edge, torch.tensor([amount]))[0, 0, 4] for amount in (-1.0, 1.0))
    assert blurred[3:5].tolist() == pytest.approx([0.2, 0.6]), "half of the neighbours are across the edge"
    assert sharp[3:5].tolist() == pytest.approx([-0.2, 1.0]), "the dark side is darker, the bright side brighter"
    for picture in (blurred, sharp):
        assert picture[[0, 1, 2, 5, 6, 7, 8]].equal(edge[0, 0, 4][[0, 1, 2, 5, 6, 7, 8]])
    plain = Augmentation(flip=0, brightness=0, contrast=0, noise=0)
    tinted = augment(batch, plain.model_copy(update={"tint": 0.2}), generator_for(0, 0, 0, torch.device("cpu"))).batch
    inside = (image > 0.1) & (tinted.image < 0.99)
    for before, after, where in zip(image.flatten(0, 1), tinted.image.flatten(0, 1), inside.flatten(0, 1), strict=True):
        factors = (after / before)[where]
        assert factors.max() - factors.min() < 1e-4, "one gain for each colour of an image"
    assert tinted.image[0].sub(image[0]).mean((1, 2)).std() > 1e-3, "colours change unlike each other"
    for name in ("intrinsics", "plane_pose", "target_pose"):
        assert getattr(tinted, name).equal(getattr(batch, name))


def _loss(output, targets, pose, config):
    return loss(output, targets, pose, invert_rigid(road_from_cam(pose)), TINY, config)


def _output(targets, batch):
    logit = torch.where(targets.assigned, 20.0, -20.0)
    pose = torch.zeros(len(logit), 2) if batch is None else batch.target_pose
    return Output(targets.x_m, targets.z_m, logit, None, pose, torch.eye(4).expand(len(logit), 4, 4))


def _pixel(intrinsics, point_cam):
    fx, fy, cx, cy = intrinsics[0]
    x, y, z = point_cam[0]
    return torch.stack([cx + fx * x / y, cy - fy * z / y])


def _spot(at_px):
    v, u = torch.meshgrid(torch.arange(360) + 0.5, torch.arange(480) + 0.5, indexing="ij")
    return torch.exp(-((u - at_px[0]) ** 2 + (v - at_px[1]) ** 2) / 18)[None, None].expand(1, 3, -1, -1)


def _centroid(image):
    weight = image[0, 0]
    v, u = torch.meshgrid(torch.arange(360) + 0.5, torch.arange(480) + 0.5, indexing="ij")
    return [float((weight * u).sum() / weight.sum()), float((weight * v).sum() / weight.sum())]


@pytest.mark.parametrize("variant", ["full", "top_view"])
def test_the_warp_is_in_float32_in_every_precision(variant, monkeypatch):
    """Rounded to bfloat16, a place at column 400 would be off by a pixel or two."""
    model, grids = LaneNet(train_config("tiny", ablation=variant).model).eval(), []
    sampled = projection.functional.grid_sample
    monkeypatch.setattr(
        projection.functional, "grid_sample", lambda x, grid, **how: grids.append(grid) or sampled(x, grid, **how)
    )
    image, intrinsics = torch.rand(1, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]])
    for enabled in (False, True):
        with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            model(image, intrinsics, model.fixed_pose[None])
    exact, mixed = grids[: len(grids) // 2], grids[len(grids) // 2 :]
    assert exact
    assert all(one.equal(other) for one, other in zip(exact, mixed, strict=True))
