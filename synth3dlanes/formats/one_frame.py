"""Write one frame in a foreign format: its image, as it is or as another camera at the same place, without roll, would
have taken it, and its own label files. A record says what was written. Pixel corners at whole numbers."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.dataset.description import clip_of
from synth3dlanes.dataset.format import SCENE, decode_image, encode_image
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rectify import bent_pixels, rectified_labels, remap, rolled_from_level, warp
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.conditions import conditions, kerb_lanes
from synth3dlanes.formats.format import PinholeFormat, SampleFormat, SampleFrame
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.formats.plan import Chunk
from synth3dlanes.formats.writing import CV_FROM_CAM, ExportFrame, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder, encoded

TOLERANCE_PX = 0.01  # scenes round their angles, so a native camera's focal length is off by parts in a million

# Points per side of an image's border, and the longest focal length that is tried, as a multiple of the format's.
BORDER_STEPS, MOST_ENLARGED = 65, 100.0


def fitting_pinhole(camera: CameraLabel, widest: Pinhole) -> Pinhole:
    """The camera of this image size with the shortest focal length, from that of `widest` on, that our image covers."""
    if not camera.lens.is_pinhole:
        return _fitting_lens(camera, widest)
    corners = source_pixels(camera, widest, _corners(widest))
    middle = camera.img_from_cam[:2, 1]
    room = np.where(corners > middle, [camera.width_px - middle[0], camera.height_px - middle[1]], middle)
    # What lies aside of the principal point moves towards it by the focal length's ratio.
    ratio = float(np.max((np.abs(corners - middle) - TOLERANCE_PX) / room))
    return widest if ratio <= 1 else replace(widest, f_px=float(np.ceil(widest.f_px * ratio * 1e4) / 1e4))


def _fitting_lens(camera: CameraLabel, widest: Pinhole) -> Pinhole:
    """`fitting_pinhole` for a camera with a lens, which bends the border of the foreign image."""
    share = np.linspace(0, 1, BORDER_STEPS)[:, None]
    corners = _corners(widest)
    border = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])

    def covers(f_px: float) -> bool:
        uv = source_pixels(camera, replace(widest, f_px=f_px), border)
        with np.errstate(invalid="ignore"):
            room = np.minimum(uv, [camera.width_px, camera.height_px] - uv)
            return bool((room > -TOLERANCE_PX).all())

    if covers(widest.f_px):
        return widest
    low, high = widest.f_px, MOST_ENLARGED * widest.f_px
    while high - low > TOLERANCE_PX:
        middle = (low + high) / 2
        low, high = (low, middle) if covers(middle) else (middle, high)
    return replace(widest, f_px=float(np.ceil(high * 1e4) / 1e4))


def resample(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel, pinhole: Pinhole, where: str) -> Image.Image:
    """The image through the foreign intrinsics, whose view it must cover.

    Without roll and lens a change of K is a scaling and a crop, which Pillow does exactly: `box` are the foreign
    image's borders in our pixels, corners at whole numbers, and it filters when it shrinks. With roll it is a
    homography, and through a lens every pixel has its place: drawn larger and averaged where it shrinks.
    """
    corners = source_pixels(camera, pinhole, _corners(pinhole))
    box = (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
    width_px, height_px = camera.width_px, camera.height_px
    if image.shape[:2] != (height_px, width_px):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{where}: expected an image of {width_px}x{height_px} as in its labels, got {got}")
    if not camera.lens.is_pinhole:
        shrink = max(1, round(camera.img_from_cam[0, 0] / pinhole.f_px))
        grid = np.meshgrid(*(np.arange(size * shrink) + 0.5 for size in (pinhole.width_px, pinhole.height_px)))
        uv = bent_pixels(camera, pinhole.img_from_cv @ CV_FROM_CAM, np.stack(grid, axis=-1) / shrink)
        return Image.fromarray(remap(image, uv)).reduce(shrink)
    if camera.roll_rad:
        shrink = max(1, round(camera.img_from_cam[0, 0] / pinhole.f_px))
        finer = np.diag([1 / shrink, 1 / shrink, 1.0])
        size_px = (pinhole.width_px * shrink, pinhole.height_px * shrink)
        return warp(image, _ours_from_theirs(camera, pinhole) @ finer, size_px).reduce(shrink)
    source = Image.fromarray(image)
    if source.size == (pinhole.width_px, pinhole.height_px) and np.allclose(
        box, (0, 0, *source.size), rtol=0, atol=TOLERANCE_PX
    ):
        return source
    inside = np.clip(box, 0, (width_px, height_px, width_px, height_px)).tolist()
    return source.resize((pinhole.width_px, pinhole.height_px), Image.Resampling.BICUBIC, box=tuple(inside))


def source_pixels(
    camera: CameraLabel, pinhole: Pinhole, points_img: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Where points of the foreign image lie in ours."""
    if not camera.lens.is_pinhole:
        return bent_pixels(camera, pinhole.img_from_cv @ CV_FROM_CAM, points_img)
    homogeneous = np.column_stack([points_img, np.ones(len(points_img))]) @ _ours_from_theirs(camera, pinhole).T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _ours_from_theirs(camera: CameraLabel, pinhole: Pinhole) -> Float[np.ndarray, "3 3"]:
    return rolled_from_level(camera, pinhole.img_from_cv @ CV_FROM_CAM)


def _corners(pinhole: Pinhole) -> Float[np.ndarray, "4 2"]:
    width_px, height_px = pinhole.width_px, pinhole.height_px
    return np.array([[0.0, 0.0], [width_px, 0.0], [width_px, height_px], [0.0, height_px]])


Record = dict[str, Any]

FRAMES_PER_SPLIT = 10**8
JPEG_QUALITY = 95
EXPOSURE_STEPS = (5 / 3, 7 / 3)  # thirds of the paper's range 1..3
USUAL_EXPOSURE = 2.0  # taken for images of real drives, whose own is not known
NO_LINES = "no lane line is left, which the benchmark cannot score"
NARROW = "its field of view is narrower than the format's one camera"


def write_resampled(reader: Reader, index: int, chunk: Chunk, out: Path, foreign: PinholeFormat) -> Record:
    """Write a frame as an upright pinhole camera would have seen it."""
    sample = reader[index]
    where = f"{chunk.url}:{sample.key}"
    scene = None if sample.scene_json is None else scene_format.from_json(sample.scene_json, where)
    labels, pinhole = rectified_labels(sample.labels), fitting_pinhole(sample.labels.camera, foreign.camera)
    frame_of, (n_frames, _) = _frame(reader, index, chunk, labels), clip_of(reader.description)
    frame = PinholeFrame(
        **vars(frame_of),
        pinhole=pinhole,
        tags=scene_tags(labels, pinhole) | (conditions(scene, labels) if scene else frozenset()),
        illumination=int(np.digitize(scene.light.exposure if scene else USUAL_EXPOSURE, EXPOSURE_STEPS)),
        clip=frame_of.number - int(reader.frame_of[index]) * max(1, len(reader.cameras)) if n_frames > 1 else None,
        kerbs=kerb_lanes(scene, labels.camera) if scene and foreign.has_kerbs else (),
    )
    if pinhole != foreign.camera and not foreign.is_f_free:
        return _left_out(frame, NARROW)
    annotation = foreign.write(frame)
    if annotation is None:
        return _left_out(frame, NO_LINES)
    image = resample(sample.image, sample.labels.camera, pinhole, where)
    jpeg = encoded(lambda stream: image.save(stream, "JPEG", quality=JPEG_QUALITY))
    record = _write(out, frame, annotation, lambda _: jpeg)
    enlarged = pinhole.f_px / float(sample.labels.camera.img_from_cam[0, 0])
    return {**record, "f_px": pinhole.f_px, "enlarged": enlarged}


def write_as_it_is(reader: Reader, index: int, chunk: Chunk, out: Path, foreign: SampleFormat) -> Record:
    scene_json, key, image_format = reader.member(index, SCENE), reader.key(index), reader.description["image_format"]
    where, labels = f"{chunk.url}:{key}", reader.labels(index)
    frame = SampleFrame(
        **vars(_frame(reader, index, chunk, labels)),
        scene=scene_format.from_json(scene_json, where),
        passes=reader.passes(index) if foreign.passes else {},
        image_format=image_format,
        sweep=reader.lidar(index) if foreign.takes_sweeps and reader.has_lidar else None,
        cameras=_cameras(reader, index, labels, chunk),
        is_first=index in chunk.firsts,
        pictures=partial(_pictures, reader, index),
    )
    annotation = foreign.write(frame)
    if annotation is None:
        return _left_out(frame, NO_LINES)

    def image_as(wanted: str) -> bytes:
        data = reader.member(index, image_format)
        return data if wanted == image_format else encode_image(decode_image(data, where), wanted)

    return _write(out, frame, annotation, image_as)


def ended(text: str) -> str:
    """A text file's content: its last line ends in a newline too; without lines it is empty."""
    return f"{text}\n" if text and not text.endswith("\n") else text


def _cameras(reader: Reader, index: int, labels: Labels, chunk: Chunk) -> dict[str, CameraLabel]:
    """The exported cameras of the moment of a sample with these labels, by their samples' keys, for the first of
    them."""
    _, *others = moment = [i for i in reader.rig(index) if reader.camera_name(i) in chunk.cameras or not chunk.cameras]
    if moment[0] != index:
        return {}
    return {reader.key(index): labels.camera, **{reader.key(i): reader.labels(i).camera for i in others}}


def _pictures(reader: Reader, index: int, key: str) -> Iterator[SourceSample]:
    """The pictures of the scene of a sample, by the camera of the sample of a key."""
    camera = int(reader.camera_of[reader.position(key)])
    return (SourceSample(reader, place) for place in reader.clip(int(reader.scene_of[index]), camera))


def _frame(reader: Reader, index: int, chunk: Chunk, labels: Labels) -> ExportFrame:
    split, key = chunk.split, reader.key(index)
    return ExportFrame(
        labels=labels,
        split=split.name,
        key=key,
        number=split.number * FRAMES_PER_SPLIT + int(key),
        part=split.part_of(int(reader.scene_of[index])),
        parts=chunk.parts,
    )


def _left_out(frame: ExportFrame, reason: str) -> Record:
    return {"split": frame.split, "part": frame.part, "left_out": reason}


def _write(out: Path, frame: ExportFrame, annotation: FrameAnnotation, image_as: Callable[[str], bytes]) -> Record:
    """`image_as` gives the image in the format that an ending names."""
    folder, image = Folder(out), annotation.image
    files = {
        path: content if isinstance(content, bytes) else ended(content).encode()
        for path, content in annotation.files.items()
    }
    if image is not None:
        files = {image: image_as(PurePath(image).suffix.removeprefix(".")), **files}
    for path, content in files.items():
        folder.make(PurePath(path).parent)
        with folder.renew(path) as stream:
            stream.write(content)
    return {
        "split": frame.split,
        "part": frame.part,
        "left_out": None,
        "n_lines": annotation.n_lines,
        "dropped": annotation.dropped,
        "files": list(files),
        "shared": annotation.shared,
    }
