"""What does one factor do to a network? The same scenes with several values of it, and the network's score on each.

Everything else stays equal, pixel by pixel, so differences are the factor's alone.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path


def synth3dlanes(*words: object) -> str:
    """Run a command of synth3dlanes and return what it prints."""
    command = [sys.executable, "-m", "synth3dlanes", *map(str, words)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def scores(out: Path, vary: str, n: int, params: str, checkpoint: str) -> dict[str, float]:
    """The AP of centre lines for each value of the factor."""
    synth3dlanes("generate", "--n", n, "--params", params, "--split", "test", "--out", out / "scenes")
    synth3dlanes("twins", out / "scenes/test", "--vary", vary, "--n", n, "--out", out / "twins")
    found = {}
    for number, value in enumerate(vary.partition("=")[2].split(","), start=1):
        split = out / f"twins/twin_{number}"
        report = json.loads(synth3dlanes("evaluate", split, "--checkpoint", checkpoint, "--json"))
        found[value] = report["centerline"]["ap"]
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="new folder")
    parser.add_argument(
        "--vary", default="light.exposure=0.5,1,2,4", help="a value of scene.json, and what it shall be"
    )
    parser.add_argument("--n", type=int, default=100, help="number of scenes")
    parser.add_argument("--params", default="appendix_i")
    parser.add_argument("--checkpoint", default="nano", help="a checkpoint of yours, or weights of the package")
    arguments = parser.parse_args()
    for value, ap in scores(**vars(arguments)).items():
        print(f"{arguments.vary.partition('=')[0]} = {value}: AP {ap:.3f}")
