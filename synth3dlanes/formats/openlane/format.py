"""The format openlane."""

from synth3dlanes.formats.format import PinholeFormat
from synth3dlanes.formats.openlane.convention import CAMERA, CASES
from synth3dlanes.formats.openlane.predictions import score
from synth3dlanes.formats.openlane.verify import RULE, TOLERANCE_PX, read, verify
from synth3dlanes.formats.openlane.write import README, annotate

FORMAT = PinholeFormat(
    title="OpenLane: lane lines and kerbs in 3D, with categories",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit, "px": TOLERANCE_PX},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    has_kerbs=True,
    lists=tuple(f"lane3d_1000/test/{name}" for name in CASES.values()),
)
