"""The format tusimple."""

from synth3dlanes.formats.format import PinholeFormat
from synth3dlanes.formats.tusimple.convention import CAMERA
from synth3dlanes.formats.tusimple.predictions import score
from synth3dlanes.formats.tusimple.verify import RULE, read, verify
from synth3dlanes.formats.tusimple.write import LABEL_FILES, README, annotate

FORMAT = PinholeFormat(
    title="tuSimple: up to five lane lines in the image, by row",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=False,
    lists=LABEL_FILES,
)
