"""The command as a user runs it, in this process."""

from collections.abc import Callable

import pytest
from click.testing import CliRunner, Result


@pytest.fixture
def run(in_tmp_path: object) -> Callable[..., Result]:
    """`run("sample", "--n", 3)` in an empty working directory."""
    from synth3dlanes_cli.main import main

    return lambda *arguments: CliRunner().invoke(main, [str(argument) for argument in arguments])
