"""Videos: the frames of a file, one after the other; frames to an MP4 file. PyAV does the work, the extra `video`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError, how_to_install
from synth3dlanes.system.files import open_regular

if TYPE_CHECKING:
    import av

# Files of one video each. Others of FFmpeg's formats are lists of further files and addresses, which it would open.
FORMATS = "mov,matroska,avi,mpegts,mpeg,flv,ogg,gif,mjpeg,h264,hevc,ivf"
# As for pictures: 8192 x 8192.
MOST_PIXELS = 1 << 26
LEAST_RATE_HZ, MOST_RATE_HZ = 0.01, 1000.0
RATES = f"{LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz"
# x264's constant rate factor: 0 is lossless in YUV, 18 looks like the original, 51 is the worst.
CRF = 18
# The denominators of frame rates that are in use, as 30000/1001.
DENOMINATOR = 1001
BT709, LIMITED_RANGE = 1, 1
# Flags of FFmpeg's scaler: bilinear, rounded exactly, the same on every processor, chroma at full width. Its defaults
# make colours darker by up to 3 of 255.
EXACT = 0x2 | 0x40000 | 0x80000 | 0x2000 | 0x4000


@dataclass(frozen=True)
class Video:
    """An open video: its frame rate, and its frames in order, each read when it is asked for."""

    rate_hz: float
    frames: Iterator[RgbImage]


@contextmanager
def open_video(path: Path) -> Iterator[Video]:
    """The first video of a file, turned as the file says, by quarter turns.

    Raises FormatError, here or at the frame, for a file that is no video, that is cut or damaged, or whose frames
    change in size or have more than MOST_PIXELS; OSError like `open`; MissingPackageError without PyAV.
    """
    av = _pyav()
    with open_regular(path) as stream:
        try:
            container = av.open(stream, container_options={"format_whitelist": FORMATS})
        except av.FFmpegError as error:
            raise FormatError(f"{path}: expected a video, got {_reason(error)}") from None
        with container:
            rate_hz = _prepared(path, container, os.fstat(stream.fileno()).st_size)
            yield Video(rate_hz, _frames(path, container))


@dataclass(frozen=True)
class Mp4:
    """An MP4 file that is being written, frame by frame."""

    name: str
    _container: "av.container.OutputContainer"
    _stream: "av.VideoStream"

    def add(self, frame: RgbImage) -> None:
        """Append a frame. All must have the size of the first; an odd width or height is made even by a copy of the
        last column or row, so that no pixel moves. Raises InputError for another size."""
        height, width = frame.shape[:2]
        if height * width > MOST_PIXELS:
            raise InputError(f"{self.name}: expected frames of at most {MOST_PIXELS:,} pixels, got {width} x {height}")
        even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        size_px = even.shape[1], even.shape[0]
        if not self._stream.codec_context.is_open:
            self._stream.width, self._stream.height = size_px
        elif size_px != (self._stream.width, self._stream.height):
            expected = f"{self._stream.width} x {self._stream.height}"
            raise InputError(f"{self.name}: expected frames of {expected} pixels, got {width} x {height}")
        picture = _pyav().VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        picture = picture.reformat(
            format="yuv420p", dst_colorspace=BT709, dst_color_range=LIMITED_RANGE, interpolation=EXACT
        )
        self._container.mux(self._stream.encode(picture))


@contextmanager
def mp4(name: str, stream: BinaryIO | BytesIO, rate_hz: float, crf: int = CRF) -> Iterator[Mp4]:
    """An MP4 file (H.264, 4:2:0, BT.709) in a stream that `files.py` opened; `name` is for messages. Equal frames give
    equal bytes with one version of PyAV. Raises InputError for an impossible rate and for no frame at all.
    """
    av = _pyav()
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise InputError(f"{name}: expected a frame rate of {RATES}, got {rate_hz:g} Hz")
    rate = Fraction(rate_hz).limit_denominator(DENOMINATOR)
    with av.open(stream, "w", format="mp4", container_options={"fflags": "+bitexact"}) as container:
        # Threads and the kind of processor would change the bytes.
        exact = "threads=1:lookahead-threads=1:cpu-independent=1"
        out = container.add_stream("libx264", rate=rate, options={"crf": str(crf), "x264-params": exact})
        out.pix_fmt, out.thread_count = "yuv420p", 1
        out.codec_context.flags |= av.codec.context.Flags.bitexact
        out.colorspace = out.color_primaries = out.color_trc = BT709
        out.color_range = LIMITED_RANGE
        yield Mp4(name, container, out)
        if not out.codec_context.is_open:
            raise InputError(f"{name}: expected at least one frame, got none")
        container.mux(out.encode())


def _prepared(path: Path, container: "av.container.InputContainer", n_bytes: int) -> float:
    """The frame rate of the first video, whose frames can then be decoded."""
    if not container.streams.video:
        raise FormatError(f"{path}: expected a video, got a file without one")
    stream = container.streams.video[0]
    if stream.codec_context is None:
        raise FormatError(f"{path}: expected a video of a known codec, got an unknown one")
    width, height = stream.width, stream.height
    if not 0 < width * height <= MOST_PIXELS:
        raise FormatError(f"{path}: expected frames of at most {MOST_PIXELS:,} pixels, got {width} x {height}")
    stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    rate_hz = float(stream.average_rate or stream.guessed_rate or 0)
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise FormatError(f"{path}: expected a frame rate of {RATES}, got {rate_hz:g} Hz")
    end = max((entry.pos + entry.size for entry in stream.index_entries), default=0)
    if end > n_bytes:
        raise FormatError(f"{path}: expected at least {end:,} bytes, got {n_bytes:,}: the file is cut")
    return rate_hz


def _frames(path: Path, container: "av.container.InputContainer") -> Iterator[RgbImage]:
    av, n = _pyav(), 0
    size_px: tuple[int, int] | None = None
    try:
        for frame in container.decode(video=0):
            if frame.is_corrupt:
                raise FormatError(f"{path}: frame {n}: expected a whole frame, got a damaged one")
            if size_px not in (None, (frame.width, frame.height)):
                raise FormatError(f"{path}: frame {n}: expected the size of frame 0, {size_px}, got another")
            size_px, n = (frame.width, frame.height), n + 1
            yield np.rot90(frame.to_ndarray(format="rgb24", interpolation=EXACT), round(frame.rotation / 90))
    except av.FFmpegError as error:
        raise FormatError(f"{path}: frame {n}: expected a frame, got {_reason(error)}") from None
    if n == 0:
        raise FormatError(f"{path}: expected a video, got one without frames")


def _reason(error: "av.FFmpegError") -> str:
    return f"something else ({(error.strerror or 'no reason given').lower()})"


def _pyav() -> ModuleType:
    try:
        import av
    except ModuleNotFoundError:
        raise MissingPackageError(f"PyAV is not installed: {how_to_install('video')}") from None
    return av
