"""Write one frame in a foreign format: its image and its own label files. A record says what was written."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from synth3dlanes.dataset.description import clip_of
from synth3dlanes.dataset.format import SCENE, decode_image, encode_image
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rectify import rectified_labels
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.conditions import conditions
from synth3dlanes.formats.format import PinholeFormat, SampleFormat, SampleFrame
from synth3dlanes.formats.kerbs import kerb_lanes
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.formats.plan import Chunk
from synth3dlanes.formats.resample import fitting_pinhole, resample
from synth3dlanes.formats.writing import ExportFrame, FrameAnnotation, PinholeFrame
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.system.files import Folder, encoded

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
