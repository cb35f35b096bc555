"""The format once."""

from synth3dlanes.formats.format import PinholeFormat
from synth3dlanes.formats.once.convention import CAMERA, ROOT
from synth3dlanes.formats.once.predictions import score
from synth3dlanes.formats.once.verify import RULE, read, verify
from synth3dlanes.formats.once.write import README, annotate
from synth3dlanes.formats.writing import PARTS

FORMAT = PinholeFormat(
    title="ONCE-3DLanes: lane lines in 3D",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    links={"annotations": ROOT, "raw_data": f"{ROOT}/data"},
    replaced_words=PARTS,
)
