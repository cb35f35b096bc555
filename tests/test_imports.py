"""The architecture, checked in fresh interpreters: light modules stay light (style A3)."""

import subprocess
import sys

import pytest

PROBE = "import sys; import {}; print(*sorted({{'bpy', 'torch', 'matplotlib', 'pyarrow', 'ray'}} & set(sys.modules)))"


@pytest.mark.parametrize(
    ("module", "allowed"),
    [
        ("synth3dlanes", set()),
        ("synth3dlanes.api", {"pyarrow"}),
        ("synth3dlanes_cli.main", set()),
        ("synth3dlanes.geometry.network", set()),
        ("synth3dlanes.sample", set()),
        ("synth3dlanes.ground_truth", set()),
        ("synth3dlanes.dataset.read", {"pyarrow"}),
        ("synth3dlanes.formats.apollo.read", set()),
        ("synth3dlanes.formats.export", {"pyarrow"}),
        ("synth3dlanes.sources", {"pyarrow"}),
        ("synth3dlanes.production.run", {"pyarrow"}),
    ],
)
def test_importing_does_not_load(module: str, allowed: set[str]) -> None:
    command = [sys.executable, "-c", PROBE.format(module)]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout.split()
    assert set(loaded) <= allowed
