"""The command line with a sample maker that needs no Blender: `python -m tests.fake_cli generate --n 3 --out d`."""

import functools

from synth3dlanes_cli.main import run

from synth3dlanes.production import plan
from tests import fake_samples

if __name__ == "__main__":
    plan.Plan = functools.partial(plan.Plan, maker=fake_samples.make_slowly, shard_size=10)  # type: ignore[misc, assignment]
    run()
