"""What a kind of content brings, by leaving it out: `python -m scripts.content DIR OUT SEED INIT [CONTENT ...]`.

DIR is a data set of `streets`. For each content named (default: all of LACKS), the checkpoint INIT is trained on with
720 images whose scenes lack it, drawn by SEED, into OUT/CONTENT-SEED; `nothing` draws from all images. DIR/val
validates, and `synth3dlanes evaluate` scores the checkpoints, whose paths are printed.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from synth3dlanes_baseline.checkpoint import fine_tuning
from synth3dlanes_baseline.sources import Subset, open_split
from synth3dlanes_baseline.train import train_on

from synth3dlanes import Reader
from synth3dlanes.system.errors import InputError

N_IMAGES = 720
Scene = dict[str, Any]
LACKS: dict[str, Callable[[Scene], bool]] = {
    "nothing": lambda scene: True,
    "weather": lambda scene: scene["weather"]["kind"] in ("clear", "cloudy") and scene["weather"]["daytime"] == "day",
    "dots": lambda scene: not scene["markings"]["dots"],
    "damage": lambda scene: (
        not (scene["markings"]["missing"] or scene["surface"]["ghost_lines"]) and scene["surface"]["tar"] <= 0.2
    ),
    "oncoming": lambda scene: scene["road"]["n_oncoming"] == 0,
    "glass": lambda scene: not (scene["sensor"]["dirt"] or scene["sensor"]["drops"] or scene["host"]["bonnet"]),
    "houses": lambda scene: not scene["roadside"]["buildings"],
    "exits": lambda scene: scene["road"]["topology"] == 1,
    "narrow": lambda scene: scene["camera"]["width_px"] > 1.155 * scene["camera"]["fx_px"],  # more than 60 degrees
}
SETTINGS = {
    "learning_rate": 0.0015,
    "epochs": 5,
    "validate_every_epochs": 5,
    "model.has_close_look": True,
    "loss.image": 0.1,
    "augmentation.tint": 0.1,
    "augmentation.saturation": 0.5,
    "augmentation.sharpness": 0.8,
    "augmentation.contrast": 0.4,
    "augmentation.noise": 0.04,
}


def train_without(content: str, scenes: list[Scene], data: str, out: Path, seed: int, init: str) -> Path:
    """The best checkpoint of a training on images whose scenes lack the content; `scenes` are those of DIR/train."""
    places = [place for place, scene in enumerate(scenes) if LACKS[content](scene)]
    if len(places) < N_IMAGES:
        raise InputError(f"{data}/train: expected {N_IMAGES} scenes without {content}, got {len(places)}")
    drawn = np.random.default_rng(seed).permutation(places)[:N_IMAGES].tolist()
    config = fine_tuning(init, {**SETTINGS, "seed": seed})
    return train_on(config, Subset(open_split(f"{data}/train"), drawn), open_split(f"{data}/val"), out)


def main(data: str, out: str, seed: str, init: str, *contents: str) -> None:
    """Train a network without each content."""
    if unknown := set(contents) - set(LACKS):
        raise InputError(f"content: expected {', '.join(LACKS)}, got {', '.join(sorted(unknown))}")
    reader = Reader(f"{data}/train")
    scenes = [json.loads(reader.raw(i)["scene.json"]) for i in range(len(reader))]
    for content in contents or LACKS:
        best = train_without(content, scenes, data, Path(out, f"{content}-{seed}"), int(seed), init)
        sys.stdout.write(f"{best}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
