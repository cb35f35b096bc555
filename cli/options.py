"""Options that several commands share."""

import re
from typing import Any

import click

from synth3dlanes.settings import DEVICES, PASSES, QUALITY_SAMPLES


class Names(click.ParamType):
    """A comma-separated choice of names."""

    name = "names"

    def __init__(self, known: tuple[str, ...]) -> None:
        self.known = known

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Split and check, in the order of the known names."""
        if isinstance(value, tuple):
            return value
        names = [name.strip() for name in value.split(",") if name.strip()]
        for name in names:
            if name not in self.known:
                self.fail(f"{name!r} is not one of {', '.join(self.known)}.", param, ctx)
        return tuple(name for name in self.known if name in names)


class FileName(click.ParamType):
    """A name that can be a folder's: letters, digits, `_` and `-`."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check it."""
        if re.fullmatch(r"[A-Za-z0-9_-]+", value) is None:
            self.fail(f"expected letters, digits, _ or -, got {value!r}", param, ctx)
        return str(value)


params_option = click.option(
    "--params", "source", metavar="FILE", default="appendix_i", help="A preset's name or a YAML file."
)
set_option = click.option(
    "--set", "changes", metavar="GROUP.KEY=VALUE", multiple=True, help="Change one parameter; repeatable."
)
seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, help="Of the whole data set.")
split_option = click.option(
    "--split", metavar="NAME", type=FileName(), default="train", help="Its scenes differ from other splits'."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for a machine.")
samples_option = click.option(
    "--samples", metavar="K", type=click.IntRange(min=1), default=QUALITY_SAMPLES["standard"], help="Rays per pixel."
)
passes_option = click.option(
    "--passes", type=Names(PASSES), default="", metavar="NAMES", help=f"Of {','.join(PASSES)}: extra images in an EXR."
)
device_option = click.option("--device", type=click.Choice(DEVICES), default="auto", help="What Cycles renders on.")
