"""The format masks."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.masks.verify import RULE, read, verify
from synth3dlanes.formats.masks.write import README, annotate, document
from synth3dlanes.formats.segments import PASSES

FORMAT = SampleFormat(
    title="PNG masks of classes, instances and lines",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    document=document,
    passes=PASSES,
)
