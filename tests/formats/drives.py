"""What the tests of formats of whole drives share: small clips by some cameras of a ready rig, frames by hand, and what
is found after a fault was planted."""

import shutil
from pathlib import Path

import yaml

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.system.errors import FormatError
from tests import fake_samples
from tests.formats.planting import problems
from tests.scenes import FLAT

CHANGES = (
    "road.topology=2", "road.n_lanes=3", "road.n_oncoming=2", "road.median_m=0", "symbols.crosswalks=1",
    "camera.roll_deg=2", "cars.n=4",
)  # fmt: skip


def make_clips(root, rig, names):
    """Two clips of two frames by two cameras of a ready rig, a tenth as wide and high, whose images are black."""
    cameras = yaml.safe_load(Path(f"params/rigs/{rig}.yaml").read_text())
    for spec in cameras.values():
        spec.update({key: spec[key] / 10 for key in ("fx", "cx", "cy")})
        spec.update({key: spec[key] // 20 * 2 for key in ("width_px", "height_px")})
    path = root.parent / f"{rig}.yaml"
    path.write_text(yaml.safe_dump({name: cameras[name] for name in names}, sort_keys=False))
    shots = Shots(frames=2, fps=2, cameras=load_rig(str(path)))
    recipe = fake_samples.recipe(split="test", image_format="jpg", overrides=CHANGES, shots=shots)
    assert not generate(Plan(str(root), 8, recipe, workers=1, maker=fake_samples.make_labelled), print).problem


def frame_of(labels, number=0, **changes):
    """The first picture of its moment."""
    key = f"{number:08d}"
    fields = {"scene": FLAT, "passes": {}, "image_format": "png", "cameras": {key: labels.camera}, "is_first": False}
    told = {"split": "test", "key": key, "number": number, "part": "test", "parts": frozenset({"test"})}
    return SampleFrame(labels=labels, **told, **(fields | changes))


def problems_after(plant, job, folder, most_frames=4):
    """What is found in a copy of an export after a fault was planted."""
    out = folder / "out"
    shutil.copytree(job.out, out, symlinks=True)
    plant(out)
    try:
        return problems(job.source, out, job.format_name, most_frames)
    except FormatError as error:
        return [str(error)]
