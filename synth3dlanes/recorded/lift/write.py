"""Lift a drive into a data set: its images with their measured 3D lanes, as samples of clips."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from synth3dlanes import __version__
from synth3dlanes.dataset.description import names_of, recipe_text
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.format import LABELS, decode_image, encode_image, must_be_turned
from synth3dlanes.dataset.write import Shard
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.production.plan import SHARD_SIZE
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.run import AROUND, LiftedFrame, lifted_frames
from synth3dlanes.scene.assets.catalogue import KINDS
from synth3dlanes.scene.host import MAX_FRAMES
from synth3dlanes.system.errors import FormatError, InputError

# The picture of a frame without an image.
BLANK = 128
REPORTED_WITHIN_M = 40.0
FORMATS = {b"\xff\xd8\xff": "jpg", b"\x89PNG\r\n\x1a\n": "png"}


@dataclass(frozen=True)
class LiftReport:
    """What a lifted data set holds: its frames, those without any lane, its lanes (each once, however many frames show
    it), the median standard deviations of their visible points up to 40 m across and in height (None without), and the
    ids of rejected lanes that were found nowhere."""

    frames: int
    frames_without_lanes: int
    lanes: int
    lateral_std_m: float | None
    height_std_m: float | None
    not_found: tuple[str, ...] = ()


def lift_to(
    drive: Drive,
    out: str | Path,
    split: str = "train",
    precision: Precision | None = None,
    around: int = AROUND,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LiftReport:
    """Write a drive's frames with their lifted lanes as a split of a data set, in a folder or in a store at a URL.

    `progress` is called with (frames done, all frames). Frames that are already there are kept. Raises InputError as
    `lifted_frames` does, and for an `out` that holds something else; FormatError for files of the drive; OutageError
    for a store that does not answer, whose finished samples the next run on this machine puts.
    """
    frames = drive.kept()
    n = len(frames)
    if not n:
        raise InputError(f"{drive.name}: expected frames, got none")
    precision = precision or Precision()
    shots = _shots(frames)
    image_format = "jpg" if frames[0].load_image is None else _kind(frames[0].load_image()) or "jpg"
    recipe = _recipe(drive, image_format, shots, precision, around)
    numbers = range(-(-n // SHARD_SIZE))
    any_shard = Shard(Path(split), 0, SHARD_SIZE, names_of(recipe), recipe_text(recipe), frames=shots.frames)
    tally = _Tally({lane.id for lane in drive.rejected})
    destination = Destination(out)
    with destination.claim(recipe, split, n, numbers):
        lifted_of = enumerate(lifted_frames(drive, precision, around))
        for number, frames_of in groupby(lifted_of, lambda numbered: numbered[0] // SHARD_SIZE):
            with destination.working_copy(replace(any_shard, number=number)) as shard:
                missing = set(shard.missing(n))
                for index, lifted in frames_of:
                    if index in missing:
                        shard.write_part(
                            index,
                            {
                                image_format: _image(lifted.frame, drive.camera, image_format),
                                LABELS: labels_format.to_json(lifted.labels).encode(),
                            },
                        )
                    tally.add(lifted)
                    progress(index + 1, n)
                _finish(shard, n)
    return tally.report()


def _finish(shard: Shard, n: int) -> None:
    """Join a shard's samples. Raises FormatError where some cannot be read again: joining leaves them out."""
    if shard.needs_join(n):
        shard.join(n)
    lost = shard.missing(n)
    if lost:
        told = f"{len(lost)} that cannot be read again, the first of them frame {lost[0]}"
        raise FormatError(f"{shard.path('tar')}: expected samples that can be read, got {told}")


def _image(frame: DriveFrame, camera: DriveCamera, image_format: str) -> bytes:
    """The frame's image as it is, if it is of the format, whole, and not to be turned (EXIF), which few readers of a
    data set do; without one, a gray picture."""
    size_px = camera.width_px, camera.height_px
    if frame.load_image is None:
        return encode_image(np.full((size_px[1], size_px[0], 3), BLANK, np.uint8), image_format)
    data = frame.load_image()
    pixels = decode_image(data, str(frame.image or frame.name), size_px, is_turned=True)
    is_as_it_is = _kind(data) == image_format and not must_be_turned(data)
    return data if is_as_it_is else encode_image(pixels, image_format)


def _kind(data: bytes) -> str:
    return next((kind for start, kind in FORMATS.items() if data.startswith(start)), "")


def _shots(frames: Sequence[DriveFrame]) -> Shots:
    """Clips of at most 1,000 frames: the drive as one clip, or as several of equal length and a shorter last one."""
    n = len(frames)
    if n == 1:
        return SINGLE
    steps_s = np.diff([frames[i].time_s for i in range(min(n, MAX_FRAMES))])
    clips = -(-n // MAX_FRAMES)
    return Shots(frames=-(-n // clips), fps=float(np.clip(1 / max(float(np.median(steps_s)), 1e-3), 1e-3, 1000.0)))


def _recipe(drive: Drive, image_format: str, shots: Shots, precision: Precision, around: int) -> dict[str, Any]:
    """What `dataset.json` says of how the labels were made."""
    return {
        "generator": __version__,
        "seed": 0,
        "image_format": image_format,
        "render": {"samples": 1, "passes": [], "device": "cpu"},
        "params": {},
        "assets": {kind: {} for kind in KINDS},
        **({} if shots == SINGLE else {"shots": shots.model_dump(mode="json")}),
        "shard_size": SHARD_SIZE,
        "derived": {
            "lifted": drive.name,
            "origin_m": list(drive.origin_m),
            "inputs": _digest(drive),
            "around": around,
            "precision": asdict(precision),
        },
    }


def _digest(drive: Drive) -> str:
    """A digest of a drive's inputs except its scans and images."""
    camera, found = drive.camera, hashlib.sha256()
    marked = [(lane.id, lane.kind, lane.marking, lane.color, lane.direction) for lane in drive.marked]
    found.update(repr((camera.lens, marked)).encode())
    arrays = [camera.img_from_cam, camera.host_from_cam, drive.host_from_lidar]
    arrays += [lane.xy_world for lane in drive.marked] + [lane.xy_world for lane in drive.rejected]
    for frame in drive.kept():
        found.update(repr((frame.name, frame.time_s, len(frame.lanes_px))).encode())
        arrays += [frame.world_from_host, *frame.lanes_px]
        while arrays:
            found.update(np.ascontiguousarray(arrays.pop(), np.float64).tobytes())
    return found.hexdigest()[:16]


class _Tally:
    """Counts what was lifted."""

    def __init__(self, rejected: set[str]) -> None:
        self.not_found = rejected
        self.frames = self.without = 0
        self.ids: set[str] = set()
        self.std: list[np.ndarray] = []

    def add(self, lifted: LiftedFrame) -> None:
        self.not_found -= lifted.rejected
        self.frames += 1
        self.without += not lifted.labels.lanes
        for lane in lifted.labels.lanes:
            self.ids.add(lane.id.partition(".")[0])
            if lane.std_m is not None:
                near = lane.std_m[lane.visible & (lane.xyz_cam[:, 1] < REPORTED_WITHIN_M)]
                if len(near):
                    self.std.append(np.median(near, axis=0))

    def report(self) -> LiftReport:
        lateral, height = np.median(self.std, axis=0).tolist() if self.std else (None, None)
        return LiftReport(self.frames, self.without, len(self.ids), lateral, height, tuple(sorted(self.not_found)))
