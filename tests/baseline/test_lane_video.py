"""Videos and clips: lanes of every frame with its time, videos with them drawn, and nothing half-written."""

import dataclasses
import json
from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image
from synth3dlanes_baseline import sources
from synth3dlanes_baseline.checkpoint import SHIPPED, detector
from synth3dlanes_baseline.data import intrinsics_of
from synth3dlanes_baseline.lanes import read_predictions
from synth3dlanes_baseline.predict import PredictConfig, predict

from synth3dlanes.figures.colors import KINDS
from synth3dlanes.geometry.frames import project
from synth3dlanes.imaging.video import mp4, open_video
from synth3dlanes.system.errors import FormatError, InputError, Synth3dlanesError

RATE_HZ = 10.0


@pytest.fixture(scope="module")
def network():
    return detector(SHIPPED, torch.device("cpu"))


@pytest.fixture(scope="module")
def drawn(roads):
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
