"""An export comes to the same bytes after a power cut (tests/power_cut.py)."""

import pytest

from synth3dlanes.formats.export import Export
from tests.power_cut import survive
from tests.thorough import first

FORMATS = ["tusimple", "openlane", "once", "culane", "curvelanes", "opendrive", "lanelet2"]


@pytest.mark.parametrize(("format_name", "n_cuts"), first(1, [("tusimple", 5), *((name, 8) for name in FORMATS)]))
def test_an_export(dataset, tmp_path, monkeypatch, format_name, n_cuts):
    # Several chunks, each with its mark.
    monkeypatch.setattr("synth3dlanes.formats.plan.FRAMES_PER_CHUNK", 3)
    survive(lambda out: Export(str(dataset), out, format_name).write(), tmp_path, n_cuts)
