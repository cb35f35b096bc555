"""Videos: what is written is read back in place and colour; bytes are equal; strange files end in one clear line."""

import sys
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.imaging import video
from synth3dlanes.imaging.video import mp4, open_video
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError
from synth3dlanes.system.files import replacing
from tests.hostile import damaged, files, refused_or_read

RED, GREEN, BLUE = (220, 30, 20), (40, 180, 60), (20, 40, 230)


def picture(step: int = 0, width: int = 96, height: int = 64) -> RgbImage:
    """Green, with a red patch at the top left that moves to the right, and a blue corner at the bottom right."""
    made = np.full((height, width, 3), GREEN, np.uint8)
    made[8:24, 8 + 2 * step : 40 + 2 * step] = RED
    made[32:, 64:] = BLUE
    return made


def written(frames: Iterable[RgbImage], rate_hz: float = 10.0) -> bytes:
    stream = BytesIO()
    with mp4("a.mp4", stream, rate_hz) as out:
        for frame in frames:
            out.add(frame)
    return stream.getvalue()


def read(path: Path) -> tuple[float, list[RgbImage]]:
    with open_video(path) as found:
        return found.rate_hz, list(found.frames)


@pytest.fixture(scope="module")
def small() -> bytes:
    return written(picture(step) for step in range(5))


@pytest.mark.parametrize("rate_hz", [10.0, 30000 / 1001, 2.5])
def test_frames_come_back_in_order_place_and_colour(tmp_path: Path, rate_hz: float) -> None:
    path = tmp_path / "a.mp4"
    with replacing(path) as stream, mp4(str(path), stream, rate_hz) as out:
        for step in range(6):
            out.add(picture(step))
    rate, frames = read(path)
    assert rate == rate_hz
    assert len(frames) == 6
    for step, frame in enumerate(frames):
        assert frame.dtype == np.uint8
        assert frame.shape == (64, 96, 3)
        for at, color in (((16, 16 + 2 * step), RED), ((50, 20), GREEN), ((50, 80), BLUE)):
            assert np.abs(frame[at].astype(int) - color).max() <= 4
        # The left edge of the patch, to a pixel.
        assert np.argmax(frame[16, :, 0] > 130) == pytest.approx(8 + 2 * step, abs=1)


def test_greys_keep_their_values(tmp_path: Path) -> None:
    """What depth is written in: 8 bits become 219 steps and back, and x264 adds little."""
    ramp = np.broadcast_to(np.repeat(np.arange(0, 256, 4), 8).astype(np.uint8)[None, :, None], (64, 512, 3))
    (tmp_path / "a.mp4").write_bytes(written([ramp]))
    assert np.abs(read(tmp_path / "a.mp4")[1][0].astype(int) - ramp).max() <= 3


def test_equal_frames_give_equal_bytes_without_dates(small: bytes) -> None:
    assert written(picture(step) for step in range(5)) == small
    with av.open(BytesIO(small)) as container:
        assert "creation_time" not in container.metadata
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")


def test_odd_sizes_get_a_column_and_a_row_more_and_nothing_moves(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(written([picture(width=95, height=63)]))
    (frame,) = read(tmp_path / "a.mp4")[1]
    assert frame.shape == (64, 96, 3)
    assert np.median(np.abs(frame[:63, :95].astype(int) - picture(width=95, height=63))) <= 2
    assert np.abs(frame[-1, -1].astype(int) - BLUE).max() <= 4


def test_a_turned_video_is_read_as_it_is_shown(tmp_path: Path, small: bytes) -> None:
    """The matrix of ISO 14496-12 that phones write: x' = -y, y' = x, a quarter turn clockwise."""
    straight = np.array([1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30], ">i4").tobytes()
    turned = np.array([0, 1 << 16, 0, -(1 << 16), 0, 0, 64 << 16, 0, 1 << 30], ">i4").tobytes()
    # The first matrix is the movie's, the second one the track's.
    at = small.index(straight, small.index(straight) + 1)
    (tmp_path / "a.mp4").write_bytes(small[:at] + turned + small[at + len(turned) :])
    frame = read(tmp_path / "a.mp4")[1][0]
    assert frame.shape == (96, 64, 3)
    # What was at the top left is at the top right.
    assert np.abs(frame[16, 64 - 16].astype(int) - RED).max() <= 4
    assert np.abs(frame[80, 14].astype(int) - BLUE).max() <= 4


def test_frames_are_read_when_they_are_asked_for(tmp_path: Path) -> None:
    """Damage in the last frames is met after the first ones."""
    rng = np.random.default_rng(0)
    data = written(rng.integers(0, 256, (64, 96, 3), dtype=np.uint8) for _ in range(40))
    end = data.index(b"moov") - 4
    at = end // 2
    (tmp_path / "a.mp4").write_bytes(data[:at] + b"\xff" * (end - at) + data[end:])
    read_before = []
    match = r"a\.mp4: frame \d+: expected a"
    with pytest.raises(FormatError, match=match), open_video(tmp_path / "a.mp4") as found:
        read_before.extend(found.frames)
    assert 5 < len(read_before) < 40


def sound_alone() -> bytes:
    """An MP4 file with a track of sound and none of pictures."""
    stream = BytesIO()
    with av.open(stream, "w", format="mp4") as container:
        out = container.add_stream("aac", rate=8000)
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        silence.sample_rate = 8000
        container.mux(out.encode(silence))
        container.mux(out.encode())
    return stream.getvalue()


def cut(data: bytes) -> bytes:
    """The index before the pictures, as on the web, and the second half of the pictures missing."""
    head, at = data.index(b"mdat") - 4, data.index(b"moov") - 4
    pictures, index = data[:at], data[at:]
    # Where the pictures begin: version and flags, the number of chunks, the first one's place.
    where = index.index(b"stco") + 12
    offset = int.from_bytes(index[where : where + 4], "big") + len(index)
    index = index[:where] + offset.to_bytes(4, "big") + index[where + 4 :]
    return pictures[:head] + index + pictures[head : (head + at) // 2]


def filled(data: bytes) -> bytes:
    at = data.index(b"mdat") + 4
    return data[:at] + b"\x55" * 600 + data[at + 600 :]


STRANGE = {
    "empty": (lambda small: b"", "expected a video, got something else"),
    "garbage": (lambda small: bytes(range(256)) * 40, "expected a video, got something else"),
    "a list of files": (lambda small: b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n", "expected a video, got something else"),
    "a script of files": (lambda small: b"ffconcat version 1.0\nfile a.mp4\n", "expected a video, got something else"),
    "no index": (lambda small: small[: len(small) // 2], "expected a video, got something else"),
    "sound alone": (lambda small: sound_alone(), "expected a video, got a file without one"),
    "cut pictures": (lambda small: cut(small), r"expected at least [\d,]+ bytes, got [\d,]+: the file is cut"),
    "damaged pictures": (lambda small: filled(small), "frame 0: expected a"),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_strange_files_end_in_one_clear_line(tmp_path: Path, small: bytes, kind: str) -> None:
    make, message = STRANGE[kind]
    path = tmp_path / "a.mp4"
    path.write_bytes(make(small))
    with pytest.raises(FormatError, match=message) as problem:
        read(path)
    assert str(problem.value).startswith(str(path))
    assert len(str(problem.value).splitlines()) == 1


def test_huge_frames_and_impossible_rates_are_refused(
    tmp_path: Path, small: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.mp4").write_bytes(small)
    monkeypatch.setattr(video, "MOST_PIXELS", 64 * 96 - 1)
    with pytest.raises(FormatError, match="expected frames of at most 6,143 pixels, got 96 x 64"):
        read(tmp_path / "a.mp4")
    with pytest.raises(InputError, match=r"^a\.mp4: expected frames of at most 6,143 pixels, got 96 x 64"):
        written([picture()])
    for rate_hz in (0.0, -1.0, 1e-9, 1e9, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"^a\.mp4: expected a frame rate of 0\.01 to 1000 Hz, got"):
            written([picture()], rate_hz)


def test_other_sizes_and_no_frames_are_refused() -> None:
    with pytest.raises(InputError, match=r"^a\.mp4: expected frames of 96 x 64 pixels, got 60 x 40"):
        written([picture(), picture()[:40, :60]])
    with pytest.raises(InputError, match=r"^a\.mp4: expected at least one frame, got none"):
        written([])


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="/dev/zero: expected a file, got a device"):
        read(Path("/dev/zero"))
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "missing.mp4")


def test_without_pyav_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingPackageError, match=r"pip install '\.\[video\]' in"):
        written([picture()])


@files
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path: Path, small: bytes, data: st.DataObject) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(data.draw(damaged(small)))
    refused_or_read(lambda: read(path), str(path))
