"""The format culane."""

from synth3dlanes.formats.culane.convention import CAMERA, SCENES, scene_list
from synth3dlanes.formats.culane.predictions import score
from synth3dlanes.formats.culane.verify import RULE, read, verify
from synth3dlanes.formats.culane.write import README, annotate
from synth3dlanes.formats.format import PinholeFormat
from synth3dlanes.formats.writing import PARTS

FORMAT = PinholeFormat(
    title="CULane: up to four lane lines in the image, by row, and masks",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=False,
    lists=(
        *(f"list/{part}.txt" for part in PARTS),
        *(f"list/{part}_gt.txt" for part in PARTS if part != "test"),
        *map(scene_list, SCENES),
    ),
)
