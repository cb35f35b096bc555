"""Hard cases: score a network, take the scenes that it fails on, and make new ones near them to train on.

docs/like.md says how near, and what it has brought.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import synth3dlanes as s3d

N_HARD = 10


def worst(split: Path, checkpoint: str) -> list[str]:
    """The keys of a split's samples, the worst first."""
    command = [sys.executable, "-m", "synth3dlanes", "evaluate", split, "--checkpoint", checkpoint, "--json"]
    report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return [sample["key"] for sample in report["samples"]]


def mine(out: Path, n: int, preset: str, checkpoint: str) -> None:
    """Make `n` scenes, find those that the network fails on, and make as many near these."""
    params = s3d.load_params(preset)
    s3d.generate_dataset(params, out / "looked_at", n=n, split="val", seed=1)
    reader = s3d.open_dataset(out / "looked_at", "val")
    positions = {reader.key(i): i for i in range(len(reader))}
    keys = worst(out / "looked_at/val", checkpoint)[:N_HARD]
    for key in keys:
        i = positions[key]
        row = reader.index.slice(i, 1).to_pylist()[0]
        print(key, row["junction"], f"grade {row['max_grade']:.2f}", f"{row['n_visible_centerlines']} lanes in sight")
    hard = [s3d.read_scene(reader, positions[key]) for key in keys]
    report = s3d.generate_dataset(params, out / "hard", n=n, seed=2, like=hard, spreads="0.1")
    print(f"{out / 'hard/train'}: {report.done} samples near {len(hard)} scenes")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="new folder")
    parser.add_argument("--n", type=int, default=200, help="number of scenes to look at, and to make")
    parser.add_argument("--params", dest="preset", default="appendix_i")
    parser.add_argument("--checkpoint", default="nano", help="a checkpoint of yours, or weights of the package")
    mine(**vars(parser.parse_args()))
