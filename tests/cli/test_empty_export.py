"""An export of no frame is a failure that says why and what to do."""

from collections.abc import Callable
from pathlib import Path

from click.testing import Result

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples


def test_an_export_of_no_frame_fails(run: Callable[..., Result], in_tmp_path: Path) -> None:
    narrow = fake_samples.recipe(overrides=("camera.horizontal_fov_deg=20",))
    generate(Plan("d", 2, narrow, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    for more in ((), ("--verify",)):
        result = run("export", "d", "--format", "apollo", "--out", "e", *more)
        assert (result.exit_code, result.stdout) == (1, ""), result.output
        line = result.stderr.splitlines()[-1]
        assert "e: expected a frame to export, got none: 2 its field of view is narrower than" in line
        assert "generate with a wider camera (--camera, docs/camera.md)" in line
    other = run("export", "d", "--format", "culane", "--out", "e")
    assert other.exit_code == 2
    assert "expected an empty folder or the export of format culane" in other.stderr
    assert "{" not in other.stderr
