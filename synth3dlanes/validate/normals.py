"""Check that all normals have unit length, are zero in the sky and face the camera. Camera frame.

`pavement` compares them with the road's normals.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.labels import CameraLabel
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.passes_proof import Passes

# At most about this many evenly spread pixels are used.
MAX_PIXELS = 45_000
# Tolerance of the length (half floats are accurate to 0.0004), and number of pixels that may be wrong.
LENGTH, MAX_SINGLE = 0.005, 3
# With smooth shading, normals at outlines may point away from the camera: in 200 rendered scenes, up to 6 % of the
# pixels of a small car and 0.8 % of all others. Leaves and far hills are not checked.
AWAY, MAX_AWAY, MIN_PIXELS = 0.02, 0.25, 50
KINDS = ("road", "shoulder", "marking", "car")


def check_normals(camera: CameraLabel, passes: Passes) -> Iterator[Finding]:
    """Findings about the normal pass; depth or semantic ids give the sky, semantic ids the kinds to check."""
    if "normal" not in passes:
        return
    step = int(np.ceil(np.sqrt(passes["normal"][..., 0].size / MAX_PIXELS)))
    some = {name: values[::step, ::step] for name, values in passes.items() if name != "height"}
    length = np.linalg.norm(some["normal"], axis=2)
    has_none = length == 0
    wrong = int((~has_none & ~(np.abs(length - 1) < LENGTH)).sum())
    if wrong > MAX_SINGLE:
        yield Finding("", f"normal: expected unit length or none, got another at {wrong} of {length.size} pixels")
    if {"depth", "semantic"} & set(some):
        is_sky = ~np.isfinite(some["depth"]) if "depth" in some else some["semantic"] == SEMANTIC_IDS["sky"]
        wrong = int((has_none != is_sky).sum())
        if wrong > MAX_SINGLE:
            yield Finding("", f"normal: expected zero in the sky and only there, got otherwise at {wrong} pixels")
    if "semantic" in some:
        rows, columns = step * np.indices(length.shape) + 0.5
        away = (camera.rays(np.stack([columns, rows], axis=-1)) * some["normal"]).sum(axis=2) > AWAY
        for name in KINDS:
            of_kind = away[some["semantic"] == SEMANTIC_IDS[name]]
            if len(of_kind) >= MIN_PIXELS and of_kind.mean() > MAX_AWAY:
                share = f"{100 * of_kind.mean():.0f} % of {name}"
                yield Finding("", f"normal: expected it to face the camera, got {share} turned away")
