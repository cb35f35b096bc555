"""The format yolo."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.segments import PASSES
from synth3dlanes.formats.things import LIMIT_PX
from synth3dlanes.formats.yolo.verify import read, verify
from synth3dlanes.formats.yolo.write import README, annotate, document

FORMAT = SampleFormat(
    title="YOLO segmentation: outlines of objects",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={"px": LIMIT_PX},
    document=document,
    passes=PASSES,
    counted="objects",
)
