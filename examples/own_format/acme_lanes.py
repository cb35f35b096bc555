"""A format of your own: lane lines in metres as a JSON document a frame, images of 480x360."""

import json

import numpy as np

from synth3dlanes.formats.comparing import ExportView, FoundLines, Rule, compare_lines
from synth3dlanes.formats.format import FrameList, PinholeFormat, ReadFrame
from synth3dlanes.formats.writing import FrameAnnotation, Pinhole

CAMERA = Pinhole(480, 360, f_px=415.0)
RULE = Rule("m", 0.001)


def write(frame):
    """The frame's files: x right, y along the viewing direction, z up, as in our labels."""
    lanes = [lane for lane in frame.labels.lanes if lane.kind == "delimiter"]
    name = f"{frame.split}-{frame.key}"
    document = {"k": frame.pinhole.img_from_cv.tolist(), "lanes": [lane.xyz_cam.tolist() for lane in lanes]}
    files = {f"{name}.json": json.dumps(document)}
    return FrameAnnotation(f"images/{name}.jpg", len(lanes), files=files, shared=((name, ("all.txt",)),))


def read(out, most_frames):
    """The lists of an export, with what the files of their frames say."""

    def frames():
        for name in (out / "all.txt").read_text().split()[:most_frames]:
            document = json.loads((out / f"{name}.json").read_text())
            lanes = [np.array(lane) for lane in document["lanes"]]
            yield ReadFrame(f"{name}.json", name, f"images/{name}.jpg", (np.array(document["k"]), lanes))

    yield FrameList("all", frames())


def verify(frame, truth):
    """How far the lines of a frame are from the labels."""
    k, lanes = frame.content
    return compare_lines(FoundLines(lanes, ExportView(k, CAMERA.size_px)), truth, RULE)[0]


FORMAT = PinholeFormat(
    title="Acme: lane lines before the camera",
    readme="Acme's lines.",
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=False,
)
