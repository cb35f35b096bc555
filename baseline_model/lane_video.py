"""Videos with the lanes drawn, one for each clip, frame by frame."""

import math
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from PIL import Image

from synth3dlanes.imaging.video import Mp4, mp4
from synth3dlanes.system.files import Folder

from .data import CameraImage, img_from_cam
from .lanes import Prediction
from .overlay import draw


class LaneVideos:
    """Writes OUT/NAME.lanes.mp4 for each of the first `most` clips whose frames are added. As a context manager, it
    leaves whole videos only."""

    def __init__(self, out: Path, rate_hz: float, most: int) -> None:
        self._out, self._rate_hz, self._left = out, rate_hz, most
        self._files, self._time_s = ExitStack(), math.inf
        self._video: Mp4 | None = None

    def __enter__(self) -> "LaneVideos":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._files.__exit__(kind, error, traceback)

    def add(self, name: str, image: CameraImage, prediction: Prediction, threshold: float) -> None:
        """Append a frame with the lanes of at least this confidence. One that is not later than the frame before begins
        the next video, of this name."""
        time_s = image.time_s or 0.0
        if time_s <= self._time_s:
            self._files.close()
            self._left -= 1
            self._video = self._opened(f"{name}.lanes.mp4") if self._left >= 0 else None
        self._time_s = time_s
        if self._video is not None:
            frame = Image.fromarray(image.image)
            draw(frame, img_from_cam(image.intrinsics), prediction, image.truth, threshold)
            self._video.add(np.asarray(frame))

    def _opened(self, name: str) -> Mp4:
        stream = self._files.enter_context(Folder(self._out).replacing(name))
        return self._files.enter_context(mp4(str(self._out / name), stream, self._rate_hz))
