"""Samples of all presets, clips, rigs, lenses, lidars and maps are what they were (tests/golden/frozen.py)."""

import json

import numpy as np
import pytest

from tests.golden.frozen import FILE, ROWS, differences, sample
from tests.thorough import first

# Another version of a mathematical library may move an edge by a pixel here and there.
MOST_PIXELS, MOST_SHARE = 4, 0.01


@pytest.fixture(scope="module")
def frozen():
    return json.loads(FILE.read_text())


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
