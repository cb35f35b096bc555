"""The format opendrive."""

from synth3dlanes.formats.format import SampleFormat
from synth3dlanes.formats.opendrive.verify import RULE, read, verify
from synth3dlanes.formats.opendrive.write import README, annotate

FORMAT = SampleFormat(
    title="OpenDRIVE: a map of each scene",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    is_per_scene=True,
    counted="lanes",
)
