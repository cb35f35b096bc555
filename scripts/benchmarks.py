"""Write the digests of params/benchmarks anew, after an intended change of roads or labels:
`python -m scripts.benchmarks [NAME ...]`. Nothing is rendered; 1,200 scenes of a benchmark take minutes.
"""

import re
import sys

import click

from synth3dlanes.params.params import presets_folder
from synth3dlanes.production.benchmarks import KIND, benchmark_names, load_benchmark
from synth3dlanes.system.processes import process_pool


def digest(name: str, split: str) -> str:
    return load_benchmark(name).drawn_digest(split)


def main(names: list[str]) -> None:
    """Draw every split of some benchmarks, the small ones first, and write their digests into their files."""
    benchmarks = {name: load_benchmark(name) for name in names or benchmark_names()}
    sizes = {(name, split): part.n for name, found in benchmarks.items() for split, part in found.splits.items()}
    jobs = sorted(sizes, key=sizes.__getitem__)
    with process_pool() as pool:
        for (name, split), found in zip(jobs, pool.map(digest, *zip(*jobs, strict=True)), strict=True):
            path = presets_folder() / KIND / f"{name}.yaml"
            text = re.sub(rf'(  {split}:\n    n: \d+\n    labels: )"\w*"', rf'\1"{found}"', path.read_text())
            path.write_text(text)
            click.echo(f"{name}/{split} {found}")


if __name__ == "__main__":
    # Processes of a pool know functions of modules alone.
    from scripts import benchmarks

    benchmarks.main(sys.argv[1:])
