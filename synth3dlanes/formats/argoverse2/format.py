"""The format argoverse2."""

from synth3dlanes.formats.argoverse2.verify import LIMIT_PX, RULE, read, verify
from synth3dlanes.formats.argoverse2.write import README, annotate, document
from synth3dlanes.formats.format import SampleFormat

FORMAT = SampleFormat(
    title="Argoverse 2: cameras, lidar, boxes and the map of a log",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    links={"val": "test", "test": "val"},
    document=document,
    takes_sweeps=True,
    counted="lane segments",
)
