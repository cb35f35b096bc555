"""What a content of images is worth: `python -m scripts.leave_out DIR CONTENT N OUT [KEY=VALUE ...]` trains the weights
`nano` on with N images of DIR/train (preset `streets`) that lack it, and validates on DIR/val.

The contents are those of `LACKS`; `nothing` leaves none out. Run it by torchrun for several processes.
"""

import json
import sys
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

from synth3dlanes_baseline.checkpoint import fine_tuning
from synth3dlanes_baseline.config import overrides_from
from synth3dlanes_baseline.sources import Subset, open_split
from synth3dlanes_baseline.train import train_on

from synth3dlanes import Reader

Scene = dict[str, Any]


def _lacks_weather(scene: Scene) -> bool:
    weather = scene["weather"]
    return weather["kind"] in ("clear", "cloudy") and weather["daytime"] == "day"


def _lacks_wear(scene: Scene) -> bool:
    markings, surface = scene["markings"], scene["surface"]
    return not (markings["missing"] or surface["ghost_lines"]) and surface["tar"] <= 0.2


def _lacks_glass(scene: Scene) -> bool:
    return not (scene["sensor"]["dirt"] or scene["sensor"]["drops"] or scene["host"]["bonnet"])


def _lacks_narrow_cameras(scene: Scene) -> bool:
    return bool(scene["camera"]["width_px"] > 1.155 * scene["camera"]["fx_px"])  # 60 degrees


LACKS: dict[str, Callable[[Scene], bool]] = {
    "nothing": lambda scene: True,
    "weather": _lacks_weather,
    "dots": lambda scene: not scene["markings"]["dots"],
    "wear": _lacks_wear,
    "oncoming": lambda scene: scene["road"]["n_oncoming"] == 0,
    "glass": _lacks_glass,
    "narrow": _lacks_narrow_cameras,
    "exits": lambda scene: scene["road"]["topology"] == 1,
    "traffic": lambda scene: len(scene["cars"]) <= 8,
}


def main(data: str, content: str, n: str, out: str, *settings: str) -> None:
    """Train on the first N images whose scenes lack the content."""
    reader, lacks = Reader(f"{data}/train"), LACKS[content]
    places = list(islice((i for i in range(len(reader)) if lacks(json.loads(reader[i].scene_json))), int(n)))
    if len(places) < int(n):
        raise SystemExit(f"{data}: expected {n} images without {content}, got {len(places)}")
    config = fine_tuning("nano", overrides_from(settings))
    train_on(config, Subset(open_split(f"{data}/train"), places), open_split(f"{data}/val"), Path(out))


if __name__ == "__main__":
    main(*sys.argv[1:])
