"""Photographs: how a network sees those of other cameras, and scores by labels in the image."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw
from synth3dlanes_baseline import checkpoint as checkpoints
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.data import CameraImage, FocalLengths, fit, intrinsics_of, resize
from synth3dlanes_baseline.lanes import Detection, Prediction, write_predictions
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.photographs import evaluate_predictions, open_photographs, read_intrinsics
from synth3dlanes_baseline.sources import focal_lengths
from synth3dlanes_baseline.tusimple import columns_of

from synth3dlanes.system.errors import FormatError, InputError
from tests.baseline import roads

SIZE_PX = (360, 480)
ONE_CAMERA = FocalLengths(415.7, 415.7, 1.0)
KITTI = (721.5377, 721.5377, 609.5593, 172.854)
POINTS_CAM = np.array([[-1.8, 20.0, -1.6], [1.8, 20.0, -1.6], [0.0, 40.0, -1.0], [3.0, 30.0, 0.5]])


def pixels_of(intrinsics, points_cam):
    fx, fy, cx, cy = intrinsics
    right, ahead, up = points_cam.T
    return np.stack([cx + fx * right / ahead, cy - fy * up / ahead], axis=1)


@pytest.mark.parametrize(
    ("size_px", "intrinsics", "trained"),
    [
        ((720, 1280), (2030.0, 2030.0, 640.0, 360.0), ONE_CAMERA),  # narrower: extended
        ((375, 1242), KITTI, ONE_CAMERA),  # wider and flatter: cropped at its sides, extended above and below
        ((720, 1280), (600.0, 600.0, 660.0, 330.0), ONE_CAMERA),  # wider: cropped
        ((720, 1280), (2030.0, 2030.0, 640.0, 360.0), FocalLengths(313.0, 579.0, 1.0)),
        ((375, 1242), KITTI, FocalLengths(680.0, 830.0, 4 / 3)),  # trained on 16:9
    ],
)
def test_a_photograph_is_seen_with_a_focal_length_of_training_and_its_points_stay_at_their_rays(
    size_px, intrinsics, trained
):
    picture = Image.new("L", size_px[::-1], 0)
    draw = ImageDraw.Draw(picture)
    radius = 0.012 * intrinsics[0]
    for u, v in pixels_of(intrinsics, POINTS_CAM):
        draw.ellipse((u - radius, v - radius, u + radius, v + radius), fill=255)
    image, (fx, fy, cx, cy) = fit(np.stack([np.asarray(picture)] * 3, axis=2), intrinsics, SIZE_PX, trained)
    assert image.shape == (*SIZE_PX, 3)
    assert trained.least_px * 0.99 < fx < trained.most_px * 1.01
    assert fy / fx == pytest.approx(trained.fy_by_fx, rel=0.01)
    plain_px = intrinsics[0] * SIZE_PX[1] / size_px[1]
    nearest_px = np.clip(plain_px, trained.least_px, trained.most_px)
    assert fx == pytest.approx(nearest_px, rel=0.01)
    rows, columns = np.indices(SIZE_PX) + 0.5
    for u, v in pixels_of((fx, fy, cx, cy), POINTS_CAM):
        near = (np.abs(columns - u) < 2 * 0.012 * fx) & (np.abs(rows - v) < 2 * 0.012 * fy)
        weight = image[..., 0] * near
        assert weight.sum() > 255, "the point is in the picture"
        assert (weight * columns).sum() / weight.sum() == pytest.approx(u, abs=0.7)
        assert (weight * rows).sum() / weight.sum() == pytest.approx(v, abs=0.7)


def test_outside_of_a_photograph_its_border_goes_on():
    columns = np.broadcast_to(np.linspace(10, 240, 1280).astype(np.uint8)[None, :, None], (720, 1280, 3))
    image, (fx, _, cx, _) = fit(columns, (2030.0, 2030.0, 640.0, 360.0), SIZE_PX, ONE_CAMERA)
    left_px, right_px = cx - 640 * fx / 2030, cx + 640 * fx / 2030
    assert (image == image[:1]).all()
    assert (image[0, : int(left_px)] == image[0, int(left_px)]).all()
    assert (image[0, int(right_px) + 1 :] == image[0, int(right_px)]).all()
    assert image[0, 0, 0] < 15
    assert image[0, -1, 0] > 235


@pytest.mark.parametrize("trained", [None, FocalLengths(313.0, 579.0, 1.0), FocalLengths(400.0, 403.0, 1.0)])
def test_pictures_like_those_of_training_are_only_resized(trained):
    """403 px and 415.7 px count as equal."""
    image = np.random.default_rng(0).integers(0, 255, (720, 960, 3), dtype=np.uint8)
    found, intrinsics = fit(image, (831.4, 831.4, 470.0, 370.0), SIZE_PX, trained)
    np.testing.assert_array_equal(found, resize(image, SIZE_PX))
    assert intrinsics == pytest.approx((415.7, 415.7, 235.0, 185.0))
    for cx in (0.0, 960.0):
        with pytest.raises(InputError, match=f"edge of an image of 960x720 px, got {cx:g}: are they those of another"):
            fit(image, (831.4, 831.4, cx, 370.0), SIZE_PX, trained)


def test_the_least_focal_lengths_are_those_that_are_taken():
    tall = np.zeros((900, 3, 3), dtype=np.uint8)
    with pytest.raises(InputError, match=r"of at least [\d.]+, [\d.]+ px for an image of 3x900 px") as told:
        fit(tall, (2.6, 2.6, 1.5, 450.0), SIZE_PX, ONE_CAMERA)
    least = float(str(told.value).split("at least ")[1].split(",")[0])
    assert least > 2.6
    fit(tall, (least * 1.001, least * 1.001, 1.5, 450.0), SIZE_PX, ONE_CAMERA)


def test_focal_lengths_of_training_are_measured_in_pixels_of_the_network():
    samples = roads.samples(np.random.default_rng(1), 3, (640, 360))
    # conftest: f = 415.7 px at a width of 480 px, so 554.3 px at 640x360, resized by 3/4 and 1.
    assert focal_lengths(samples, SIZE_PX) == pytest.approx((415.7, 415.7, 4 / 3))


@pytest.fixture
def kitti(tmp_path):
    """A straight lane 3.6 m wide on level ground 1.65 m below KITTI's camera; images, masks, and its lines."""
    images, masks = tmp_path / "images", tmp_path / "masks"
    images.mkdir()
    masks.mkdir()
    y_m = np.arange(2.0, 101.0)
    lines = [np.stack([x + 0 * y_m, y_m, -1.65 + 0 * y_m], axis=1) for x in (-5.4, -1.8, 1.8, 5.4)]
    mask = Image.new("RGB", (1242, 375), (255, 0, 0))
    left, right = (pixels_of(KITTI, line) for line in lines[1:3])
    polygon = [tuple(point - 0.5) for point in np.concatenate([left, right[::-1]])]
    ImageDraw.Draw(mask).polygon(polygon, fill=(255, 0, 255))
    mask.save(masks / "um_lane_000007.png")
    Image.new("RGB", (1242, 375), (90, 90, 90)).save(images / "um_000007.png")
    return images, masks, lines


def kitti_report(kitti, lines, shift_m=0.0):
    images, masks, _ = kitti
    lanes = tuple(Detection("delimiter", 0.9, line + np.array([shift_m, 0, 0])) for line in lines)
    write_predictions(images.parent / "p.jsonl", [Prediction("um_000007.png", lanes, None)])
    return evaluate_predictions(images.parent / "p.jsonl", open_photographs(images, masks), KITTI).figures


def test_the_area_between_the_lines_beside_the_host_is_scored_against_kittis_masks(kitti):
    _, masks, lines = kitti
    perfect = kitti_report(kitti, lines)
    assert min(perfect["precision"], perfect["recall"], perfect["IoU"]) > 0.985
    # Moved by a quarter of the lane, a quarter on one side is missing and as much on the other is wrong.
    moved = kitti_report(kitti, lines, shift_m=0.9)
    assert moved["precision"] == pytest.approx(0.75, abs=0.02)
    assert moved["recall"] == pytest.approx(0.75, abs=0.02)
    assert moved["IoU"] == pytest.approx(0.6, abs=0.02)
    wide = kitti_report(kitti, [lines[0], lines[2]])
    assert wide["precision"] == pytest.approx(0.5, abs=0.03)
    assert wide["recall"] > 0.985
    alone = kitti_report(kitti, lines[2:])
    assert (alone["recall"], alone["found"]) == (0.0, 0.0)
    assert np.isnan(alone["precision"])
    # What KITTI leaves out, black in the mask, counts neither way.
    pixels = np.array(Image.open(masks / "um_lane_000007.png"))
    pixels[(pixels[..., 2] == 0) & (np.arange(1242) < 621)] = 0
    Image.fromarray(pixels).save(masks / "um_lane_000007.png")
    assert kitti_report(kitti, [lines[0], lines[2]])["precision"] > 0.985


def test_a_mask_without_image_is_named(kitti):
    images, masks, _ = kitti
    (images / "um_000007.png").rename(images / "um_000008.png")
    with pytest.raises(FormatError, match=r"expected one image um_000007 for the mask um_lane_000007\.png, got 0"):
        open_photographs(images, masks)
    with pytest.raises(FormatError, match="expected masks of lanes"):
        open_photographs(images, images)


def test_a_calibration_file_of_kitti_gives_the_left_colour_camera(tmp_path):
    path = tmp_path / "um_000000.txt"
    rows = {"P0": 700.0, "P2": 721.5377, "P3": 722.0}
    path.write_text("".join(f"{name}: {f} 0 609.5593 44.8 0 {f} 172.854 0.2 0 0 1 0.003\n" for name, f in rows.items()))
    assert read_intrinsics(path) == KITTI
    path.write_text("P2: 1 2 3\n")
    with pytest.raises(FormatError, match="expected one line `P2:` of 12 numbers"):
        read_intrinsics(path)


def test_columns_end_where_the_lane_is_hidden_or_turns_back():
    matrix = np.array([[1000.0, 500.0, 0.0], [0.0, 300.0, -1000.0], [0.0, 1.0, 0.0]])
    y_m = np.arange(5.0, 51.0)
    level = np.stack([0 * y_m, y_m, -1.5 + 0 * y_m], axis=1)
    rows = np.arange(300.0, 600.0)

    def highest(lane):
        found = columns_of(lane, matrix, rows)
        assert np.unique(found[np.isfinite(found)]).tolist() == [500.0]
        return rows[np.isfinite(found)].min()

    assert highest(Detection("delimiter", 1.0, level)) == 330  # 1000 * 1.5 / 50 below the horizon
    seen = np.where(y_m <= 30, 0.9, 0.1)
    assert highest(Detection("delimiter", 1.0, level, seen)) == 350
    hole = np.where((y_m > 10) & (y_m < 20), 0.1, 0.9)
    assert highest(Detection("delimiter", 1.0, level, hole)) == 330
    # A crest at 25 m: what lies beyond it falls away faster than it recedes.
    crest = level - np.array([0, 0, 1.0]) * np.maximum(0, y_m - 25)[:, None] * 0.2
    assert highest(Detection("delimiter", 1.0, crest)) == 360


def test_the_four_delimiters_nearest_the_host_are_scored_on_tusimple(tmp_path):
    height_m, rows = 1.5, np.arange(400, 710, 10)
    camera = (1000.0, 1000.0, 640.0, 360.0)

    def scored(labelled, found):
        """Accuracy, FP and FN of straight lines so many metres right of the camera, each with a confidence."""
        columns = [np.rint(640 + x_m * (rows - 360) / height_m).astype(int) for x_m in labelled]
        lanes = [np.where((u_px >= 0) & (u_px < 1280), u_px, -2).tolist() for u_px in columns]
        frame = {"raw_file": "1.jpg", "lanes": lanes, "h_samples": rows.tolist()}
        (tmp_path / "labels.json").write_text(json.dumps(frame) + "\n")
        y_m = np.arange(3.0, 60.0, 0.5)
        lines = [
            Detection("delimiter", score, np.stack([x_m + 0 * y_m, y_m, -height_m + 0 * y_m], axis=1))
            for x_m, score in found.items()
        ]
        write_predictions(tmp_path / "p.jsonl", [Prediction("1.jpg", tuple(lines), None)])
        report = evaluate_predictions(tmp_path / "p.jsonl", open_photographs(tmp_path), camera)
        return tuple(report.figures.values())

    four = {-5.4: 0.6, -1.8: 0.6, 1.8: 0.6, 5.4: 0.6}
    assert scored(four, four) == (1.0, 0.0, 0.0)
    assert scored(four, {9.0: 0.99, **four}) == (1.0, 0.0, 0.0), "the fifth is farther from the host"
    accuracy, *rates = scored(four, {3.6: 0.55, **four})
    assert accuracy < 1.0
    assert rates == [0.25, 0.25], "a wrong line near the host takes the place of one beside its lane"
    assert scored(four, {x_m: 0.4 for x_m in four})[2] == 1.0, "below the threshold"
    assert scored([*four, 1.81], four) == (1.0, 0.0, 0.0), "one line finds two that lie together; FP is not negative"


def test_centre_lines_alone_are_refused_in_a_line(tmp_path):
    frame = {"raw_file": "1.jpg", "lanes": [[600, 610]], "h_samples": [400, 410]}
    (tmp_path / "labels.json").write_text(json.dumps(frame) + "\n")
    line = Detection("centerline", 0.9, np.array([[0.0, 5.0, -1.5], [0.0, 20.0, -1.5]]))
    write_predictions(tmp_path / "p.jsonl", [Prediction("1.jpg", (line,), None)])
    with pytest.raises(InputError, match="got centre lines only"):
        evaluate_predictions(tmp_path / "p.jsonl", open_photographs(tmp_path), KITTI)


def test_a_checkpoint_knows_the_focal_lengths_it_was_trained_on_and_every_image_is_seen_so(tmp_path):
    torch.manual_seed(0)
    config = train_config("tiny")
    about = {"train": {"n_images": 1, "focal_px": [60.0, 70.0, 1.0]}}
    checkpoints.save(tmp_path / "a.pt", checkpoints.Checkpoint(config, about, LaneNet(config.model).state_dict(), None))
    detector = checkpoints.detector(tmp_path / "a.pt", torch.device("cpu"))
    assert detector.trained == FocalLengths(60.0, 70.0, 1.0)
    (sample,) = roads.samples(np.random.default_rng(2), 1, (480, 360))  # f = 138.6 px at 160x120
    intrinsics = intrinsics_of(sample.labels)
    image, seen = fit(sample.image, intrinsics, detector.size_px, detector.trained)
    assert seen[0] == pytest.approx(70, rel=0.01)
    pixels = torch.from_numpy(image[None]).permute(0, 3, 1, 2)
    (expected,) = detector.in_batch([sample.key], pixels, torch.tensor([seen]))
    image = CameraImage(sample.key, sample.image, intrinsics)
    ((_, of_image),) = detector.in_images([image])
    ((_, of_sample),) = detector.in_samples([sample], workers=0)
    ((_, resized),) = replace(detector, trained=None).in_images([image])
    of_image, of_sample, resized, expected = (
        [lane.score for lane in prediction.lanes] for prediction in (of_image, of_sample, resized, expected)
    )
    assert of_image == of_sample == pytest.approx(expected, rel=1e-6)
    assert resized != pytest.approx(expected, rel=1e-3)
