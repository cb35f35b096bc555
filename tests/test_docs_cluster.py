"""The files of docs/cluster/ as far as they can be had here: run at a small size, or read by those who will read them.

The commands of the job scripts run as they stand; `synth3dlanes` on their PATH makes shards of one fake sample, three
samples instead of 300,000.
"""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
CLUSTER = ROOT / "docs/cluster"
N = 3
PROGRAM = f"""#!{sys.executable}
import functools
import sys
sys.path.insert(0, {str(ROOT)!r})
from synth3dlanes.production import plan
from synth3dlanes_cli.main import main
from tests import fake_samples
plan.Plan = functools.partial(plan.Plan, shard_size=1, maker=fake_samples.make)
if __name__ == "__main__":
    main([{str(N)!r} if word == "300000" else word for word in sys.argv[1:]])
"""


@pytest.fixture
def run_script(tmp_path: Path):
    """`run_script(text, **environment)` in a shell where our program is the small one and `srun` runs what it gets."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("synth3dlanes", PROGRAM), ("srun", '#!/bin/sh\nexec "$@"\n')):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)

    def run(text: str, **environment: str) -> str:
        path = {"PATH": f"{programs}:{os.environ['PATH']}", "SCRATCH": str(tmp_path), "HOME": str(tmp_path)}
        done = subprocess.run(
            ["bash", "-c", text], env={**path, **environment}, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def assert_whole(out: Path, run_script) -> None:
    from synth3dlanes.dataset.read import Reader

    assert [sample.key for sample in Reader(str(out / "train"))] == [f"{i:08d}" for i in range(N)]
    again = json.loads(run_script(f"synth3dlanes generate --n 300000 --out {out} --json"))
    assert (again["made"], again["done"], again["asked"]) == (0, N, N)


@pytest.mark.thorough
def test_the_slurm_array_makes_a_whole_data_set(tmp_path, run_script):
    script = (CLUSTER / "lanes.sbatch").read_text()
    assert re.search(r"^#SBATCH --array=1-(\d+)$", script, re.MULTILINE)
    for part in range(1, N + 1):
        array = {"SLURM_ARRAY_TASK_ID": str(part), "SLURM_ARRAY_TASK_COUNT": str(N)}
        assert "1 of 1 sample, 1 made now" in run_script(script, **array)
    assert_whole(tmp_path / "lanes", run_script)


@pytest.mark.thorough
def test_the_kubernetes_job_makes_a_whole_data_set(tmp_path, run_script):
    job = yaml.safe_load((CLUSTER / "job.yaml").read_text())["spec"]
    (container,) = job["template"]["spec"]["containers"]
    (command,) = container["args"]
    assert container["command"] == ["bash", "-c"]
    assert command.endswith(f'/{job["completions"]}"')
    assert container["volumeMounts"][0]["mountPath"] == "/shared"
    command = command.replace(f"/{job['completions']}", f"/{N}").replace("/shared", str(tmp_path))
    for index in range(N):
        run_script(command, JOB_COMPLETION_INDEX=str(index))
    assert_whole(tmp_path / "lanes", run_script)


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
def test_ray_accepts_its_cluster_file():
    # Ray's code warns of its own.
    check = """
import sys, yaml
from ray.autoscaler._private.util import prepare_config, validate_config
config = prepare_config(yaml.safe_load(open(sys.argv[1])))
validate_config(config)
print(config["available_node_types"]["maker"]["min_workers"], config["docker"]["image"])
"""
    command = [sys.executable, "-c", check, str(CLUSTER / "ray.yaml")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[0] == "16"


def test_the_container_has_what_blender_and_we_need():
    from synth3dlanes.system.system_libraries import PACKAGES

    text = (CLUSTER / "Containerfile").read_text().replace("\\\n", " ")
    instructions = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert [line.split()[0] for line in instructions] == ["FROM", "RUN", "COPY", "RUN"]
    packages = instructions[1].split("--no-install-recommends")[1].split("&&")[0].split()
    assert set(packages) == {"rsync", *PACKAGES.values()}
    for line in instructions:
        if line.startswith("RUN"):
            subprocess.run(["bash", "-n", "-c", line.removeprefix("RUN ")], check=True)


def test_the_container_gets_every_file_that_pip_needs():
    ignored = (CLUSTER / "Containerfile.dockerignore").read_text().split()
    kept = {name.removeprefix("!") for name in ignored if name.startswith("!")}
    project = (ROOT / "pyproject.toml").read_text()
    folders = {"synth3dlanes", *re.findall(r'_?\w+"? = "(baseline_model|cli|params|blender_assets)"', project)}
    assert kept == folders | {"LICENSE", "README.md", "constraints.txt", "pyproject.toml"}
    assert all((ROOT / name).exists() for name in kept)
