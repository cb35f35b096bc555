"""The format curvelanes."""

from synth3dlanes.formats.curvelanes.convention import CAMERA
from synth3dlanes.formats.curvelanes.predictions import score
from synth3dlanes.formats.curvelanes.verify import RULE, read, verify
from synth3dlanes.formats.curvelanes.write import README, annotate
from synth3dlanes.formats.format import PinholeFormat

FORMAT = PinholeFormat(
    title="CurveLanes: all lane lines in the image",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    lists=("train/train.txt", "valid/valid.txt", "test/test.txt"),
)
