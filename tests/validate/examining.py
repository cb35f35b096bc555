"""Run the program's own checks on evidence, without its net: a check that raises is a fault of its test."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from synth3dlanes.dataset.format import SCENE
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.scene import from_json
from synth3dlanes.validate.checks import CHECKS
from synth3dlanes.validate.contents import read_contents
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Finding, Result, findings_of
from synth3dlanes.world.world import World, resolve


def evidence_of(members: Mapping[str, bytes]) -> Evidence:
    """The evidence of a sample whose members can be read."""
    (_, labels, image, passes, sweep), faults = read_contents(members)
    assert not faults, faults[0].reason
    assert labels is not None
    return Evidence(_resolved(members[SCENE]), labels, image, passes or {}, sweep)


@lru_cache(maxsize=4)
def _resolved(scene_json: bytes) -> World:
    return resolve(from_json(scene_json, SCENE))


def examine(evidence: Evidence, *names: str) -> list[Result]:
    """What the named checks yield, or all checks of pixels; those that lack what they need yield nothing."""
    known = {check.name: check for check in CHECKS}
    asked = [known[name] for name in names] if names else CHECKS
    return [result for check in asked if check.needs <= evidence.has for result in check.of(evidence)]


def findings(evidence: Evidence, *names: str) -> list[Finding]:
    """The findings among them."""
    return findings_of(examine(evidence, *names))


def reasons(evidence: Evidence, *names: str) -> str:
    """Their reasons, one a line."""
    return "\n".join(finding.reason for finding in findings(evidence, *names))


def numbers(evidence: Evidence, *names: str) -> dict[str, list[float]]:
    """The numbers that are held against limits, by name."""
    found: dict[str, list[float]] = {}
    for result in examine(evidence, *names):
        if isinstance(result, Bounded):
            found.setdefault(result.name, []).append(result.value)
    return found


def seen(labels: Labels) -> Labels:
    """The labels of a scene in which nothing hides anything, as rendered."""
    lanes = (replace(lane, object_visible=np.ones(len(lane.xyz_cam), bool)) for lane in labels.lanes)
    return replace(labels, lanes=tuple(lanes))
