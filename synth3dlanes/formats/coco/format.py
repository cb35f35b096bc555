"""The format coco."""

from synth3dlanes.formats.coco.verify import read, verify
from synth3dlanes.formats.coco.write import README, annotate, document
from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.segments import LIMIT_PX, PASSES

FORMAT = SampleFormat(
    title="COCO: instances and panoptic segments",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={"px": LIMIT_PX},
    document=document,
    passes=PASSES,
    counted="objects",
)
