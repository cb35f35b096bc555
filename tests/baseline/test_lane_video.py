"""Videos and clips: lanes of every frame with its time, videos with them drawn, and smoothing over time."""

import dataclasses
import json
from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image
from synth3dlanes_baseline import sources
from synth3dlanes_baseline.checkpoint import SHIPPED, detector
from synth3dlanes_baseline.curves import Pose
from synth3dlanes_baseline.data import CameraImage, intrinsics_of
from synth3dlanes_baseline.lanes import Detection, Prediction, read_predictions
from synth3dlanes_baseline.predict import PredictConfig, predict
from synth3dlanes_baseline.smoothing import associate, smoothed

from synth3dlanes.figures.colors import KINDS
from synth3dlanes.geometry.frames import project, transform
from synth3dlanes.imaging.video import mp4, open_video
from synth3dlanes.system.errors import FormatError, InputError, Synth3dlanesError
from tests.baseline import roads

RATE_HZ = 10.0


@pytest.fixture(scope="module")
def network():
    return detector(SHIPPED, torch.device("cpu"))


@pytest.fixture(scope="module")
def drawn():
    return roads.samples(np.random.default_rng(4), 5, (320, 240))


@pytest.fixture
def video(drawn, tmp_path):
    """Five drawn pictures as a video."""
    stream = BytesIO()
    with mp4("a.mp4", stream, RATE_HZ) as out:
        for sample in drawn:
            out.add(sample.image)
    (tmp_path / "drive.mp4").write_bytes(stream.getvalue())
    return tmp_path / "drive.mp4"


def test_a_video_gives_the_lanes_of_its_frames_and_a_video_with_them(network, drawn, video, tmp_path):
    camera = intrinsics_of(drawn[0].labels)
    (tmp_path / "frames").mkdir()
    with open_video(video) as read:
        frames = list(read.frames)
    for number, frame in enumerate(frames):
        Image.fromarray(frame).save(tmp_path / f"frames/{number:08d}.png")
    of_video = predict(network, video, tmp_path / "a", PredictConfig(camera, threshold=0.2))
    of_files = predict(network, tmp_path / "frames", tmp_path / "b", PredictConfig(camera, n_overlays=0))
    assert of_video.n_images == of_files.n_images == 5
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["drive.lanes.mp4", "predictions.jsonl"]
    with open_video(tmp_path / "a/drive.lanes.mp4") as read:
        assert read.rate_hz == RATE_HZ
        shown = list(read.frames)
    assert len(shown) == 5
    pairs = list(zip(read_predictions(of_video.path), read_predictions(of_files.path), strict=True))
    is_drawn = []
    for number, ((mine, its), sample) in enumerate(zip(pairs, drawn, strict=True)):
        assert (mine.key, mine.time_s) == (f"{number:08d}", number / RATE_HZ)
        assert (its.key, its.time_s) == (f"{number:08d}.png", None)
        assert [lane.score for lane in mine.lanes] == pytest.approx([lane.score for lane in its.lanes], abs=1e-5)
        for lane, other in zip(mine.lanes, its.lanes, strict=True):
            assert lane.xyz_cam == pytest.approx(other.xyz_cam, abs=2e-3)
        for lane in mine.lanes:
            u, v = np.floor(project(sample.labels.camera.img_from_cam, lane.xyz_cam[12])).astype(int)
            if lane.score >= 0.2 and lane.visibility[12] > 0.5 and 5 < u < 315 and 5 < v < 235:
                window = np.s_[v - 3 : v + 4, u - 3 : u + 4]
                with_lane, without = (
                    np.abs(picture[window].astype(int) - KINDS[lane.kind]).sum(-1).min()
                    for picture in (shown[number], frames[number])
                )
                is_drawn.append(with_lane < 0.75 * without)
    assert len(is_drawn) > 10
    assert np.mean(is_drawn) > 0.8, "but for lanes under those of the other kind"


@pytest.fixture
def clips(drawn, monkeypatch):
    """The drawn pictures as two clips of three and two frames behind the name DIR/test."""
    times_s = [0.0, 0.1, 0.2, 0.0, 0.1]
    samples = [
        dataclasses.replace(sample, labels=dataclasses.replace(sample.labels, time_s=time_s))
        for sample, time_s in zip(drawn, times_s, strict=True)
    ]
    monkeypatch.setattr(sources, "open_split", lambda _: samples)
    monkeypatch.setattr(sources, "clip_rate_hz", lambda _: RATE_HZ)
    return times_s


def test_clips_of_a_split_become_videos_and_can_be_smoothed(network, clips, tmp_path):
    plain = predict(network, "DIR/test", tmp_path / "a", PredictConfig(has_videos=True))
    names = ["00000000.lanes.mp4", "00000003.lanes.mp4", "predictions.jsonl"]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == names
    with open_video(tmp_path / "a/00000000.lanes.mp4") as read:
        assert len(list(read.frames)) == 3
    assert [json.loads(line)["time_s"] for line in plain.path.read_text().splitlines()] == clips
    one = PredictConfig(has_videos=True, n_overlays=1, smooth_s=0.1)
    smooth = predict(network, "DIR/test", tmp_path / "b", one)
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == [names[0], names[2]]
    lines = [path.read_text().splitlines() for path in (plain.path, smooth.path)]
    assert [a == b for a, b in zip(*lines, strict=True)] == [True, False, False, True, False]


@pytest.mark.parametrize("config", [PredictConfig(smooth_s=0.1), PredictConfig(has_videos=True)])
def test_single_pictures_are_neither_smoothed_nor_a_video(network, tmp_path, config):
    Image.new("RGB", (64, 48)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="expected a video or a split of clips by one camera, got single pictures"):
        predict(network, tmp_path / "a.png", tmp_path / "out", config)
    assert not (tmp_path / "out").exists()


def test_a_bad_video_is_told_in_one_line_and_leaves_nothing(network, video, tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    whole = video.read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    for name, problem in (("none.mp4", "cannot be read"), ("text.mp4", "expected a video"), ("cut.mp4", "expected")):
        with pytest.raises((InputError, FormatError), match=problem) as raised:
            predict(network, tmp_path / name, tmp_path / "out")
        assert len(str(raised.value).splitlines()) == 1
        assert not (tmp_path / "out").exists()


def test_a_video_that_breaks_off_leaves_no_file(network, video, tmp_path, monkeypatch):
    from synth3dlanes_baseline import overlay

    def broken(*_):
        raise Synth3dlanesError("the third frame")

    draw, n_drawn = overlay.draw, []

    def draw_two(*arguments):
        n_drawn.append(1)
        return draw(*arguments) if len(n_drawn) < 3 else broken()

    monkeypatch.setattr(overlay, "draw", draw_two)
    with pytest.raises(Synth3dlanesError, match="the third frame"):
        predict(network, video, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


Y_M = np.arange(1.0, 90.0)
BLACK = np.zeros((2, 2, 3), dtype=np.uint8)


def lane(x_m=0.0, kind="delimiter", score=0.9):
    return Detection(kind, score, np.stack([x_m + 0 * Y_M, Y_M, 0 * Y_M - 1.5], axis=1))


def frame(time_s, lanes, truth=()):
    return CameraImage("0", BLACK, (1, 1, 1, 1), truth, time_s), Prediction("0", tuple(lanes), Pose(0.0, 1.5 + time_s))


def test_noise_shrinks_as_the_theory_of_exponential_means_says():
    noise_m = np.random.default_rng(0).normal(scale=0.1, size=2000)
    found = [frame(0.1 * i, [lane(x_m)]) for i, x_m in enumerate(noise_m)]
    x_m = [prediction.lanes[0].xyz_cam[10, 0] for _, prediction in smoothed(found, 0.2)]
    share = 1 - np.exp(-0.5)
    assert np.std(x_m[50:]) == pytest.approx(0.1 * np.sqrt(share / (2 - share)), rel=0.1)


def test_known_motion_is_made_up_for():
    """A host that turns and drives past straight lanes: with its motion, their means are themselves."""
    label = roads.labels([lambda y: (0 * y, 0 * y)])
    in_world = lane(1.0).xyz_cam
    known, unknown = [], []
    for i in range(6):
        c, s = np.cos(0.02 * i), np.sin(0.02 * i)
        world_from_cam = np.array([[c, -s, 0, 0.3 * i], [s, c, 0, 2.0 * i], [0, 0, 1, 0], [0, 0, 0, 1]])
        camera = dataclasses.replace(label.camera, world_from_cam=world_from_cam)
        seen = Detection("delimiter", 0.9, transform(np.linalg.inv(world_from_cam), in_world))
        known.append(frame(0.1 * i, [seen], dataclasses.replace(label, camera=camera)))
        unknown.append(frame(0.1 * i, [seen]))
    apart_m = [
        max(
            np.abs(smooth.lanes[0].xyz_cam - single.lanes[0].xyz_cam).max()
            for (_, single), (_, smooth) in zip(found, smoothed(found, 0.3), strict=True)
        )
        for found in (known, unknown)
    ]
    assert apart_m[0] < 1e-9
    assert apart_m[1] > 0.5


def test_lanes_are_associated_by_kind_within_the_gate_nearest_first():
    before = [lane(0.0), lane(0.8), lane(5.0), lane(9.0, "centerline")]
    now = [lane(0.6), lane(6.2), lane(9.0), lane(8.7, "centerline"), lane(0.5)]
    assert associate(before, now) == {0: 1, 3: 3, 4: 0}
    assert associate([], now) == associate(before, []) == {}


def test_scores_and_lanes_that_come_stay_and_a_new_clip_begins_anew():
    found = [frame(0.0, [lane(0.0)]), frame(0.1, [lane(0.4, score=0.2), lane(4.0)]), frame(0.0, [lane(0.4)])]
    first, second, third = (prediction for _, prediction in smoothed(found, 0.1))
    share = 1 - np.exp(-1)
    assert [one.score for one in second.lanes] == [0.2, 0.9]
    assert [one.xyz_cam[5, 0] for one in second.lanes] == pytest.approx([0.4 * share, 4.0])
    assert second.pose == pytest.approx((0.0, 1.5 + 0.1 * share))
    assert first.lanes[0].xyz_cam[5, 0] == 0.0
    assert third.lanes[0].xyz_cam[5, 0] == 0.4


@pytest.mark.parametrize(("times_s", "problem"), [([None], "expected frames of a clip"), ([1.0, 1.0], "one camera")])
def test_pictures_and_rigs_are_refused(times_s, problem):
    image, prediction = frame(0.0, [lane()])
    found = [(dataclasses.replace(image, time_s=time_s), prediction) for time_s in times_s]
    with pytest.raises(InputError, match=problem):
        list(smoothed(found, 0.1))
