"""The format apollo."""

from synth3dlanes.formats.apollo.convention import CAMERA, ROOT
from synth3dlanes.formats.apollo.predictions import score
from synth3dlanes.formats.apollo.verify import LINES, read, verify
from synth3dlanes.formats.apollo.write import README, annotate
from synth3dlanes.formats.format import PinholeFormat

FORMAT = PinholeFormat(
    title="Apollo Sim-3D (Gen-LaneNet): lane lines and centre lines in 3D",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={LINES.unit: LINES.limit},
    camera=CAMERA,
    is_f_free=False,
    is_size_free=False,
    links={"images": f"{ROOT}/images"},
)
