"""The format cosmos."""

from synth3dlanes.formats.cosmos.verify import LIMIT_PX, RULE, read, verify
from synth3dlanes.formats.cosmos.write import README, annotate
from synth3dlanes.formats.format import SampleFormat

FORMAT = SampleFormat(
    title="Cosmos: control videos and the world scenario of a clip",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    passes=("depth", "semantic", "instance"),
    is_per_scene=True,
)
