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
    is_sample = SAMPLE.fullmatch(where) is not None
    name, scene, labels, image = _sample(where, image_path) if is_sample else _rendered(where, image_path)
    shown = ShownScene(
        scene,
        labels,
        image,
        load_passes(where, image_path) if with_passes else {},
        load_sweep(where, image_path, labels),
        name=name,
        lifted_shot=_shot(*find(where)) if scene is None else None,
    )
    if not is_sample:
        return shown
    clip = load_clip(where).frames if with_clip and shown.shot.n_frames > 1 else ()
    return replace(shown, clip=clip, rig=load_rig_pictures(where) if shown.shot.n_cameras > 1 else ())


def _shot(reader: Reader, i: int) -> Shot:
    """Which frame of its clip a sample is, by the index and the description of its data set."""
    n_frames, fps = clip_of(reader.description)
    return Shot(frame=int(reader.frame_of[i]), n_frames=n_frames, fps=fps)


def _sample(where: str, image_path: Path | None) -> tuple[str, Scene | None, Labels, RgbImage]:
    if image_path is not None:
        raise InputError(f"image {image_path}: expected none beside a sample, which has its own")
    reader, position = find(where)
    sample = reader[position]
    scene = None if sample.scene_json is None else from_json(sample.scene_json, where)
    return sample.key, scene, sample.labels, sample.image


def _rendered(where: str, image_path: Path | None) -> tuple[str, Scene, Labels, RgbImage | None]:
    name, scene = find_scene(where)
    if image_path is None:
        return name, scene, ground_truth(scene), None
    size_px = scene.camera.width_px, scene.camera.height_px
    image = decode_image(read_bounded(image_path, MAX_IMAGE_BYTES), str(image_path), size_px)
    return name, scene, ground_truth(scene), image


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
    shot = _shot(reader, i)
    if shot.n_frames == 1:
        raise InputError(f"{where}: expected a sample of a clip (generate --frames), got a single picture")
    positions = reader.clip(int(reader.scene_of[i]), int(reader.camera_of[i]))
    return Clip(shot.fps, [(reader.labels(position), reader.image(position)) for position in positions])


def load_rig_pictures(where: str) -> list[tuple[Labels, RgbImage]]:
    """Labels and image of every camera of the rig, for the scene and frame of a sample `DIR/SPLIT:KEY`."""
    reader, i = find(where)
    return [(reader.labels(position), reader.image(position)) for position in reader.rig(i)]


def load_passes(where: str, image_path: Path | None) -> dict[str, Shaped[np.ndarray, "..."]]:
    """The passes of a sample, or of the files beside a rendered image. Raises InputError where there are none."""
    passes: dict[str, Shaped[np.ndarray, ...]] = {}
    if SAMPLE.fullmatch(where):
        reader, position = find(where)
        passes = reader.passes(position)
    elif image_path is not None:
        files = [image_path.with_suffix(f".{name}") for name in (PASSES, HEIGHT)]
        for path in filter(Path.exists, files):
            passes |= read_passes(read_bounded(path, MAX_IMAGE_BYTES), str(path))
    if not passes:
        raise InputError(f"passes: expected {where} to have passes, got none")
    return passes


def load_sweep(where: str, image_path: Path | None, labels: Labels) -> Sweep | None:
    """The lidar sweep of a sample, or of the file beside a rendered image; None where there is none."""
    if labels.lidar is None:
        return None
    if SAMPLE.fullmatch(where):
        reader, position = find(where)
        return reader.lidar(position)
    path = image_path and image_path.with_suffix(f".{LIDAR}")
    return read_sweep(read_bounded(path, MAX_IMAGE_BYTES), str(path), labels.lidar) if path and path.exists() else None


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
