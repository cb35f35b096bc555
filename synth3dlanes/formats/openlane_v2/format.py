"""The format openlane_v2."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.openlane_v2.verify import LIMIT_PX, RULE, read, verify
from synth3dlanes.formats.openlane_v2.write import README, annotate, document

FORMAT = SampleFormat(
    title="OpenLane-V2: lanes as a map, and which follows which",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    document=document,
    counted="lane segments",
)
