"""Put the weights of a training run into the package: `python -m scripts.weights run/best.pt nano`, `compact` or
`streets`; or those of its end, `run/last.pt`.

Numbers become float16, which changes no lane by more than a millimetre and halves the file. With a confidence behind
the name, as `streets 0.25`, lanes of this confidence get 0.5, and the others follow.
"""

import math
import sys
from dataclasses import replace
from pathlib import Path

import torch
from synth3dlanes_baseline.checkpoint import load, place, save
from synth3dlanes_baseline.config import TrainConfig

OF_THE_RUN = ("batch", "learning_rate", "weight_decay", "ema_decay", "epochs", "workers")
"""Settings that fitted the machine and the images of the training; whoever trains on has others."""


def ship(source: Path, target: Path, even: float = 0.5) -> None:
    """Write the checkpoint's weights, without paths of the machine that made them; confidence `even` becomes 0.5."""
    found = load(source)
    if even != 0.5:
        found.model["refinements.0.lane.bias"] -= math.log(even / (1 - even))
    weights = {name: value.half() if value.is_floating_point() else value for name, value in found.model.items()}
    if not all(bool(torch.isfinite(value).all()) for value in weights.values()):
        raise ValueError(f"{source}: expected weights that float16 can hold")
    defaults = {name: TrainConfig.model_fields[name].default for name in OF_THE_RUN}
    config = found.config.model_copy(update={"device": "auto", "pretrained": None, "init": None, **defaults})
    about = {"batch": found.config.batch} | {
        key: value.rsplit("/", 1)[-1] if key == "init" else value for key, value in found.about.items()
    }
    if found.resume is not None:
        about["step"] = found.resume["step"]
    target.parent.mkdir(exist_ok=True)
    save(target, replace(found, config=config, about=about, model=weights, resume=None))


if __name__ == "__main__":
    source, name, *confidence = sys.argv[1:]
    ship(Path(source), place(name), *map(float, confidence))
