"""Ctrl-C and SIGTERM end every command with the exit code of a shell and one line, never "Aborted!"."""

import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import Terminated, main


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
@pytest.mark.parametrize(
    ("arguments", "function", "line"),
    [
        (
            ["export", "d", "--format", "apollo", "--out", "e"],
            "synth3dlanes.formats.export.export",
            "; rerun to resume",
        ),
        (["validate", "d"], "synth3dlanes.validate.run.validate", ""),
        (["sample"], "synth3dlanes.sample.scene_texts", ""),
    ],
)
def test_a_signal_ends_a_command_in_one_line(monkeypatch, error, code, arguments, function, line):
    def stop(*_, **__):
        raise error

    monkeypatch.setattr(function, stop)
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code
    # A progress bar may stand before it.
    assert result.stderr.splitlines()[-1] == f"synth3dlanes {arguments[0]}: interrupted{line}"
    assert "Aborted" not in result.output
