"""The contents of figures, by the user's name for them: a scene.json with its rendered image, a sample such as
`DIR/train:00000017`, or some samples of a data set."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.dataset.address import SAMPLE
from synth3dlanes.dataset.description import clip_of
from synth3dlanes.dataset.format import HEIGHT, LIDAR, PASSES, decode_image, read_passes, read_sweep
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.dataset.scenes import find_scene
from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Scene, from_json
from synth3dlanes.system.arrays import Passes, RgbImage
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import read_bounded
from synth3dlanes.truth.ground_truth import ground_truth


@dataclass(frozen=True, eq=False)
class ShownScene:
    """A scene with its name (for a sample, its key) and its labels; a sample that was lifted from a real drive has no
    scene. The rest is there if it exists: image, passes and lidar sweep; the frames of its clip, in which `shot` says
    the sample's place; and the views of all cameras of its rig at its instant."""

    scene: Scene | None
    labels: Labels
    image: RgbImage | None = None
    passes: Passes = field(default_factory=dict)
    sweep: Sweep | None = None
    clip: Sequence[tuple[Labels, RgbImage]] = ()
    rig: Sequence[tuple[Labels, RgbImage]] = ()
    name: str = "scene"
    lifted_shot: Shot | None = None

    @property
    def shot(self) -> Shot:
        """Which picture of its scene it is; of a lifted sample `lifted_shot`."""
        return self.scene.shot if self.scene is not None else self.lifted_shot or Shot()


@dataclass(frozen=True, eq=False)
class ShownSample:
    """A picture of a sample, its name, and the labels to be drawn on it, if any."""

    name: str
    image: RgbImage
    labels: Labels | None = None


# Passes of 8192 x 8192 take 1 GB without compression.
MAX_IMAGE_BYTES = 1 << 30


def load_shown(
    where: str, image_path: Path | None, *, with_passes: bool = False, with_clip: bool = False
) -> ShownScene:
    """Load what figures show of a sample `DIR/SPLIT:KEY` or of a scene file.

    The labels of a scene file are computed from the scene; `image_path` is its rendered image, and passes and sweep are
    read from the files beside it. Raises InputError if an image is given for a sample, or if passes are asked for and
    there are none.
    """
    if SAMPLE.fullmatch(where) is None:
        shown = _of_files(where, image_path, with_passes)
    elif image_path is not None:
        raise InputError(f"image {image_path}: expected none beside a sample, which has its own")
    else:
        shown = _of_sample(where, with_passes, with_clip)
    if with_passes and not shown.passes:
        raise InputError(f"passes: expected {where} to have passes, got none")
    return shown


def _of_sample(where: str, with_passes: bool, with_clip: bool) -> ShownScene:
    reader, i = find(where)
    sample = reader[i]
    scene = None if sample.scene_json is None else from_json(sample.scene_json, where)
    shot = _shot(reader, i) if scene is None else scene.shot
    return ShownScene(
        scene,
        sample.labels,
        sample.image,
        reader.passes(i) if with_passes else {},
        reader.lidar(i) if sample.labels.lidar is not None else None,
        clip=load_clip(where).frames if with_clip and shot.n_frames > 1 else (),
        rig=_pictures(reader, reader.rig(i)) if shot.n_cameras > 1 else (),
        name=sample.key,
        lifted_shot=shot if scene is None else None,
    )


def _of_files(where: str, image_path: Path | None, with_passes: bool) -> ShownScene:
    name, scene = find_scene(where)
    shown = ShownScene(scene, ground_truth(scene), name=name)
    if image_path is None:
        return shown
    size_px = scene.camera.width_px, scene.camera.height_px
    image = decode_image(read_bounded(image_path, MAX_IMAGE_BYTES), str(image_path), size_px)
    passes: dict[str, Shaped[np.ndarray, ...]] = {}
    for path in (image_path.with_suffix(f".{ending}") for ending in (PASSES, HEIGHT) if with_passes):
        passes |= read_passes(read_bounded(path, MAX_IMAGE_BYTES), str(path)) if path.exists() else {}
    path, lidar, sweep = image_path.with_suffix(f".{LIDAR}"), shown.labels.lidar, None
    if lidar is not None and path.exists():
        sweep = read_sweep(read_bounded(path, MAX_IMAGE_BYTES), str(path), lidar)
    return replace(shown, image=image, passes=passes, sweep=sweep)


def _shot(reader: Reader, i: int) -> Shot:
    """Which frame of its clip a sample without a scene is, by the index and the description of its data set."""
    n_frames, fps = clip_of(reader.description)
    return Shot(frame=int(reader.frame_of[i]), n_frames=n_frames, fps=fps)


def _pictures(reader: Reader, positions: Sequence[int]) -> list[tuple[Labels, RgbImage]]:
    return [(reader.labels(position), reader.image(position)) for position in positions]


@dataclass(frozen=True, eq=False)
class Clip:
    """The labels and the image of each frame, and the number of frames per second."""

    fps: float
    frames: list[tuple[Labels, RgbImage]]

    def pictures(self, with_lanes: bool) -> list[RgbImage]:
        """The images, with or without their lanes."""
        return [draw_overlay(image, labels) if with_lanes else image for labels, image in self.frames]


def load_clip(where: str) -> Clip:
    """The frames of the clip of a sample `DIR/SPLIT:KEY`, by the same camera. Raises InputError for a single
    picture."""
    reader, i = find(where)
    n_frames, fps = clip_of(reader.description)
    if n_frames == 1:
        raise InputError(f"{where}: expected a sample of a clip (generate --frames), got a single picture")
    return Clip(fps, _pictures(reader, reader.clip(int(reader.scene_of[i]), int(reader.camera_of[i]))))


def shown_samples(
    samples: Sequence[tuple[Reader, int]], show: str = "image", with_lanes: bool = True
) -> list[ShownSample]:
    """Some samples of a split with their keys and labels: their images, or the pass `show`.

    A height map gets no labels, because it is not in the pixels of the image. Raises InputError for a pass that the
    split does not have.
    """
    # Loaded here: matplotlib takes a second.
    from synth3dlanes.figures.passes import pass_picture

    reader = samples[0][0]
    if show != "image" and show not in reader.description["render"]["passes"]:
        raise InputError(f"show {show}: {reader.url} was made without this pass")
    return [
        ShownSample(
            f"{reader.key(i)} {reader.camera_name(i)}".rstrip(),
            reader.image(i) if show == "image" else pass_picture(show, reader.passes(i)[show]),
            reader.labels(i) if with_lanes and show != "height" else None,
        )
        for reader, i in samples
    ]
