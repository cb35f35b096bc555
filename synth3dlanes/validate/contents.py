"""Read a sample's members. Members that cannot be read, or differ from their canonical text, are findings."""

import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import NamedTuple, TypeVar

import numpy as np

from synth3dlanes.dataset.format import HEIGHT, LABELS, LIDAR, PASSES, SCENE, decode_image, read_passes, read_sweep
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Passes, RgbImage
from synth3dlanes.system.errors import FormatError
from synth3dlanes.validate.findings import Finding, differences, some

# First bytes of files of these formats.
MAGIC = {"jpg": b"\xff\xd8\xff", "png": b"\x89PNG\r\n\x1a\n"}

Read = TypeVar("Read")


class Contents(NamedTuple):
    """A sample's members; None for those that cannot be read, and for the sweep of samples without a lidar."""

    scene: Scene | None
    labels: Labels | None
    image: RgbImage | None
    passes: Passes | None
    sweep: Sweep | None


def read_contents(members: Mapping[str, bytes]) -> tuple[Contents, list[Finding]]:
    """Read every member separately; return them and the findings."""
    findings: list[Finding] = []

    def read(name: str, parse: Callable[[bytes, str], Read]) -> Read | None:
        try:
            return parse(members[name], name)
        except FormatError as error:
            findings.append(Finding("", some(str(error).splitlines())))
            return None

    def sweep(data: bytes, name: str) -> Sweep | None:
        if labels is None:
            return None
        if labels.lidar is None:
            raise FormatError(f"{name}: expected none, as the labels have no lidar")
        return read_sweep(data, name, labels.lidar)

    image_name = next(iter(members))
    pictures = [read(name, _passes) for name in (PASSES, HEIGHT) if name in members]
    passes = {name: pixels for found in pictures if found is not None for name, pixels in found.items()}
    is_read = not any(found is None for found in pictures)
    scene = read(SCENE, _scene) if SCENE in members else None
    labels, image = read(LABELS, _labels), read(image_name, _image)
    found = read(LIDAR, sweep) if LIDAR in members else None
    return Contents(scene, labels, image, passes if is_read else None, found), findings


def _scene(data: bytes, name: str) -> Scene:
    scene = scene_module.from_json(data, name)
    _require_text(data, scene_module.to_json(scene), name)
    return scene


def _labels(data: bytes, name: str) -> Labels:
    labels = labels_module.from_json(data, name)
    _require_text(data, labels_module.to_json(labels), name)
    return labels


def _require_text(data: bytes, canonical: str, name: str) -> None:
    """Raise FormatError if a document has other keys or values than were read from it. Keys added in later versions may
    be missing."""
    if data == canonical.encode():
        return
    wrong = list(differences(json.loads(canonical), json.loads(data), may_lack=True))
    if wrong:
        raise FormatError(f"{name}: {some(wrong)}")


def _image(data: bytes, name: str) -> RgbImage:
    if not data.startswith(MAGIC[name]):
        raise FormatError(f"{name}: expected an image of this format, got another")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return decode_image(data, name)
        except Warning as warning:
            raise FormatError(f"{name}: expected an image, got a warning: {warning}") from None


def _passes(data: bytes, name: str) -> Passes:
    with _silence() as said:
        passes = read_passes(data, name)
    if said.getvalue():
        raise FormatError(f"{name}: expected an OpenEXR image, got a warning: {' '.join(said.getvalue().split())}")
    for pass_name, values in passes.items():
        # Behind the camera, where a fisheye may see, depths are negative.
        is_number = (values > -np.inf) & (values != 0) if pass_name == "depth" else np.isfinite(values)
        if not is_number.all():
            told = "distances or infinity" if pass_name == "depth" else "finite numbers"
            raise FormatError(f"{name}: {pass_name}: expected {told}, got another at {(~is_number).sum()} places")
    return passes


@contextmanager
def _silence() -> Iterator[StringIO]:
    """Capture OpenEXR's warnings about damaged files: returns those on Python's stdout, drops those on C's stderr."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere, redirect_stdout(StringIO()) as said:
            os.dup2(nowhere.fileno(), 2)
            yield said
    finally:
        os.dup2(kept, 2)
        os.close(kept)
