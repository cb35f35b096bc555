"""Samples of all presets, clips, rigs, lenses, lidars and maps are what they were (tests/golden/frozen.py)."""

import json
import re

import numpy as np
import pytest

from synth3dlanes.draw.sample import sample_world
from synth3dlanes.labels import labels as label_file
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.truth.ground_truth import label
from tests.golden.frozen import FILE, ROWS, built, differences, digest, sample, scenes_of, thinned
from tests.thorough import first

# Worlds that take a second each, and have what others have.
SLOW = [*(f"town {i}" for i in (2, 3, 5, 6, 7)), "rig in a town, CAM_BACK", "fisheye in a town", "lidar in a town"]
# What pixels and points tell, and no world.
SEEN = re.compile(r"\.(object_visible|\w*visible_fraction|seen_box_px|lidar_points): expected .*, got None")
# Another version of a mathematical library may move an edge by a pixel here and there.
MOST_PIXELS, MOST_SHARE = 4, 0.01


@pytest.fixture(scope="module")
def frozen():
    return json.loads(FILE.read_text())


@pytest.mark.parametrize("name", first(len(ROWS) - len(SLOW), [*(name for name in ROWS if name not in SLOW), *SLOW]))
def test_a_world_is_as_it_was(frozen, name):
    """Before anything is rendered: the scene, the labels, and what is built and painted, to 0.1 mm. Scenes and labels
    come back from their files."""
    world = sample_world(scenes_of(ROWS[name]), ROWS[name].index)
    told = "another scene; a field that scenes did not have is left out where it has its default (`exclude_if`)"
    assert digest(world.scene) == frozen[name]["scene"], told
    assert scene_file.from_json(scene_file.to_json(world.scene), name) == world.scene
    text = label_file.to_json(label(world, world.view))
    assert label_file.to_json(label_file.from_json(text, name)) == text
    found = thinned(json.loads(text))
    unlike = (line for line in differences(frozen[name]["labels"], found) if not SEEN.search(line))
    assert [*unlike][:10] == []
    assert [*differences(frozen[name]["built"], json.loads(json.dumps(built(world))))][:10] == []


@pytest.mark.render
@pytest.mark.parametrize("name", first(2, ROWS))
def test_a_sample_is_as_it_was(frozen, name):
    """Labels to 0.1 mm with all ids; as many pixels of each thing; depths to a centimetre where no edge moved."""
    expected, found = frozen[name], json.loads(json.dumps(sample(name)))
    assert list(differences(expected["labels"], found["labels"]))[:10] == []
    assert found["scene"] == expected["scene"]
    for ids in ("instance", "semantic"):
        for key in expected[ids] | found[ids]:
            before, after = expected[ids].get(key, 0), found[ids].get(key, 0)
            assert abs(before - after) <= MOST_PIXELS + MOST_SHARE * before, f"pixels of {ids} {key}"
    off_m = np.abs(np.subtract(expected["depth_m"], found["depth_m"]))
    assert (off_m > 0.01).sum() <= 2


def test_all_rows_are_frozen(frozen):
    assert list(frozen) == list(ROWS)
